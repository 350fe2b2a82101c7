#include "lm_cut.hpp"

#include <algorithm>

namespace fiona::planning {

LmCut::LmCut(const GroundTask& task, Pace& pace, std::pmr::memory_resource* memory)
    : pace_(pace),
      nothing_(task.fact_count),
      goal_(task.fact_count + 1),
      needs_(memory),
      adds_(memory),
      needed_by_(memory),
      added_by_(memory),
      fresh_(memory),
      operators_(memory),
      reached_at_(task.fact_count + 2, kNoCost, memory),
      zones_(task.fact_count + 2, Zone::None, memory),
      queue_(memory),
      open_(memory),
      cut_(memory) {
  const auto add = [this](std::span<const Index> needs, std::span<const Index> adds, Cost cost) {
    if (needs.empty()) needs = {&nothing_, 1};
    needs_.add(needs);
    adds_.add(adds);
    fresh_.push_back({cost, kNoCost, kNone, static_cast<Index>(needs.size())});
  };
  for (std::size_t op = 0; op < task.operator_count(); ++op) add(task.needs[op], task.adds[op], task.costs[op]);
  add(task.goal, {&goal_, 1}, 0);
  needed_by_ = needs_.inverted(task.fact_count + 2);
  added_by_ = adds_.inverted(task.fact_count + 2);
}

Async<std::optional<Cost>> LmCut::estimate(State state) {
  operators_.assign(fresh_.begin(), fresh_.end());
  explore(state);
  if (reached_at_[goal_] == kNoCost) co_return std::nullopt;
  Cost total = 0;
  while (reached_at_[goal_] > 0) {
    if (pace_.look()) co_await pace_.pause();
    std::fill(zones_.begin(), zones_.end(), Zone::None);
    mark_goal_zone();
    find_cut(state);
    Cost least = kNoCost;
    for (const Index op : cut_) least = std::min(least, operators_[op].cost);
    total = sum(total, least);
    take_cut(least);
    explore_again();
  }
  co_return total;
}

void LmCut::reach(Index fact, Cost cost) {
  if (cost >= reached_at_[fact]) return;
  reached_at_[fact] = cost;
  queue_.push(cost, fact);
}

/// h_max of every fact: that of its cheapest achiever, which costs as much as its dearest need.
void LmCut::explore(State state) {
  std::fill(reached_at_.begin(), reached_at_.end(), kNoCost);
  queue_.clear();
  reach(nothing_, 0);
  for (Index fact = 0; fact < nothing_; ++fact)
    if (holds(state, fact)) reach(fact, 0);
  while (!queue_.empty()) {
    const auto [cost, fact] = queue_.pop();
    if (cost > reached_at_[fact]) continue;
    for (const Index op : needed_by_[fact]) {
      Operator& relaxed = operators_[op];
      if (--relaxed.missing > 0) continue;
      relaxed.supporter = fact;
      relaxed.supported_at = cost;
      for (const Index effect : adds_[op]) reach(effect, sum(cost, relaxed.cost));
    }
  }
}

/// The same after the operators of the cut have become cheaper: only what this changes.
void LmCut::explore_again() {
  queue_.clear();
  for (const Index op : cut_)
    for (const Index effect : adds_[op]) reach(effect, sum(operators_[op].supported_at, operators_[op].cost));
  while (!queue_.empty()) {
    const auto [cost, fact] = queue_.pop();
    if (cost > reached_at_[fact]) continue;
    for (const Index op : needed_by_[fact]) {
      Operator& relaxed = operators_[op];
      if (relaxed.supporter != fact || relaxed.supported_at <= cost) continue;
      for (const Index need : needs_[op])
        if (reached_at_[need] > reached_at_[relaxed.supporter]) relaxed.supporter = need;
      relaxed.supported_at = reached_at_[relaxed.supporter];
      for (const Index effect : adds_[op]) reach(effect, sum(relaxed.supported_at, relaxed.cost));
    }
  }
}

/// The facts from which nothing but operators that cost nothing leads to the goal.
void LmCut::mark_goal_zone() {
  zones_[goal_] = Zone::Goal;
  open_.assign(1, goal_);
  while (!open_.empty()) {
    const Index fact = open_.back();
    open_.pop_back();
    for (const Index op : added_by_[fact]) {
      const Operator& relaxed = operators_[op];
      if (relaxed.cost > 0 || relaxed.supporter == kNone || zones_[relaxed.supporter] == Zone::Goal) continue;
      zones_[relaxed.supporter] = Zone::Goal;
      open_.push_back(relaxed.supporter);
    }
  }
}

/// The operators that lead from what can be reached without entering the goal zone into it.
void LmCut::find_cut(State state) {
  cut_.clear();
  open_.clear();
  const auto enter = [this](Index fact) {
    if (zones_[fact] != Zone::None) return;
    zones_[fact] = Zone::Before;
    open_.push_back(fact);
  };
  enter(nothing_);
  for (Index fact = 0; fact < nothing_; ++fact)
    if (holds(state, fact)) enter(fact);
  while (!open_.empty()) {
    const Index fact = open_.back();
    open_.pop_back();
    for (const Index op : needed_by_[fact]) {
      if (operators_[op].supporter != fact) continue;
      const auto effects = adds_[op];
      if (std::any_of(effects.begin(), effects.end(), [&](Index effect) { return zones_[effect] == Zone::Goal; })) {
        cut_.push_back(op);
      } else {
        for (const Index effect : effects) enter(effect);
      }
    }
  }
}

void LmCut::take_cut(Cost cost) {
  for (const Index op : cut_) operators_[op].cost -= cost;
}

}  // namespace fiona::planning
