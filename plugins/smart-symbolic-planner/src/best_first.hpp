#pragma once

#include <limits>
#include <optional>

#include "budget.hpp"
#include "ff_heuristic.hpp"
#include "fiona/async.hpp"
#include "search.hpp"
#include "states.hpp"

namespace fiona::planning {

/// Best-first search with deferred evaluation and two queues, the second for preferred operators only, which is served
/// more often after each progress (Richter and Helmert, "Preferred operators and deferred evaluation in satisficing
/// planning", ICAPS 2009). Without weight it is greedy; with one it is weighted A*, which looks at a state again when
/// it comes there at lower cost.
class BestFirst {
 public:
  struct Options {
    bool counts_costs = true;                       ///< false: each operator counts as one in the heuristic
    std::optional<Cost> weight{};                   ///< of the heuristic; none: greedy
    Cost bound = std::numeric_limits<Cost>::max();  ///< only plans that cost less
    std::uint64_t most_evaluated = std::numeric_limits<std::uint64_t>::max();
  };
  enum class End : std::uint8_t { Found, Exhausted, GivenUp };

  BestFirst(const GroundTask& task, const Options& options, Pace& pace, Statistics& statistics,
            std::pmr::memory_resource* memory);

  Async<End> run();
  /// Once found.
  void plan(List<Index>& operators) const;
  std::uint64_t evaluated() const { return evaluated_; }

 private:
  struct Node {
    Index parent = kNone;
    Index op = kNone;
    Cost cost = 0;
  };
  struct Entry {
    Cost rank;
    std::uint64_t age;
    Index parent;
    Index op;
    bool operator<(const Entry& other) const {  // the lowest, then the oldest on top of a heap
      return rank != other.rank ? rank > other.rank : age > other.age;
    }
  };
  struct Queue {
    explicit Queue(std::pmr::memory_resource* memory) : entries(memory) {}
    List<Entry> entries;
    std::int64_t turns = 0;
  };
  static constexpr std::int64_t kBoost = 1000;

  static List<Cost> heuristic_costs(const GroundTask& task, bool counts_costs, Cost unit,
                                    std::pmr::memory_resource* memory);
  /// The state of that entry is a new one, or reached at lower cost.
  bool enter(const Entry& entry);
  void expand(Index number, Cost estimate);
  void push(Queue& queue, Index parent, Index op, Cost estimate);
  std::optional<Entry> pop();

  const GroundTask& task_;
  const Options options_;
  Pace& pace_;
  Statistics& statistics_;
  const Cost unit_;  ///< of all costs
  FfHeuristic heuristic_;
  Successors successors_;
  StateTable states_;
  List<Node> nodes_;
  Queue all_, preferred_;
  List<std::uint64_t> scratch_;
  std::uint64_t age_ = 0;
  std::uint64_t evaluated_ = 0;
  std::optional<Cost> best_estimate_{};
  Index current_ = 0;
  Index goal_ = kNone;
};

}  // namespace fiona::planning
