#include "maneuvers.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include <fiona/building/geometry.hpp>

namespace fiona::guidance {
namespace {

using building::Passage;
using building::PathPoint;
using building::Point;
using hmi::Instruction;

constexpr double kShortest_m = 0.05;
constexpr double kOneTurn_m = 1.5;
constexpr double kTurn_rad = 40.0 * std::numbers::pi / 180.0;
/// A turn that is so near before a door, and towards it, is told with the door: there is no other way to turn into.
constexpr double kTurnsToDoor_m = 2.0;
constexpr double kTowards_rad = 20.0 * std::numbers::pi / 180.0;

double length_of(const building::RoutePoint& a, const building::RoutePoint& b) {
  const double length = distance_m(a.at, b.at);
  if (a.level == b.level) return length;
  return length > 0.3 ? length : Path::kLevel_m * std::abs(a.level - b.level);
}

/// Reads a route from its start to its end.
class RouteReader {
 public:
  explicit RouteReader(const Path& path) : path_(path), points_(path.route().points) {}

  std::vector<Maneuver> read() {
    for (at_ = 0; at_ + 1 < points_.size();) {
      const Passage passage = points_[at_ + 1].passage;
      if (passage == Passage::Walk) {
        walk();
      } else {
        pass(passage);
      }
    }
    found_.push_back({Instruction::ARRIVE, path_.end_m(), path_.end_m(), {}, std::nullopt});
    return std::move(found_);
  }

 private:
  Point direction(std::size_t segment) const { return building::unit(points_[segment + 1].at - points_[segment].at); }

  /// All turns up to the next door or stairs.
  void walk() {
    std::size_t end = at_;
    while (end + 1 < points_.size() && points_[end + 1].passage == Passage::Walk) ++end;
    for (std::size_t i = at_; i < end;) {
      std::size_t last = i;
      while (last + 1 < end && path_.at_m(last + 1) - path_.at_m(i) < kOneTurn_m) ++last;
      const Point out = direction(last);
      if (before_ != Point{} && std::abs(clockwise_rad(before_, out)) > kTurn_rad) {
        found_.push_back({Instruction::TURN, path_.at_m(i), path_.at_m(last), out, std::nullopt});
        before_ = out;
        i = last + 1;
      } else if (before_ != Point{} && std::abs(clockwise_rad(before_, direction(i))) > kTurn_rad) {
        before_ = out;  // to the side and back within a step or two: on the whole it goes straight on
        i = last + 1;
      } else {
        before_ = direction(i);
        ++i;
      }
    }
    at_ = end;
  }

  void pass(Passage passage) {
    std::size_t end = at_ + 1;
    while (end + 1 < points_.size() && points_[end + 1].passage == passage) ++end;
    Maneuver made{kind_of(passage, end), path_.at_m(at_), path_.at_m(end), {}, std::nullopt};
    for (std::size_t i = at_; i < end && made.out == Point{}; ++i) made.out = direction(i);
    if (points_[at_].level != points_[end].level) {
      made.to_level = points_[end].level;
    } else {
      made.rise = points_[at_ + 1].rise;
    }
    const bool is_flat = passage == Passage::Ramp && !made.to_level;
    if (passage == Passage::Door && turns_to(made)) found_.pop_back();
    if (!is_flat) found_.push_back(made);
    before_ = passage == Passage::Lift ? Point{} : direction(end - 1);
    at_ = end;
  }

  bool turns_to(const Maneuver& door) const {
    if (found_.empty() || found_.back().kind != Instruction::TURN) return false;
    const Maneuver& turn = found_.back();
    return door.at_m - turn.end_m <= kTurnsToDoor_m && std::abs(clockwise_rad(turn.out, door.out)) < kTowards_rad;
  }

  Instruction::Kind kind_of(Passage passage, std::size_t end) const {
    switch (passage) {
      case Passage::Stairs: return Instruction::STAIRS;
      case Passage::Escalator: return Instruction::ESCALATOR;
      case Passage::Ramp: return Instruction::RAMP;
      case Passage::Lift: return Instruction::LIFT;
      default: break;
    }
    const auto outdoors = [this](std::size_t point) { return point < points_.size() && points_[point].outdoors; };
    if (outdoors(at_) && !outdoors(end + 1)) return Instruction::ENTER;
    if (!outdoors(at_) && outdoors(end + 1)) return Instruction::LEAVE;
    return Instruction::DOOR;
  }

