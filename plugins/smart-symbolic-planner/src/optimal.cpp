#include <algorithm>
#include <limits>

#include "lm_cut.hpp"
#include "search.hpp"
#include "states.hpp"

namespace fiona::planning {
/// A*. A new state takes over what its parent's estimate says of it, and is estimated itself only when its turn comes.
class AStar {
 public:
  AStar(const GroundTask& task, SearchResult& result, Pace& pace, std::pmr::memory_resource* memory)
      : task_(task),
        result_(result),
        pace_(pace),
        heuristic_(task, pace, memory),
        successors_(task, memory),
        states_(task.fact_count, memory),
        nodes_(memory),
        queue_(memory),
        scratch_(states_.words(), memory) {}

  Async<> run() {
    for (const Index fact : task_.init) set(scratch_, fact);
    states_.insert(scratch_);
    nodes_.push_back({});
    push(0);
    while (!queue_.empty()) {
      if (pace_.look()) co_await pace_.pause();
      std::pop_heap(queue_.begin(), queue_.end());
      const Entry entry = queue_.back();
      queue_.pop_back();
      if (!is_current(entry)) continue;
      if (!nodes_[entry.number].is_estimated) {
        auto estimating = heuristic_.estimate(states_[entry.number]);
        const std::optional<Cost> found = co_await estimating;
        estimated(entry.number, found);
        continue;
      }
      if (all_hold(states_[entry.number], task_.goal)) co_return take_plan(entry.number);
      expand(entry.number);
    }
  }

 private:
  static constexpr Cost kDeadEnd = std::numeric_limits<Cost>::max();
  struct Node {
    Index parent = kNone;
    Index op = kNone;
    Cost cost = 0;
    Cost estimate = 0;
    bool is_estimated = false;
    bool is_closed = false;
  };
  struct Entry {
    Cost total;
    Cost estimate;
    Index number;
    bool operator<(const Entry& other) const {  // the lowest, of equal ones the nearest to the goal on top of a heap
      return total != other.total ? total > other.total : estimate > other.estimate;
    }
  };

  void push(Index number) {
    const Node& node = nodes_[number];
    if (node.estimate == kDeadEnd) return;
    queue_.push_back({node.cost + node.estimate, node.estimate, number});
    std::push_heap(queue_.begin(), queue_.end());
  }

  /// Not overtaken by a cheaper way to the same state, or by a better estimate of it.
  bool is_current(const Entry& entry) const {
    const Node& node = nodes_[entry.number];
    return !node.is_closed && entry.estimate == node.estimate && entry.total == node.cost + node.estimate;
  }

  void estimated(Index number, std::optional<Cost> found) {
    Node& node = nodes_[number];
    node.estimate = found ? std::max(*found, node.estimate) : kDeadEnd;
    node.is_estimated = true;
    push(number);
  }

  void expand(Index number) {
    ++result_.statistics.expanded;
    nodes_[number].is_closed = true;
    successors_.for_each(states_[number], [&](Index op) {
      ++result_.statistics.generated;
      std::ranges::copy(states_[number], scratch_.begin());
      apply(task_, op, scratch_);
      enter(number, op);
    });
  }

  void enter(Index parent, Index op) {
    const Cost cost = sum(nodes_[parent].cost, task_.costs[op]);
    const auto [number, is_new] = states_.insert(scratch_);
    if (is_new) {
      const Cost inherited = std::max<Cost>(0, nodes_[parent].estimate - task_.costs[op]);
      nodes_.push_back({parent, op, cost, inherited, false, false});
    } else if (cost < nodes_[number].cost) {
      Node& node = nodes_[number];
      node.parent = parent;
      node.op = op;
      node.cost = cost;
      node.is_closed = false;
    } else {
      return;
    }
    push(number);
  }

  void take_plan(Index goal) {
    for (Index number = goal; nodes_[number].parent != kNone; number = nodes_[number].parent)
      result_.plan.push_back(nodes_[number].op);
    std::reverse(result_.plan.begin(), result_.plan.end());
    result_.cost = nodes_[goal].cost;
    result_.has_plan = true;
    result_.is_optimal = true;
  }

  const GroundTask& task_;
  SearchResult& result_;
  Pace& pace_;
  LmCut heuristic_;
  Successors successors_;
  StateTable states_;
  List<Node> nodes_;
  List<Entry> queue_;
  List<std::uint64_t> scratch_;
};

Async<> search_optimal(const GroundTask& task, SearchResult& result, Pace& pace) {
  AStar search(task, result, pace, result.plan.get_allocator().resource());
  auto running = search.run();
  co_await running;
}

}  // namespace fiona::planning
