#include <algorithm>
#include <array>

#include "best_first.hpp"

namespace fiona::planning {
namespace {

/// How much work is worth a better plan: that of the first one; where this is less, so many estimates, or so many
/// operators looked at in them.
constexpr std::uint64_t kLeastEstimates = 5000;
constexpr std::uint64_t kLeastOperators = 30'000'000;
/// Of the estimate in weighted A*: each search begins where the one before has found no cheaper plan.
constexpr std::array<Cost, 4> kWeights{5, 3, 2, 1};

void keep(const BestFirst& search, const GroundTask& task, SearchResult& result) {
  search.plan(result.plan);
  result.cost = 0;
  for (const Index op : result.plan) result.cost = sum(result.cost, task.costs[op]);
  result.has_plan = true;
}

}  // namespace

Async<> search_satisficing(const GroundTask& task, SearchResult& result, Pace& pace) {
  std::pmr::memory_resource* memory = result.plan.get_allocator().resource();
  std::uint64_t work = 0;
  {
    BestFirst first(task, {.counts_costs = false}, pace, result.statistics, memory);
    auto running = first.run();
    const auto end = co_await running;
    if (end == BestFirst::End::Exhausted) co_return;
    keep(first, task, result);
    const std::uint64_t affordable = kLeastOperators / std::max<std::uint64_t>(1, task.operator_count());
    work = std::max(first.evaluated(), std::min(kLeastEstimates, affordable));
  }
  for (std::size_t i = 0; i < kWeights.size() && result.cost > 0 && !result.is_optimal && work > 0; ++i) {
    BestFirst better(task, {.weight = kWeights[i], .bound = result.cost, .most_evaluated = work}, pace,
                     result.statistics, memory);
    auto running = better.run();
    const auto end = co_await running;
    if (end == BestFirst::End::Found) keep(better, task, result);
    result.is_optimal = end == BestFirst::End::Exhausted;
    work -= better.evaluated();
  }
  result.is_optimal |= result.cost == 0;
}

}  // namespace fiona::planning
