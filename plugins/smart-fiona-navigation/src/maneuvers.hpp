#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>
#include <fiona/building/routes.hpp>

namespace fiona::guidance {

/// A way, measured: a climb or a ride without length in the plane counts kLevel_m for each level.
class Path {
 public:
  static constexpr double kLevel_m = 3.0;

  explicit Path(building::Route route);

  const building::Route& route() const { return route_; }
  double end_m() const { return at_m_.back(); }
  /// Where a point of the route is.
  double at_m(std::size_t point) const { return at_m_[point]; }
  building::PathPoint place(double at_m) const;
  /// By which one gets on at that place.
  building::Passage passage(double at_m) const;
  /// Of length 1 in the plane; where the way stands still in it, as in a lift, (0, 0).
  building::Point direction(double at_m) const;

  struct Match {
    double at_m = 0.0;
    double off_m = 0.0;  ///< in the plane
    double off_levels = 0.0;
    bool hidden = false;
  };
  /// Whether a place of the way, and how one gets on there, is out of sight: then a place in sight is nearer.
  using Hidden = std::function<bool(const building::PathPoint& place, building::Passage passage)>;
  /// The nearest place of the way between two.
  Match match(const building::PathPoint& place, double from_m, double to_m, const Hidden& hidden) const;

 private:
  std::size_t segment(double at_m) const;

  building::Route route_;
  std::vector<double> at_m_;
};

/// Something to be done on the way.
struct Maneuver {
  hmi::Instruction::Kind kind = hmi::Instruction::TURN;
  double at_m = 0.0;      ///< where it is to be done
  double end_m = 0.0;     ///< where it has been done
  building::Point out{};  ///< the direction to take there; (0, 0): none
  std::optional<double> to_level{};
  int rise = 0;  ///< of steps on one level: 1 up, -1 down; 0: not told

  bool changes_level() const { return to_level.has_value(); }
  bool is_door() const {
    return kind == hmi::Instruction::DOOR || kind == hmi::Instruction::ENTER || kind == hmi::Instruction::LEAVE;
  }
};

/// By how much one turns who goes on in another direction.
double clockwise_rad(building::Point from, building::Point to);

/// What there is to do, in order; the last one is to arrive. Turns by less than 40 degrees are the way's own, and those
/// that lie closer together than 1.5 m are one.
std::vector<Maneuver> maneuvers(const Path& path);

}  // namespace fiona::guidance
