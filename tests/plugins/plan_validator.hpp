#pragma once

#include <string>
#include <vector>

namespace fiona::testing {

/// One step as a person writes it: "(drive truck-1 a b)".
using PlanText = std::vector<std::string>;

struct Validation {
  std::string error{};  ///< empty: the plan is executable and reaches the goal
  double cost = 0;      ///< by the problem's metric; without one, the number of steps
};

/// Executes a plan by the meaning of PDDL's words alone: a second opinion, which shares nothing with the planner. The
/// texts are right PDDL; nonsense in them ends in an error too, but not in a helpful one.
Validation validate(const std::string& domain, const std::string& problem, const PlanText& plan);

}  // namespace fiona::testing
