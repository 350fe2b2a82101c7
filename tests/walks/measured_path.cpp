#include "measured_path.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "fiona/building/geometry.hpp"

namespace fiona::walks {
namespace {

using building::PathPoint;
using building::Point;

constexpr double kLevel_m = 3.0;  ///< of a climb without length in the plane, as a path is told
/// More has to be told, less need not be; in between one may tell it.
constexpr double kTurn_rad = 50.0 * std::numbers::pi / 180.0;
constexpr double kBend_rad = 30.0 * std::numbers::pi / 180.0;
constexpr double kAround_m = 1.5;  ///< of a corner: so far before and behind it directions are taken
constexpr double kInPlace_m = 0.3, kSamePoint_m = 0.1;
constexpr double kOneLevel_m = 6.0;  ///< in the plane is as far as a level

double length_of(const PathPoint& a, const PathPoint& b) {
  const double length = distance_m(a.at, b.at);
  if (a.level == b.level) return length;
  return length > kInPlace_m ? length : kLevel_m * std::abs(a.level - b.level);
}

double angle(Point from, Point to) { return std::abs(std::atan2(cross(from, to), dot(from, to))); }

bool is_in_door(const building::Building& building, const PathPoint& place) {
  return std::any_of(building.doors().begin(), building.doors().end(), [&](const building::Door& door) {
    return door.level == place.level && distance_m(door.at, place.at) < kSamePoint_m;
  });
}

}  // namespace

MeasuredPath::MeasuredPath(const building::Building& building, const navigation::CommPath& path) {
  for (const auto& way_point : path.waypoints()) {
    const PathPoint next{{way_point.x(), way_point.y()}, way_point.z()};
    at_m_.push_back(points_.empty() ? 0.0 : at_m_.back() + length_of(points_.back(), next));
    points_.push_back(next);
  }
  if (points_.size() == 1) points_.push_back(points_.front()), at_m_.push_back(0.0);
  find_marks(building);
}

std::size_t MeasuredPath::segment(double at_m) const {
  const auto next = std::upper_bound(at_m_.begin(), at_m_.end(), at_m);
  return std::clamp<std::size_t>(static_cast<std::size_t>(next - at_m_.begin()), 1, at_m_.size() - 1) - 1;
}

PathPoint MeasuredPath::place(double at_m) const {
  const std::size_t i = segment(at_m);
  const double length = at_m_[i + 1] - at_m_[i];
  const double share = length > 0.0 ? std::clamp((at_m - at_m_[i]) / length, 0.0, 1.0) : 0.0;
  return {points_[i].at + (points_[i + 1].at - points_[i].at) * share,
          points_[i].level + (points_[i + 1].level - points_[i].level) * share};
}

Point MeasuredPath::direction(double at_m) const {
  const std::size_t i = segment(at_m);
  return building::unit(points_[i + 1].at - points_[i].at);
}

double MeasuredPath::nearest_m(const PathPoint& to, double from_m, double until_m) const {
  constexpr double kStep_m = 0.1;
  double best_m = from_m;
  double least = std::numeric_limits<double>::max();
  for (double at = std::max(0.0, from_m); at <= std::min(until_m, end_m()) + kStep_m; at += kStep_m) {
    const PathPoint here = place(at);
    const double away = std::hypot(distance_m(here.at, to.at), kOneLevel_m * (here.level - to.level));
    if (away < least) best_m = std::min(at, end_m()), least = away;
  }
  return best_m;
}

/// Between what lies before and behind a corner, so that one in two parts is a corner.
double MeasuredPath::bend_rad(std::size_t point) const {
  const Point here = points_[point].at;
  const Point in = here - place(at_m_[point] - kAround_m).at;
  const Point out = place(at_m_[point] + kAround_m).at - here;
  return in == Point{} || out == Point{} ? 0.0 : angle(in, out);
}

/// A door is three places of a path: before it, in it, behind it.
void MeasuredPath::find_marks(const building::Building& building) {
  double since_m = 0.0;
  const auto mark = [&](Mark::Kind kind, std::size_t point) {
    marks_.push_back({kind, at_m_[point], at_m_[point] - since_m});
    since_m = at_m_[point];
  };
  for (std::size_t i = 0; i + 1 < points_.size(); ++i) {
    const bool climbs = points_[i].level != points_[i + 1].level;
    const bool climbed = i > 0 && points_[i - 1].level != points_[i].level;
    if (climbed || is_in_door(building, points_[i])) {
      since_m = at_m_[climbed ? i : i + 1];
    } else if (climbs) {
      mark(Mark::Kind::Climb, i);
    } else if (is_in_door(building, points_[i + 1])) {
      mark(Mark::Kind::Door, i);
    } else if (i > 0 && bend_rad(i) > kTurn_rad) {
      mark(Mark::Kind::Turn, i);
    } else if (i > 0 && bend_rad(i) > kBend_rad) {
      since_m = at_m_[i];
    }
  }
}

}  // namespace fiona::walks
