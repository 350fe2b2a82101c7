#pragma once

#include <cstdint>
#include <optional>

#include "budget.hpp"
#include "fiona/async.hpp"
#include "ground_task.hpp"

namespace fiona::planning {

struct Statistics {
  std::uint64_t expanded = 0;
  std::uint64_t generated = 0;
};

/// What a search leaves behind, also when OutOfTime or OutOfMemory ended it.
struct SearchResult {
  explicit SearchResult(std::pmr::memory_resource* memory) : plan(memory) {}
  bool has_plan = false;
  List<Index> plan;  ///< operators
  Cost cost = 0;
  bool is_optimal = false;
  Statistics statistics{};
};

/// A plan soon: greedy best-first search, then better ones for about as much work again. No plan: there is none.
Async<> search_satisficing(const GroundTask& task, SearchResult& result, Pace& pace);

/// A plan than which none costs less: A* with the LM-cut heuristic. No plan: there is none.
Async<> search_optimal(const GroundTask& task, SearchResult& result, Pace& pace);

}  // namespace fiona::planning
