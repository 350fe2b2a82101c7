#pragma once

#include "budget.hpp"
#include "fiona/async.hpp"
#include "ground_task.hpp"

namespace fiona::planning {

/// Leaves out facts and operators from which no way leads to the goal.
Async<> prune(GroundTask& task, Pace& pace, std::pmr::memory_resource* memory);

}  // namespace fiona::planning
