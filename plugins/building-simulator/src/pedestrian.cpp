#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <utility>

#include "fiona/simulator/walker.hpp"

namespace fiona::simulator {
namespace {

using building::Passage;
using building::PathPoint;
using building::Point;

constexpr double kTick_s = 0.005;
/// Corners are rounded over this much way on either side: as people walk, and so that the heading has a rate.
constexpr double kRounding_m = 0.35;
constexpr double kSlowest_mps = 0.15;
constexpr double kLiftDoors_s = 6.0;
constexpr std::size_t kMostWaypoints = 256;
constexpr double kFullTurn = 2.0 * std::numbers::pi;

double wrap(double angle_rad) {
  const double turned = std::fmod(angle_rad, kFullTurn);
  return turned < 0.0 ? turned + kFullTurn : turned;
}

/// -pi .. pi
double difference(double to_rad, double from_rad) { return std::remainder(to_rad - from_rad, kFullTurn); }

bool turns_back(Point before, Point corner, Point after) {
  constexpr double kSharpest = -0.3;  // cosine: about 107 degrees
  return dot(building::unit(corner - before), building::unit(after - corner)) < kSharpest;
}

constexpr double kLiftAcceleration_mps2 = 0.8;
constexpr double kLiftJerk_mps3 = 1.0;
/// The speed is a step that lasts for the way, smoothed by how long the lift speeds up, and that by how long it takes
/// to do so with all its acceleration.
constexpr double kSpeedsUp_s = building::kLiftPace_mps / kLiftAcceleration_mps2;
constexpr double kEases_s = kLiftAcceleration_mps2 / kLiftJerk_mps3;

}  // namespace

LiftRide::LiftRide(double rise_m) : rise_m_(rise_m) {}

double LiftRide::duration_s() const { return std::abs(rise_m_) / building::kLiftPace_mps + kSpeedsUp_s + kEases_s; }

/// The jerk is piecewise constant: the way is a sum of cubes.
double LiftRide::risen_m(double time_s) const {
  const double way_s = std::abs(rise_m_) / building::kLiftPace_mps;
  double sum = 0.0;
  for (unsigned ends = 0; ends < 8; ++ends) {
    const double from_s =
        ((ends & 1U) != 0 ? way_s : 0.0) + ((ends & 2U) != 0 ? kSpeedsUp_s : 0.0) + ((ends & 4U) != 0 ? kEases_s : 0.0);
    const double since_s = std::max(0.0, std::clamp(time_s, 0.0, duration_s()) - from_s);
    sum += (std::popcount(ends) % 2 == 0 ? 1.0 : -1.0) * since_s * since_s * since_s;
  }
  return std::copysign(building::kLiftPace_mps * sum / (6.0 * kSpeedsUp_s * kEases_s), rise_m_);
}

Pedestrian::Pedestrian(const building::Building& building, const PathPoint& start, const Gait& gait)
    : building_(building), gait_(gait) {
  truth_.x_m = start.at.x_m;
  truth_.y_m = start.at.y_m;
  truth_.level = start.level;
  truth_.height_m = building.height_m(start.level);
  truth_.heading_rad = wrap(building.reference().heading_rad);
}

void Pedestrian::follow(const building::Route& route, milliseconds pause) {
  std::size_t first = 0;
  for (std::size_t i = 1; i < route.points.size(); ++i) {
    if (route.points[i].passage != Passage::Lift) continue;
    add_walk(route.points, first, i - 1);
    legs_.push_back({Leg::Kind::Lift, {}, 0.0, route.points[i - 1].level, route.points[i].level});
    first = i;
  }
  add_walk(route.points, first, route.points.size() - 1);
  if (pause.count() > 0) legs_.push_back({Leg::Kind::Stand, {}, static_cast<double>(pause.count()) / 1000.0});
}

void Pedestrian::add_walk(const std::vector<building::RoutePoint>& points, std::size_t first, std::size_t last) {
  for (std::size_t i = first + 1; i < last; ++i) {
    if (!turns_back(points[i - 1].at, points[i].at, points[i + 1].at)) continue;
    // One stops to turn back: a leg of its own from there.
    add_walk(points, first, i);
    return add_walk(points, i, last);
  }
  Leg leg{Leg::Kind::Walk};
  double at_m = 0.0;
  for (std::size_t i = first; i <= last; ++i) {
    if (i > first) at_m += distance_m(points[i - 1].at, points[i].at);
    const bool stairs = points[i].passage == Passage::Stairs || points[i].passage == Passage::Escalator;
    leg.corners.push_back({at_m, {points[i].at, points[i].level}, stairs});
  }
  if (at_m > 0.01) legs_.push_back(std::move(leg));
}

void Pedestrian::step() {
  truth_.t += kTick;
  if (legs_.empty()) return stand();
  if (!begun_) begin_leg();
  Leg& leg = legs_.front();
  switch (leg.kind) {
    case Leg::Kind::Walk: return walk(leg);
    case Leg::Kind::Lift: return ride(leg);
    case Leg::Kind::Stand: break;
  }
  stand();
  leg.left_s -= kTick_s;
  if (leg.left_s <= 0.0) end_leg();
}

void Pedestrian::begin_leg() {
  begun_ = true;
  walked_m_ = 0.0;
  pace_mps_ = ridden_s_ = 0.0;
  next_corner_ = 0;
}

void Pedestrian::end_leg() {
  legs_.pop_front();
  begun_ = false;
}

void Pedestrian::stand() {
  truth_.speed_mps = truth_.velocity_x_mps = truth_.velocity_y_mps = truth_.velocity_up_mps = 0.0;
  truth_.cadence_hz = 0.0;
}

double Pedestrian::map_heading(Point direction) const {
  return wrap(std::atan2(direction.x_m, direction.y_m) + building_.reference().heading_rad);
}

bool Pedestrian::turn_towards(double heading_rad) {
  const double most = gait_.turn_rate_rad_s * kTick_s;
  const double rest = difference(heading_rad, truth_.heading_rad);
  truth_.heading_rad = wrap(truth_.heading_rad + std::clamp(rest, -most, most));
  return std::abs(rest) <= most;
}

double Pedestrian::limit_mps(const Leg& leg) const {
  const auto next = std::find_if(leg.corners.begin() + 1, leg.corners.end(),
                                 [&](const Corner& corner) { return corner.at_m > walked_m_; });
  const bool stairs = next != leg.corners.end() && next->stairs;
  const double left_m = leg.corners.back().at_m - walked_m_;
  const double braking = std::sqrt(2.0 * gait_.acceleration_mps2 * std::max(0.0, left_m));
  return std::max(kSlowest_mps, std::min(stairs ? gait_.stairs_speed_mps : gait_.speed_mps, braking));
}

void Pedestrian::walk(Leg& leg) {
  if (walked_m_ == 0.0 && pace_mps_ == 0.0) {
    stand();
    const Point ahead = leg.corners[1].place.at - leg.corners[0].place.at;
    const auto far =
        std::find_if(leg.corners.begin(), leg.corners.end(), [](const Corner& c) { return c.at_m > 0.01; });
    const bool repeated = length_m(ahead) <= 0.01 && far != leg.corners.end();
    if (!turn_towards(map_heading(repeated ? far->place.at - leg.corners[0].place.at : ahead))) return;
  }
  const double change = gait_.acceleration_mps2 * kTick_s;
  pace_mps_ = std::clamp(limit_mps(leg), std::max(0.0, pace_mps_ - 2.0 * change), pace_mps_ + change);
  walked_m_ = std::min(leg.corners.back().at_m, walked_m_ + pace_mps_ * kTick_s);
  place_on(leg);
  while (next_corner_ < leg.corners.size() && leg.corners[next_corner_].at_m <= walked_m_) {
    // Nobody may ask for them: only the latest are kept.
    if (waypoints_.size() == kMostWaypoints) waypoints_.erase(waypoints_.begin());
    waypoints_.push_back(truth_);
    ++next_corner_;
  }
  if (walked_m_ >= leg.corners.back().at_m) end_leg();
}

/// The place is the mean of the way over the rounding length around the point reached: a smooth line with a
/// heading that changes at a finite rate. At the ends the length shrinks, so that the way starts and ends
/// where it should.
void Pedestrian::place_on(const Leg& leg) {
  const auto at = [&leg](double way_m) {
    const auto next = std::find_if(leg.corners.begin() + 1, leg.corners.end() - 1,
                                   [&](const Corner& corner) { return corner.at_m >= way_m; });
    const Corner& a = *(next - 1);
    const Corner& b = *next;
    const double length = b.at_m - a.at_m;
    const double share = length > 0.0 ? std::clamp((way_m - a.at_m) / length, 0.0, 1.0) : 1.0;
    return PathPoint{a.place.at + (b.place.at - a.place.at) * share,
                     a.place.level + (b.place.level - a.place.level) * share};
  };
  constexpr int kSamples = 8;
  const double reach = std::min({kRounding_m, walked_m_, leg.corners.back().at_m - walked_m_});
  Point mean{};
  for (int i = 0; i < kSamples; ++i) mean = mean + at(walked_m_ + reach * ((2.0 * i + 1.0) / kSamples - 1.0)).at;
  mean = mean * (1.0 / kSamples);
  const Truth before = truth_;
  truth_.x_m = mean.x_m;
  truth_.y_m = mean.y_m;
  truth_.level = at(walked_m_).level;
  truth_.height_m = building_.height_m(truth_.level);
  truth_.velocity_x_mps = (truth_.x_m - before.x_m) / kTick_s;
  truth_.velocity_y_mps = (truth_.y_m - before.y_m) / kTick_s;
  truth_.velocity_up_mps = (truth_.height_m - before.height_m) / kTick_s;
  truth_.speed_mps = std::hypot(truth_.velocity_x_mps, truth_.velocity_y_mps);
  const double ahead_m = std::max(reach, 0.05);
  const Point direction = at(walked_m_ + ahead_m).at - at(walked_m_ - ahead_m).at;
  if (length_m(direction) > 0.02) turn_towards(map_heading(direction));
  // Small steps stay quick: cadence falls with the root of the speed. Stairs are climbed at nearly full
  // cadence.
  const bool climbs = std::abs(truth_.velocity_up_mps) > 0.05;
  const double share = std::clamp(pace_mps_ / (climbs ? gait_.stairs_speed_mps : gait_.speed_mps), 0.0, 1.0);
  truth_.cadence_hz = gait_.cadence_hz * (climbs ? 0.9 : 1.0) * std::sqrt(share);
  truth_.steps += truth_.cadence_hz * kTick_s;
}

/// Doors close, the cabin goes, doors open.
void Pedestrian::ride(Leg& leg) {
  stand();
  ridden_s_ += kTick_s;
  const double from_m = building_.height_m(leg.from_level), to_m = building_.height_m(leg.to_level);
  const LiftRide lift(to_m - from_m);
  const double moves_s = ridden_s_ - kLiftDoors_s / 2.0;
  const double before_m = truth_.height_m;
  const bool there = moves_s >= lift.duration_s();
  truth_.height_m = there ? to_m : from_m + lift.risen_m(moves_s);
  truth_.velocity_up_mps = (truth_.height_m - before_m) / kTick_s;
  truth_.level = there ? leg.to_level : building_.plan().heights.level_at(truth_.height_m);
  if (moves_s >= lift.duration_s() + kLiftDoors_s / 2.0) end_leg();
}

std::vector<Truth> Pedestrian::take_waypoints() { return std::exchange(waypoints_, {}); }

}  // namespace fiona::simulator
