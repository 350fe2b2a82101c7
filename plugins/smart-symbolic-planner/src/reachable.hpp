#pragma once

#include "atom_table.hpp"
#include "budget.hpp"
#include "fiona/async.hpp"
#include "ground_task.hpp"
#include "join.hpp"
#include "lifted_task.hpp"

namespace fiona::planning {

/// Atoms and instances of actions that can be reached if nothing is ever deleted.
struct Reachable {
  explicit Reachable(std::pmr::memory_resource* memory) : atoms(memory), actions(memory), bindings(memory) {}
  AtomTable atoms;
  Index first_fluent = 0;   ///< the atoms before it are of static predicates, and hold
  Index first_reached = 0;  ///< the atoms before it hold in the beginning
  List<Index> actions;
  Lists bindings;  ///< for each of them the objects
};

Async<> reach(const LiftedTask& task, Reachable& reachable, Pace& pace);

}  // namespace fiona::planning
