#pragma once

#include "budget.hpp"
#include "fiona/async.hpp"
#include "ground_task.hpp"
#include "lifted_task.hpp"

namespace fiona::planning {

/// Instantiates the actions that can be reached if nothing is ever deleted, each by joining its conditions with the
/// atoms reached so far (compare Helmert, "Concise finite-domain representations for PDDL planning tasks", AIJ 173,
/// 2009, section 6), then leaves out what cannot help on the way to the goal. Throws PddlError, OutOfTime, OutOfMemory.
Async<> ground(const LiftedTask& task, GroundTask& ground_task, Pace& pace);

}  // namespace fiona::planning
