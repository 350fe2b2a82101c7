#pragma once

#include <algorithm>
#include <numbers>
#include <optional>
#include <vector>

#include <fiona/time.hpp>

#include "level_plan.hpp"
#include "maneuvers.hpp"

namespace fiona::guidance {

struct Walker {
  static constexpr double kSure_m = 0.3;

  building::PathPoint place{};
  std::optional<double> heading_rad{};  ///< clockwise from true north
  double sigma_m = 0.0;                 ///< of the place, along its longer axis

  /// A place that is less than sure may leap.
  bool is_sure() const { return sigma_m < kSure_m; }
};

/// A walker on a path at one moment, and what follows from that alone.
struct Situation {
  static constexpr double kDegree = std::numbers::pi / 180.0;
  /// Who looks further aside of a direction walks elsewhere, and within the smaller angle along it.
  static constexpr double kAstray_rad = 50.0 * kDegree;
  static constexpr double kAlong_rad = 30.0 * kDegree;
  static constexpr double kBeside_m = 1.2;  ///< who is further from a turn, a door or stairs has missed them
  static constexpr double kNow_m = 2.0;     ///< from there on something is to be done now
  /// Nobody has arrived whose place is less sure: they may be elsewhere.
  static constexpr double kMostThere_m = 3.0;

  const LevelPlan& plan;
  const Path& path;
  const std::vector<Maneuver>& maneuvers;
  const Walker& walker;
  const TimePoint now;
  bool leaves = false;   ///< the first room, as told before there was a path: its door is not told of
  std::size_t next = 0;  ///< the maneuver that is to be done, by Progress
  // By PathTracker.
  double at_m = 0.0;          ///< of the path
  double off_m = 0.0;         ///< beside it
  bool is_off = false;        ///< for some time, or surely
  bool gets_nowhere = false;  ///< along the path, however they move
  TimePoint moved_at{};
  bool stands = false;  ///< by a place that is less than sure: they neither go through a door nor are about to

  const Maneuver& maneuver() const { return maneuvers[next]; }
  double to_next_m() const { return std::max(0.0, maneuver().at_m - at_m); }
  /// Where the next maneuver is to be done.
  building::Point spot() const { return path.place(maneuver().at_m).at; }
  double to_spot_m() const { return distance_m(walker.place.at, spot()); }
  /// There is something to be done, here.
  bool is_at_maneuver() const;
  /// That of the next maneuver is near and in sight, wherever they look.
  bool is_at_door() const;
  bool is_in_front_of(const Maneuver& door) const;
  bool has_arrived() const;

  /// From where on one who does nothing does what they were told: they wait for a lift, also before its door, or are on
  /// their way to another level.
  bool waits() const;
  /// The next maneuver is the door of a lift to another level.
  bool is_lift_door() const { return is_lift_door(next); }
  /// The end of the way is near, by a place that is not sure enough for it.
  bool is_near_end(double within_m) const;

  /// Right behind the next maneuver there are stairs or a lift.
  bool is_close_to_other_level() const;
  /// The turn right behind the next maneuver, or to the door there, clockwise from how one arrives.
  std::optional<double> then_rad() const;

  /// The way to turn, clockwise; nothing if it is not known where the walker looks.
  std::optional<double> turn_to(building::Point direction) const;
  bool looks_along(building::Point direction) const;
  bool looks_elsewhere(building::Point direction) const;
  /// Whether a wall of the walker's level stands between two places.
  bool walled(building::Point a, building::Point b) const;

 private:
  bool is_lift_door(std::size_t index) const;
};

}  // namespace fiona::guidance
