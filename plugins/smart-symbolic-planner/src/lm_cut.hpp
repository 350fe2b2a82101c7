#pragma once

#include <optional>

#include "budget.hpp"
#include "fact_queue.hpp"
#include "fiona/async.hpp"
#include "states.hpp"

namespace fiona::planning {

/// The landmark-cut heuristic (Helmert and Domshlak, "Landmarks, critical paths and abstractions: what's the difference
/// anyway?", ICAPS 2009): never more than the cheapest way to the goal costs. It finds sets of operators of which each
/// plan needs one, by cuts in the graph that leads from each operator's dearest need (by h_max) to its effects, and
/// adds up what the cheapest of each set costs.
class LmCut {
 public:
  LmCut(const GroundTask& task, Pace& pace, std::pmr::memory_resource* memory);

  /// None: the goal cannot be reached from here, deletes or not.
  Async<std::optional<Cost>> estimate(State state);

 private:
  struct Operator {
    Cost cost = 0;  ///< what is left of it
    Cost supported_at = kNoCost;
    Index supporter = kNone;  ///< its dearest need
    Index missing = 0;
  };
  enum class Zone : std::uint8_t { None, Before, Goal };

  void explore(State state);
  void explore_again();
  void reach(Index fact, Cost cost);
  void mark_goal_zone();
  void find_cut(State state);
  void take_cut(Cost cost);

  Pace& pace_;
  const Index nothing_;  ///< a fact that always holds, which operators without needs need
  const Index goal_;     ///< a fact that the last operator adds, which needs the goal
  Lists needs_, adds_, needed_by_, added_by_;
  List<Operator> fresh_, operators_;
  List<Cost> reached_at_;
  List<Zone> zones_;
  FactQueue queue_;
  List<Index> open_;
  List<Index> cut_;
};

}  // namespace fiona::planning
