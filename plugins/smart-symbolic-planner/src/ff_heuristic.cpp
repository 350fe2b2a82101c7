#include "ff_heuristic.hpp"

#include <algorithm>

namespace fiona::planning {

FfHeuristic::FfHeuristic(const GroundTask& task, List<Cost> costs, Pace& pace, std::pmr::memory_resource* memory)
    : task_(task),
      costs_(std::move(costs)),
      pace_(pace),
      needed_by_(task.needs.inverted(task.fact_count)),
      fresh_(memory),
      operators_(memory),
      reached_at_(task.fact_count, kNoCost, memory),
      reached_by_(task.fact_count, kNone, memory),
      queue_(memory),
      is_goal_(task.fact_count, false, memory),
      in_plan_((task.fact_count + 63) / 64, memory),
      op_in_plan_((task.operator_count() + 63) / 64, memory),
      open_(memory),
      plan_(memory),
      preferred_(memory) {
  for (std::size_t op = 0; op < task.operator_count(); ++op)
    fresh_.push_back({costs_[op], static_cast<Index>(task.needs[op].size())});
  for (const Index fact : task.goal) is_goal_[fact] = true;
}

Async<std::optional<Cost>> FfHeuristic::estimate(State state) {
  preferred_.clear();
  auto exploring = explore(state);
  const bool reaches_goal = co_await exploring;
  if (!reaches_goal) co_return std::nullopt;
  co_return extract(state);
}

/// Dijkstra over facts, whose cost is that of the operator and the sum over its needs. False: a goal is out of reach.
Async<bool> FfHeuristic::explore(State state) {
  operators_.assign(fresh_.begin(), fresh_.end());
  std::fill(reached_at_.begin(), reached_at_.end(), kNoCost);
  queue_.clear();
  for (Index fact = 0; fact < task_.fact_count; ++fact)
    if (holds(state, fact)) reach(fact, 0, kNone);
  for (Index op = 0; op < operators_.size(); ++op)
    if (operators_[op].missing == 0) reach_effects(op);
  std::size_t goals_left = task_.goal.size();
  while (goals_left > 0) {
    if (pace_.due()) co_await pace_.pause();
    if (queue_.empty()) co_return false;
    const auto [cost, fact] = queue_.pop();
    if (cost > reached_at_[fact]) continue;
    if (is_goal_[fact]) --goals_left;
    for (const Index op : needed_by_[fact]) {
      operators_[op].cost = sum(operators_[op].cost, cost);
      if (--operators_[op].missing == 0) reach_effects(op);
    }
  }
  co_return true;
}

void FfHeuristic::reach(Index fact, Cost cost, Index by) {
  if (cost >= reached_at_[fact]) return;
  reached_at_[fact] = cost;
  reached_by_[fact] = by;
  queue_.push(cost, fact);
}

void FfHeuristic::reach_effects(Index op) {
  for (const Index fact : task_.adds[op]) reach(fact, operators_[op].cost, op);
}

Cost FfHeuristic::extract(State state) {
  open_.clear();
  plan_.clear();
  Cost total = 0;
  std::fill(in_plan_.begin(), in_plan_.end(), 0);
  const auto want = [&](Index fact) {
    if (planning::holds(in_plan_, fact) || reached_by_[fact] == kNone) return;
    planning::set(in_plan_, fact);
    open_.push_back(fact);
  };
  for (const Index fact : task_.goal) want(fact);
  while (!open_.empty()) {
    const Index op = reached_by_[open_.back()];
    open_.pop_back();
    if (planning::holds(op_in_plan_, op)) continue;
    planning::set(op_in_plan_, op);
    plan_.push_back(op);
    total = sum(total, costs_[op]);
    for (const Index fact : task_.needs[op]) want(fact);
    if (all_hold(state, task_.needs[op])) preferred_.push_back(op);
  }
  for (const Index op : plan_) planning::clear(op_in_plan_, op);
  return total;
}

}  // namespace fiona::planning
