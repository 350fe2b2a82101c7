#pragma once

#include <optional>

#include "budget.hpp"
#include "fact_queue.hpp"
#include "fiona/async.hpp"
#include "states.hpp"

namespace fiona::planning {

/// Estimates the way to the goal by the cost of a plan that forgets what operators delete (Hoffmann and Nebel, "The FF
/// planning system", JAIR 14, 2001), made of the cheapest achievers by h_add (Keyder and Geffner, ECAI 2008).
class FfHeuristic {
 public:
  /// `costs`: of each operator, at least 1.
  FfHeuristic(const GroundTask& task, List<Cost> costs, Pace& pace, std::pmr::memory_resource* memory);

  /// None: the goal cannot be reached from here, deletes or not.
  Async<std::optional<Cost>> estimate(State state);
  /// The operators of that plan which can be applied at once.
  std::span<const Index> preferred() const { return preferred_; }

 private:
  struct Operator {
    Cost cost;  ///< its own and that of its reached needs
    Index missing;
  };

  Async<bool> explore(State state);
  void reach(Index fact, Cost cost, Index by);
  void reach_effects(Index op);
  Cost extract(State state);

  const GroundTask& task_;
  const List<Cost> costs_;
  Pace& pace_;
  const Lists needed_by_;
  List<Operator> fresh_;  ///< as all operators begin
  List<Operator> operators_;
  List<Cost> reached_at_;
  List<Index> reached_by_;
  FactQueue queue_;
  List<bool> is_goal_;
  List<std::uint64_t> in_plan_;  ///< bits of facts
  List<std::uint64_t> op_in_plan_;
  List<Index> open_;
  List<Index> plan_;
  List<Index> preferred_;
};

}  // namespace fiona::planning
