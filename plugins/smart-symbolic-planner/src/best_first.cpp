#include "best_first.hpp"

#include <algorithm>
#include <numeric>

namespace fiona::planning {
namespace {

Cost common_unit(const List<Cost>& costs) {
  Cost unit = 0;
  for (const Cost cost : costs) unit = std::gcd(unit, cost);
  return std::max<Cost>(unit, 1);
}

}  // namespace

BestFirst::BestFirst(const GroundTask& task, const Options& options, Pace& pace, Statistics& statistics,
                     std::pmr::memory_resource* memory)
    : task_(task),
      options_(options),
      pace_(pace),
      statistics_(statistics),
      unit_(common_unit(task.costs)),
      heuristic_(task, heuristic_costs(task, options.counts_costs, unit_, memory), pace, memory),
      successors_(task, memory),
      states_(task.fact_count, memory),
      nodes_(memory),
      all_(memory),
      preferred_(memory),
      scratch_(states_.words(), memory) {}

/// One more than they are, so that steps which cost nothing are no way to walk about for ever.
List<Cost> BestFirst::heuristic_costs(const GroundTask& task, bool counts_costs, Cost unit,
                                      std::pmr::memory_resource* memory) {
  List<Cost> costs(task.costs.begin(), task.costs.end(), memory);
  for (Cost& cost : costs) cost = counts_costs ? cost / unit + 1 : 1;
  return costs;
}

Async<BestFirst::End> BestFirst::run() {
  for (const Index fact : task_.init) set(scratch_, fact);
  states_.insert(scratch_);
  nodes_.push_back({});
  for (bool entered = true;;) {
    if (pace_.look()) co_await pace_.pause();
    if (entered && all_hold(states_[current_], task_.goal)) {
      goal_ = current_;
      co_return End::Found;
    }
    if (entered) {
      if (evaluated_ == options_.most_evaluated) co_return End::GivenUp;
      ++evaluated_;
      auto estimating = heuristic_.estimate(states_[current_]);
      const std::optional<Cost> estimate = co_await estimating;
      if (estimate) expand(current_, *estimate);
    }
    const auto entry = pop();
    if (!entry) co_return End::Exhausted;
    entered = enter(*entry);
  }
}

bool BestFirst::enter(const Entry& entry) {
  const Cost cost = sum(nodes_[entry.parent].cost, task_.costs[entry.op]);
  if (cost >= options_.bound) return false;
  std::ranges::copy(states_[entry.parent], scratch_.begin());
  apply(task_, entry.op, scratch_);
  const auto [number, is_new] = states_.insert(scratch_);
  if (is_new) {
    nodes_.push_back({entry.parent, entry.op, cost});
  } else if (options_.weight && cost < nodes_[number].cost) {
    nodes_[number] = {entry.parent, entry.op, cost};
  } else {
    return false;
  }
  current_ = number;
  return true;
}

void BestFirst::expand(Index number, Cost estimate) {
  if (!best_estimate_ || estimate < *best_estimate_) {
    if (best_estimate_) preferred_.turns -= kBoost;
    best_estimate_ = estimate;
  }
  ++statistics_.expanded;
  for (const Index op : heuristic_.preferred()) push(preferred_, number, op, estimate);
  successors_.for_each(states_[number], [&](Index op) {
    ++statistics_.generated;
    push(all_, number, op, estimate);
  });
}

void BestFirst::push(Queue& queue, Index parent, Index op, Cost estimate) {
  const Cost cost = sum(nodes_[parent].cost, task_.costs[op]);
  if (cost >= options_.bound) return;
  const Cost rank = options_.weight ? cost / unit_ + *options_.weight * estimate : estimate;
  queue.entries.push_back({rank, age_++, parent, op});
  std::push_heap(queue.entries.begin(), queue.entries.end());
}

std::optional<BestFirst::Entry> BestFirst::pop() {
  if (all_.entries.empty() && preferred_.entries.empty()) return std::nullopt;
  const bool from_all = preferred_.entries.empty() || (!all_.entries.empty() && all_.turns < preferred_.turns);
  Queue& queue = from_all ? all_ : preferred_;
  ++queue.turns;
  std::pop_heap(queue.entries.begin(), queue.entries.end());
  const Entry entry = queue.entries.back();
  queue.entries.pop_back();
  return entry;
}

void BestFirst::plan(List<Index>& operators) const {
  operators.clear();
  for (Index number = goal_; nodes_[number].parent != kNone; number = nodes_[number].parent)
    operators.push_back(nodes_[number].op);
  std::reverse(operators.begin(), operators.end());
}

}  // namespace fiona::planning