  const Path& path_;
  const std::vector<building::RoutePoint>& points_;
  std::vector<Maneuver> found_;
  std::size_t at_ = 0;
  Point before_{};  ///< the direction in which the way arrives
};

/// Points that lie on one another make no direction.
building::Route thinned(building::Route route) {
  std::vector<building::RoutePoint> kept;
  for (std::size_t i = 0; i < route.points.size(); ++i) {
    const building::RoutePoint& point = route.points[i];
    const bool same =
        !kept.empty() && kept.back().level == point.level && distance_m(kept.back().at, point.at) < kShortest_m;
    if (!same) {
      kept.push_back(point);
    } else if (i + 1 == route.points.size() && kept.size() > 1) {
      kept.back().at = point.at;
    }
  }
  if (kept.size() == 1) kept.push_back(kept.front());
  route.points = std::move(kept);
  return route;
}

}  // namespace

Path::Path(building::Route route) : route_(thinned(std::move(route))), at_m_{0.0} {
  for (std::size_t i = 1; i < route_.points.size(); ++i) {
    at_m_.push_back(at_m_.back() + length_of(route_.points[i - 1], route_.points[i]));
  }
}

std::size_t Path::segment(double at_m) const {
  const auto next = std::upper_bound(at_m_.begin(), at_m_.end(), at_m);
  const auto index = static_cast<std::size_t>(next - at_m_.begin());
  return std::clamp<std::size_t>(index, 1, at_m_.size() - 1) - 1;
}

PathPoint Path::place(double at_m) const {
  const std::size_t i = segment(at_m);
  const double length = at_m_[i + 1] - at_m_[i];
  const double share = length > 0.0 ? std::clamp((at_m - at_m_[i]) / length, 0.0, 1.0) : 0.0;
  const auto& a = route_.points[i];
  const auto& b = route_.points[i + 1];
  return {a.at + (b.at - a.at) * share, a.level + (b.level - a.level) * share};
}

Passage Path::passage(double at_m) const { return route_.points[segment(at_m) + 1].passage; }

Point Path::direction(double at_m) const {
  const std::size_t i = segment(at_m);
  return building::unit(route_.points[i + 1].at - route_.points[i].at);
}

Path::Match Path::match(const PathPoint& place, double from_m, double to_m, const Hidden& hidden) const {
  constexpr double kHidden_m = 4.0;
  constexpr double kLevelWeight_m = 6.0;  // half a level off is 3 m off
  Match best{from_m, std::numeric_limits<double>::max(), 0.0, false};
  double best_score = std::numeric_limits<double>::max();
  for (std::size_t i = segment(from_m); i + 1 < at_m_.size() && at_m_[i] <= to_m; ++i) {
    const auto& a = route_.points[i];
    const auto& b = route_.points[i + 1];
    const Point along = b.at - a.at;
    const double length2 = dot(along, along);
    const double rise = b.level - a.level;
    double share = 0.0;
    if (length2 > 0.09) {
      share = dot(place.at - a.at, along) / length2;
    } else if (rise != 0.0) {
      share = (place.level - a.level) / rise;
    }
    share = std::clamp(share, 0.0, 1.0);
    const double length = at_m_[i + 1] - at_m_[i];
    const double at = std::clamp(at_m_[i] + share * length, from_m, to_m);
    if (length > 0.0) share = std::clamp((at - at_m_[i]) / length, 0.0, 1.0);
    const PathPoint on_path{a.at + along * share, a.level + rise * share};
    Match match{at, distance_m(place.at, on_path.at), std::abs(place.level - on_path.level), false};
    double score = std::hypot(match.off_m, kLevelWeight_m * match.off_levels);
    if (score >= best_score) continue;
    match.hidden = hidden(on_path, b.passage);
    if (match.hidden) score += kHidden_m;
    if (score < best_score - 1e-9) best = match, best_score = score;
  }
  return best;
}

double clockwise_rad(Point from, Point to) { return -std::atan2(cross(from, to), dot(from, to)); }

std::vector<Maneuver> maneuvers(const Path& path) { return RouteReader(path).read(); }

}  // namespace fiona::guidance
