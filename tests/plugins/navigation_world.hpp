// Buildings as navigation gets them: from a file over the map server's contract, and planned by the symbolic planner.
#pragma once

#include <optional>
#include <string>

#include <fiona/building/building.hpp>
#include <fiona/time.hpp>

#include "level_map.hpp"
#include "level_plan.hpp"
#include "osm_text.hpp"
#include "planner.hpp"
#include "task_graph.hpp"

namespace fiona::guidance::world {

inline navigation::CommLevelMap told(const building::Building& building) {
  navigation::CommLevelMap map = map_server::level_map_of(building, "house", {});
  map.set_version(1);
  return map;
}

inline LevelPlan plan_of(const building::Building& building) { return read_level_plan(told(building)); }

/// What the planner's component would answer.
inline navigation::CommPlan solve(const navigation::CommPlanRequest& request) {
  const auto answer = planning::plan({.domain = request.domain(), .problem = request.problem(), .optimal = true});
  navigation::CommPlan plan;
  plan.set_outcome(answer.outcome == planning::PlanAnswer::Outcome::Solved       ? navigation::CommPlan::SOLVED
                   : answer.outcome == planning::PlanAnswer::Outcome::Unsolvable ? navigation::CommPlan::UNSOLVABLE
                                                                                 : navigation::CommPlan::BAD_INPUT);
  plan.set_message(answer.message);
  plan.set_cost(answer.cost);
  plan.set_is_optimal(answer.is_optimal);
  for (const auto& step : answer.steps) {
    navigation::CommPlanStep& added = *plan.add_steps();
    added.set_action(step.action);
    for (const std::string& argument : step.arguments) added.add_arguments(argument);
  }
  return plan;
}

inline navigation::CommPlan solve(const TaskGraph::Request& request) {
  navigation::CommPlanRequest question;
  question.set_domain(task_domain());
  question.set_problem(request.problem());
  return solve(question);
}

inline building::Route way(const LevelPlan& plan, building::PathPoint from, building::PathPoint to,
                           const building::RouteOptions& options = {}) {
  TaskGraph tasks(plan, from, options);
  const auto request = tasks.request(from, to);
  return request.route(solve(request));
}

inline TimePoint at(double seconds) { return TimePoint(Duration(static_cast<std::int64_t>(seconds * 1e9))); }

/// A corridor 30 x 3 m on level 0 with rooms A, B (for staff) and C north of it; stairs in the corridor's west end and
/// a lift in its east end lead to a corridor with room D on level 1. The main entrance is in the west.
inline building::Osm house() {
  building::Osm osm;
  osm.node(5, 5, 3, "door=hinged level=0").node(6, 15, 3, "door=hinged level=0 access=private");
  osm.node(7, 0, 1.5, "entrance=main level=0").node(8, 25, 3, "door=hinged level=0;1").node(9, -10, 1.5);
  osm.node(40, 2, 0.8).node(41, 8, 0.8).node(42, 28, 1.5, "highway=elevator level=0;1");
  osm.node(10, 0, 0).node(11, 30, 0).node(12, 30, 3).node(13, 0, 3);
  osm.way(10, {10, 11, 12, 8, 6, 5, 13, 7, 10}, "indoor=room level=0 name=Hall");
  osm.rectangle(20, 0, 3, 10, 8, "indoor=room level=0 name=A", {5});
  osm.rectangle(30, 10, 3, 20, 8, "indoor=room level=0 name=B access=private", {6});
  osm.rectangle(70, 20, 3, 30, 8, "indoor=room level=0 name=C", {8});
  osm.node(50, 0, 0).node(51, 30, 0).node(52, 30, 3).node(53, 0, 3);
  osm.way(50, {50, 51, 52, 8, 53, 50}, "indoor=room level=1 name=Gallery");
  osm.rectangle(80, 20, 3, 30, 8, "indoor=room level=1 name=D", {8});
  osm.way(60, {40, 41}, "highway=steps level=0;1 incline=up");
  osm.way(61, {7, 9}, "highway=footway");
  return osm;
}

}  // namespace fiona::guidance::world
