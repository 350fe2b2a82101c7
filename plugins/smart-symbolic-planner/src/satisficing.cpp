#include <algorithm>
#include <array>

#include "best_first.hpp"

namespace fiona::planning {
namespace {

/// How much work is worth a better plan: about that of the first one, and at least this much.
constexpr std::uint64_t kLeastWork = 1000;
constexpr std::array<Cost, 4> kWeights{5, 3, 2, 1};

void keep(const BestFirst& search, const GroundTask& task, SearchResult& result) {
  search.plan(result.plan);
  result.cost = 0;
  for (const Index op : result.plan) result.cost += task.costs[op];
  result.has_plan = true;
}

}  // namespace

Async<> search_satisficing(const GroundTask& task, SearchResult& result, Pace& pace) {
  std::pmr::memory_resource* memory = result.plan.get_allocator().resource();
  std::uint64_t work = 0;
  {
    BestFirst first(task, {.counts_costs = false}, pace, result.statistics, memory);
    auto running = first.run();
    if (co_await running == BestFirst::End::Exhausted) co_return;
    keep(first, task, result);
    result.is_optimal = result.cost == 0;
    work = std::max(first.evaluated(), kLeastWork);
  }
  for (const Cost weight : kWeights) {
    if (result.is_optimal) co_return;
    BestFirst better(task, {.counts_costs = true, .weight = weight, .bound = result.cost, .most_evaluated = work}, pace,
                     result.statistics, memory);
    auto running = better.run();
    const auto end = co_await running;
    if (end == BestFirst::End::Found) keep(better, task, result);
    result.is_optimal = end == BestFirst::End::Exhausted || result.cost == 0;
  }
}

}  // namespace fiona::planning
