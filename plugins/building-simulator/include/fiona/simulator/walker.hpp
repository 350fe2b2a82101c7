#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include <fiona/building/building.hpp>

#include "fiona/simulator/random.hpp"

namespace fiona::simulator {

using std::chrono::milliseconds;

/// Where a person really is and how they move.
struct Truth {
  milliseconds t{0};
  double x_m = 0.0;  ///< local frame of the building
  double y_m = 0.0;
  double level = 0.0;        ///< with a fraction on stairs and in a moving lift
  double height_m = 0.0;     ///< of the floor underfoot above the floor of level 0
  double heading_rad = 0.0;  ///< where body and phone point: true north, clockwise, [0, 2 pi)
  double speed_mps = 0.0;    ///< in the plane
  double velocity_x_mps = 0.0;
  double velocity_y_mps = 0.0;
  double velocity_up_mps = 0.0;
  double steps = 0.0;       ///< made so far; the fraction is the phase of the gait
  double cadence_hz = 0.0;  ///< steps a second, 0 while standing
};

struct Gait {
  double speed_mps = 1.3;
  double stairs_speed_mps = 0.55;  ///< in the plane
  double cadence_hz = 1.8;         ///< at full speed
  double acceleration_mps2 = 1.0;
  double turn_rate_rad_s = 2.4;
};

/// A lift from stop to stop, with the speed, acceleration and jerk of those that carry passengers (R. D. Peters, "Ideal
/// lift kinematics", Elevator Technology 6, 1995). One that goes less than 2 m has twice their jerk.
class LiftRide {
 public:
  explicit LiftRide(double rise_m);
  /// Since the departure; before it 0, and after the arrival the whole rise.
  double risen_m(double time_s) const;
  double duration_s() const;

 private:
  double rise_m_;
};

/// Walks along a way: speeds up, slows down, rounds corners, turns on the spot, climbs, rides lifts. Moves in
/// ticks of 5 ms, so the truth does not depend on how often it is asked for.
class Pedestrian {
 public:
  static constexpr milliseconds kTick{5};

  Pedestrian(const building::Building& building, const building::PathPoint& start, const Gait& gait = {});

  /// Adds a route, which must start where the last one ended, and a pause after it.
  void follow(const building::Route& route, milliseconds pause);
  bool idle() const { return legs_.empty(); }
  /// One tick further.
  void step();
  const Truth& truth() const { return truth_; }
  /// Corners of the way that were passed or reached since the last call, at most the latest 256.
  std::vector<Truth> take_waypoints();

 private:
  struct Corner {
    double at_m;  ///< length of way up to here
    building::PathPoint place;
    bool stairs;  ///< the piece that ends here
  };
  struct Leg {
    enum class Kind : std::uint8_t { Walk, Lift, Stand } kind = Kind::Stand;
    std::vector<Corner> corners{};
    double left_s = 0.0;  ///< standing
    double from_level = 0.0, to_level = 0.0;
  };

  void add_walk(const std::vector<building::RoutePoint>& points, std::size_t first, std::size_t last);
  void begin_leg();
  void end_leg();
  void walk(Leg& leg);
  void ride(Leg& leg);
  bool turn_towards(double heading_rad);
  void stand();
  void place_on(const Leg& leg);
  double limit_mps(const Leg& leg) const;
  double map_heading(building::Point direction) const;

  const building::Building& building_;
  Gait gait_;
  Truth truth_{};
  std::deque<Leg> legs_{};
  std::vector<Truth> waypoints_{};
  double walked_m_ = 0.0;  ///< in the current leg
  double pace_mps_ = 0.0;
  double ridden_s_ = 0.0;  ///< likewise
  std::size_t next_corner_ = 0;
  bool begun_ = false;
};

/// Goes from room to room, chosen at random, with pauses; for ever.
class Walker {
 public:
  struct Options {
    Gait gait{};
    std::string start_room{};         ///< name or ref; empty: chosen at random
    std::vector<double> levels{};     ///< rooms on these levels only; empty: all
    building::RouteOptions routes{};  ///< stairs and lift may be closed
    double lift_share = 0.3;          ///< share of ways on which stairs are avoided
    milliseconds shortest_pause{2000};
    milliseconds longest_pause{8000};
  };

  /// Throws fiona::Error if the building has no two rooms with a way between them (or no such start room).
  Walker(const building::Building& building, std::uint64_t seed) : Walker(building, seed, Options{}) {}
  Walker(const building::Building& building, std::uint64_t seed, Options options);

  /// Moves on to a time since the start; a time that lies behind changes nothing.
  void advance(milliseconds to);
  const Truth& truth() const { return pedestrian_.truth(); }
  /// The room that is walked to.
  const building::Room& goal() const { return *goal_; }
  std::vector<Truth> take_waypoints() { return pedestrian_.take_waypoints(); }

 private:
  std::vector<const building::Room*> reachable_rooms(const building::Building& building) const;
  const building::Room* first_room(const building::Building& building);
  void choose_goal();

  const building::Building& building_;
  Options options_;
  Random random_;
  const building::Room* goal_ = nullptr;
  Pedestrian pedestrian_;
  std::vector<const building::Room*> rooms_{};
};

}  // namespace fiona::simulator
