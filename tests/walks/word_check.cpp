#include "word_check.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "fiona/building/geometry.hpp"

namespace fiona::walks {
namespace {

using building::Door;
using building::PathPoint;
using building::Point;
using building::Segment;
using hmi::Instruction;

constexpr double kHour_rad = std::numbers::pi / 6.0;
constexpr double kFree_m = 1.5, kLeastFree_m = 0.3;
constexpr double kInDoor_m = 0.1;
constexpr double kAtClimb_m = 0.5;
constexpr double kNear_m = 4.0, kBack_m = 4.0, kAhead_m = 10.0;
constexpr double kUnsure_m = 2.0;  ///< along the path: between two who measure where a walker is on it

bool is_door(Instruction::Kind kind) {
  return kind == Instruction::DOOR || kind == Instruction::ENTER || kind == Instruction::LEAVE;
}

/// It is to be done further on along the path.
bool leads_along(const Instruction& said) {
  return said.distance() > 0.0 && said.kind() >= Instruction::CONTINUE && said.kind() <= Instruction::LEAVE;
}

Segment leaf_of(const Door& door) {
  const Point half = building::left_of(door.normal) * (door.width_m / 2.0);
  return {door.at - half, door.at + half};
}

/// So far from the path, and from what is told, one may be.
double near_m(const Believed& walker) { return std::max(kNear_m, 2.0 * walker.sigma_m); }

std::string at_text(Point at) { return " at " + std::to_string(at.x_m) + ", " + std::to_string(at.y_m); }

/// The mark that a word speaks of: the nearest to where it says; else that place.
double spoken_of_m(const MeasuredPath& path, double told_m, double reach_m) {
  double best_m = told_m, least_m = reach_m;
  for (const Mark& mark : path.marks()) {
    const double away_m = std::abs(mark.at_m - told_m);
    if (mark.kind == Mark::Kind::Turn && away_m < least_m) best_m = mark.at_m, least_m = away_m;
  }
  return best_m;
}

/// One is led to the next thing to do, and no further.
double free_to_next_m(const MeasuredPath& path, double at_m) {
  double free_m = kFree_m;
  for (const Mark& mark : path.marks()) {
    if (mark.at_m > at_m - 0.5) free_m = std::min(free_m, std::max(kLeastFree_m, mark.at_m - at_m - kLeastFree_m));
  }
  return free_m;
}

}  // namespace

std::string WordCheck::fault_of(const navigation::CommPath& path) const {
  for (int i = 0; i < path.waypoints_size(); ++i) {
    if (std::string fault = fault_at(path.waypoints(i)); !fault.empty()) return fault;
    if (i == 0) continue;
    if (std::string fault = fault_between(path.waypoints(i - 1), path.waypoints(i)); !fault.empty()) return fault;
  }
  return {};
}

std::string WordCheck::fault_at(const localisation::CommPosition& place) const {
  const Point at{place.x(), place.y()};
  const building::Room* room = building_.room_at(at, place.z());
  if (room && room->access > profile_.access) return "a path through " + room->name + at_text(at);
  const bool outdoors = !room && !building::contains(building_.plan().outline.outer, at) &&
                        std::none_of(building_.doors().begin(), building_.doors().end(),
                                     [&](const Door& door) { return distance_m(door.at, at) < kInDoor_m; });
  return outdoors && !profile_.outdoors ? "a path outdoors" + at_text(at) : "";
}

std::string WordCheck::fault_between(const localisation::CommPosition& from,
                                     const localisation::CommPosition& to) const {
  const Point a{from.x(), from.y()}, b{to.x(), to.y()};
  if (from.z() != to.z()) return fault_of_climb(a, b);
  if (building_.walls_crossed(a, b, to.z()).walls > 0) return "a path through a wall" + at_text(b);
  for (const Door& door : building_.doors()) {
    if (door.level != to.z() || door.access <= profile_.access) continue;
    if (distance_m(door.at, b) < kInDoor_m || building::crossing({a, b}, leaf_of(door)))
      return "a path through a locked door" + at_text(door.at);
  }
  return {};
}

std::string WordCheck::fault_of_climb(Point from, Point to) const {
  const bool by_lift = distance_m(from, to) < 0.3;
  if (by_lift ? !profile_.lift : !profile_.stairs) return by_lift ? "a path by lift" : "a path by stairs";
  for (const building::Connector& connector : building_.connectors()) {
    const bool is_it = std::any_of(connector.path.begin(), connector.path.end(),
                                   [&](const PathPoint& point) { return distance_m(point.at, from) < kAtClimb_m; });
    if (is_it && connector.access > profile_.access) return "a path by locked stairs or lift" + at_text(from);
  }
  return {};
}

std::string WordCheck::fault_of(const Instruction& said, const Believed& walker, const MeasuredPath& path,
                                double at_m) const {
  if (said.kind() == Instruction::LIFT && !profile_.lift) return "the lift";
  if ((said.kind() == Instruction::STAIRS || said.kind() == Instruction::ESCALATOR) && !profile_.stairs)
    return "stairs";
  if (said.kind() == Instruction::LEAVE && !profile_.outdoors) return "out of the building";
  if (leads_along(said) && is_walled_off(walker, path, at_m)) return "along a path behind a wall";
  if (is_door(said.kind())) return fault_of_door(said, walker, path, at_m);
  return leads_into_wall(said, walker, path, at_m) ? "into a wall" : "";
}

/// Whether a wall is between the walker and all of the path that is near. On which side of one that is nearer than two
/// standard deviations somebody is, is not known.
bool WordCheck::is_walled_off(const Believed& walker, const MeasuredPath& path, double at_m) const {
  bool is_near = false;
  for (double along_m = at_m - kBack_m; along_m < at_m + kAhead_m; along_m += 0.2) {
    const PathPoint place = path.place(std::clamp(along_m, 0.0, path.end_m()));
    const double away_m = distance_m(place.at, walker.place.at);
    if (away_m > near_m(walker)) continue;
    const bool between_levels = std::abs(place.level - std::round(place.level)) > 0.05;
    if (away_m <= 2.0 * walker.sigma_m || between_levels) return false;
    const Point nearer = walker.place.at + (place.at - walker.place.at) * (2.0 * walker.sigma_m / away_m);
    if (building_.walls_crossed(nearer, place.at, place.level).walls == 0) return false;
    is_near = true;
  }
  return is_near;
}

/// The one on the path that is nearest to as far along it as was said; not further away than that.
std::string WordCheck::fault_of_door(const Instruction& said, const Believed& walker, const MeasuredPath& path,
                                     double at_m) const {
  const Door* told = nullptr;
  double least_m = std::numeric_limits<double>::max();
  for (const Door& door : building_.doors()) {
    const double away_m = distance_m(door.at, walker.place.at);
    if (std::abs(door.level - said.level()) > 0.1 || away_m > said.distance() + near_m(walker)) continue;
    const double door_m = path.nearest_m({door.at, door.level}, 0.0, path.end_m());
    if (distance_m(path.place(door_m).at, door.at) > kInDoor_m) continue;
    const double off_m = std::abs(door_m - at_m - said.distance());
    if (off_m < least_m) told = &door, least_m = off_m;
  }
  if (told == nullptr) return "through a door where there is none";
  return is_shut(*told) ? "through a door that is locked" + at_text(told->at) : "";
}

bool WordCheck::is_shut(const Door& door) const {
  return door.access > profile_.access || (door.entrance && !profile_.outdoors);
}

/// The hour stands for all directions that are nearest to it.
bool WordCheck::leads_into_wall(const Instruction& said, const Believed& walker, const MeasuredPath& path,
                                double at_m) const {
  const bool leads =
      said.kind() == Instruction::START || said.kind() == Instruction::CONTINUE || said.kind() == Instruction::TURN;
  if (!leads || said.hour() == hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED || !walker.heading_rad) return false;
  const bool ahead = said.kind() == Instruction::TURN && said.distance() > 0.0;
  const double spot_m = ahead ? spoken_of_m(path, at_m + said.distance(), kUnsure_m + walker.sigma_m) : at_m;
  const double wanted_m = ahead ? kFree_m : free_to_next_m(path, at_m);
  std::vector<PathPoint> starts{ahead ? path.place(spot_m) : walker.place};
  if (!ahead && !walker.is_sure()) starts.push_back(path.place(at_m));
  for (const PathPoint& start : starts) {
    for (const double look_rad : looks_rad(walker, path.direction(std::max(0.0, spot_m - 0.1)))) {
      if (is_free(start, look_rad + static_cast<int>(said.hour()) * kHour_rad, wanted_m)) return false;
    }
  }
  return true;
}

/// Who is not sure of their place, and walks along the path, may be told of turns as the path has them.
std::vector<double> WordCheck::looks_rad(const Believed& walker, Point along) const {
  std::vector<double> looks{*walker.heading_rad};
  if (!walker.is_sure() && along != Point{})
    looks.push_back(std::atan2(along.x_m, along.y_m) + building_.reference().heading_rad);
  return looks;
}

bool WordCheck::is_free(const PathPoint& from, double bearing_rad, double wanted_m) const {
  std::vector<Segment> barriers;
  const auto add = [&](const Segment& one, double level) {
    if (std::abs(level - from.level) < 0.3 && distance_m(from.at, one) < wanted_m) barriers.push_back(one);
  };
  for (const building::Wall& wall : building_.walls()) add(wall.segment, wall.level);
  for (const Door& door : building_.doors()) {
    if (is_shut(door)) add(leaf_of(door), door.level);
  }
  for (double off = -0.5; off <= 0.5; off += 0.125) {
    const double local = bearing_rad + off * kHour_rad - building_.reference().heading_rad;
    const Segment way{from.at, from.at + Point{std::sin(local), std::cos(local)} * wanted_m};
    if (std::none_of(barriers.begin(), barriers.end(),
                     [&](const Segment& one) { return building::crossing(way, one).has_value(); }))
      return true;
  }
  return false;
}

}  // namespace fiona::walks
