#include "planner.hpp"

#include <new>
#include <utility>

#include "grounder.hpp"
#include "lifted_task.hpp"

namespace fiona::planning {
namespace {

using Outcome = PlanAnswer::Outcome;

double number_of(Cost cost) { return static_cast<double>(cost) / static_cast<double>(kCostUnit); }

std::string seconds_text(std::chrono::nanoseconds time) {
  const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(time).count();
  return ms % 1000 == 0 ? std::to_string(ms / 1000) + " s" : std::to_string(ms) + " ms";
}

}  // namespace

Planning::Planning(const PlanRequest& request)
    : request_(request), memory_(request.memory_bound), pace_(request.time_bound), work_(run()) {}

bool Planning::advance(std::chrono::nanoseconds slice) {
  if (work_.done()) return true;
  pace_.run(work_, slice);
  answer_.time = pace_.spent();
  answer_.memory = memory_.peak();
  return work_.done();
}

Async<> Planning::run() {
  try {
    auto solving = solve();
    co_await solving;
  } catch (const PddlError& error) {
    answer_.outcome = Outcome::BadInput;
    answer_.fault = error.place();
    answer_.message = error.sentence();
  } catch (const OutOfTime&) {
    answer_.outcome = Outcome::OutOfTime;
    answer_.message = "no plan was found within the time bound of " + seconds_text(request_.time_bound);
  } catch (const std::bad_alloc&) {
    answer_.outcome = Outcome::OutOfMemory;
    answer_.message = "the machine has no more memory for this planning";
  } catch (const OutOfMemory&) {
    answer_.outcome = Outcome::OutOfMemory;
    answer_.message =
        "no plan was found within the memory bound of " + std::to_string(request_.memory_bound >> 20) + " MiB";
  }
}

Async<> Planning::solve() {
  LiftedTask lifted(&memory_);
  read_domain(lifted, request_.domain, pace_);
  auto reading = read_problem(lifted, request_.problem, pace_);
  co_await reading;
  if (pace_.look()) co_await pace_.pause();
  GroundTask task(&memory_);
  auto grounding = ground(lifted, task, pace_);
  co_await grounding;
  SearchResult result(&memory_);
  try {
    if (task.is_solvable) {
      auto searching = request_.optimal ? search_optimal(task, result, pace_) : search_satisficing(task, result, pace_);
      co_await searching;
    }
  } catch (const OutOfTime&) {
    answer_.statistics = result.statistics;
    if (!result.has_plan) throw;
  } catch (const OutOfMemory&) {
    answer_.statistics = result.statistics;
    if (!result.has_plan) throw;
  }
  take(lifted, task, result);
}

void Planning::take(const LiftedTask& lifted, const GroundTask& task, const SearchResult& result) {
  answer_.statistics = result.statistics;
  if (!result.has_plan) {
    answer_.outcome = Outcome::Unsolvable;
    answer_.message = "no sequence of actions reaches the goal";
    return;
  }
  if (result.plan.size() > kMostSteps) {
    answer_.outcome = Outcome::OutOfMemory;
    answer_.message = "the plan has " + std::to_string(result.plan.size()) + " steps, more than the " +
                      std::to_string(kMostSteps) + " that an answer may have";
    return;
  }
  for (const Index op : result.plan) {
    PlanStep step{std::string(lifted.actions[task.actions[op]].name), {}, number_of(task.costs[op])};
    for (const Index object : task.arguments[op]) step.arguments.emplace_back(lifted.objects[object]);
    answer_.steps.push_back(std::move(step));
  }
  answer_.outcome = Outcome::Solved;
  answer_.cost = number_of(result.cost);
  answer_.is_optimal = result.is_optimal;
}

PlanAnswer plan(const PlanRequest& request) {
  Planning planning(request);
  while (!planning.advance(std::chrono::hours(1))) {
  }
  return planning.answer();
}

}  // namespace fiona::planning
