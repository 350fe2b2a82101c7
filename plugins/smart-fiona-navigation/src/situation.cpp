#include "situation.hpp"

#include <cmath>

#include <fiona/building/geometry.hpp>

namespace fiona::guidance {

using building::PathPoint;
using building::Point;
using hmi::Instruction;

bool Situation::is_at_maneuver() const { return to_next_m() < 1.0 && maneuver().kind != Instruction::ARRIVE; }

bool Situation::is_at_door() const {
  constexpr double kAtDoor_m = 2.5;
  const PathPoint door = path.place(maneuver().at_m);
  return distance_m(walker.place.at, door.at) < kAtDoor_m && !plan.walled(walker.place.at, door.at, door.level);
}

bool Situation::is_in_front_of(const Maneuver& door) const {
  constexpr double kAside_m = 0.5;  // from there on one looks at the wall
  return std::abs(cross(walker.place.at - path.place(door.at_m).at, door.out)) < kAside_m;
}

bool Situation::has_arrived() const {
  constexpr double kThere_m = 1.5;
  if (walker.sigma_m > kMostThere_m) return false;
  const PathPoint end = path.place(path.end_m());
  // Who has not gone through the last door yet is led on.
  const bool is_last = maneuver().kind == Instruction::ARRIVE;
  if (!is_last && plan.behind_door(walker.place.at, end.at, end.level)) return false;
  const double there_m = std::clamp(walker.sigma_m, kThere_m, kMostThere_m);
  return distance_m(walker.place.at, end.at) <= there_m && std::abs(walker.place.level - end.level) < 0.3 &&
         !plan.walled(walker.place.at, end.at, end.level);
}

bool Situation::waits() const {
  constexpr double kInLift_m = 1.0;  // so near to where a lift is taken one waits, as in its cabin
  const Maneuver& todo = maneuver();
  if (todo.kind == Instruction::LIFT) {
    const bool has_door = next > 0 && is_lift_door(next - 1);
    return at_m > (has_door ? maneuvers[next - 1].at_m : todo.at_m) - kInLift_m;
  }
  return is_lift_door() ? at_m > todo.at_m - kInLift_m : todo.changes_level() && at_m > todo.at_m;
}

bool Situation::is_lift_door(std::size_t index) const {
  if (index + 1 >= maneuvers.size() || !maneuvers[index].is_door()) return false;
  const Maneuver& behind = maneuvers[index + 1];
  // One that is walked through on its level leads nowhere.
  return behind.kind == Instruction::LIFT && behind.to_level && behind.at_m - maneuvers[index].end_m <= kNow_m;
}

bool Situation::is_near_end(double within_m) const {
  return maneuver().kind == Instruction::ARRIVE && to_next_m() < within_m && walker.sigma_m > kMostThere_m;
}

bool Situation::is_close_to_other_level() const {
  if (next + 1 == maneuvers.size()) return false;
  const Maneuver& behind = maneuvers[next + 1];
  return behind.changes_level() && behind.at_m - maneuver().end_m < kNow_m;
}

std::optional<double> Situation::then_rad() const {
  constexpr double kThen_m = 3.0;  // what is further behind is told by itself
  const bool on_foot = maneuver().is_door() || maneuver().kind == Instruction::STAIRS;
  if (!on_foot || next + 1 == maneuvers.size()) return std::nullopt;
  const Maneuver& behind = maneuvers[next + 1];
  const double turn_rad = clockwise_rad(path.direction(maneuver().end_m - 0.01), behind.out);
  const bool turns = behind.kind == Instruction::TURN || (behind.is_door() && std::abs(turn_rad) > kAstray_rad);
  return turns && behind.at_m - maneuver().end_m <= kThen_m ? std::optional(turn_rad) : std::nullopt;
}

std::optional<double> Situation::turn_to(Point direction) const {
  if (!walker.heading_rad || direction == Point{}) return std::nullopt;
  const double bearing_rad = std::atan2(direction.x_m, direction.y_m) + plan.heading_rad;
  return std::remainder(bearing_rad - *walker.heading_rad, 2.0 * std::numbers::pi);
}

bool Situation::looks_along(Point direction) const {
  const auto rest_rad = turn_to(direction);
  return rest_rad && std::abs(*rest_rad) < kAlong_rad;
}

bool Situation::looks_elsewhere(Point direction) const {
  const auto rest_rad = turn_to(direction);
  return rest_rad && std::abs(*rest_rad) > kAstray_rad;
}

bool Situation::walled(Point a, Point b) const {
  const auto level = plan.level_near(walker.place.level, 0.1);
  return level && plan.walled(a, b, *level);
}

}  // namespace fiona::guidance
