#include "fiona/plugin.hpp"

#include "symbolic_planner.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::planning::SymbolicPlanner>("smart-symbolic-planner",
                                               "finds plans for problems in PDDL: which actions reach a goal");
}
