#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>
#include <fiona/building/building.hpp>

#include "fiona/simulator/random.hpp"
#include "fiona/simulator/walker.hpp"

namespace fiona::simulator {

/// A person who does as they are told, as people do: late, not quite in the direction that was meant, and now and then
/// not at all. Knows nothing of any map: hears instructions, and sees walls, doorways, stairs and lifts that are near
/// and not behind a wall. Doors are closed, and opened by who is told to go through. Stands until the first
/// instruction.
class GuidedWalker {
 public:
  struct Options {
    Gait gait{};
    std::string start_room{};  ///< name or ref; empty: chosen at random
    double shortest_reaction_s = 0.5;
    double longest_reaction_s = 1.5;
    double turn_error_rad = 0.1;  ///< standard deviation of a turn
    double veer_rad = 0.05;       ///< standard deviation by which one walks beside where one looks, over some seconds
    int access = 0;               ///< authentication level of the key: doors that ask for more are locked
    double missed_share = 0.05;   ///< of turns, doors, stairs and lifts: not noticed
  };

  /// Throws fiona::Error NotFound if there is no such room to start in.
  GuidedWalker(const building::Building& building, std::uint64_t seed, Options options);

  /// Moves on to a time since the start; a time that lies behind changes nothing.
  void advance(milliseconds to);
  /// An instruction comes at the time reached.
  void hear(const hmi::Instruction& instruction);
  const Truth& truth() const { return truth_; }

 private:
  using Kind = hmi::Instruction::Kind;

  struct Heard {
    milliseconds due{0};
    double direction_rad = 0.0;  ///< that was meant, clockwise from true north
    double walked_m = 0.0;       ///< until then
    hmi::Instruction said{};
  };
  /// A turn that is made once the way there is open.
  struct Turn {
    double direction_rad = 0.0;
    double at_m = 0.0;  ///< of the way walked
  };
  /// What is done without looking up: through a door, up the stairs, into the lift.
  struct Errand {
    std::deque<building::PathPoint> points{};
    std::optional<double> ride_to{};
    double wait_s = 0.0;
    double ridden_s = 0.0, from_m = 0.0;  ///< since the lift went, and the height that it went from
    bool stairs = false;
    bool door = false;
    std::optional<double> then_rad{};  ///< to turn by afterwards, clockwise
  };

  void act(const Heard& heard);
  bool notices(std::uint32_t number);
  void act_here(const Heard& heard);
  void turn_at(const Heard& heard);
  bool go_through_door(const Heard& heard);
  void leave_room();
  bool climb(const hmi::Instruction& said);
  bool enter_lift(double to_level);

  void step();
  void take_in(Errand& errand);
  void run(Errand& errand);
  void ride(Errand& errand);
  void walk();
  void follow_wall(building::Point moved, double moved_m);
  void turn_when_open();
  void move(building::Point by);
  void note_motion(building::Point before, double height_before_m);
  bool turn_towards(double heading_rad);

  void set_barriers();
  bool sees(building::Point from, building::Point to) const;
  double free_m(building::Point from, building::Point direction, double most_m) const;
  double along_walls(double direction_rad, double most_rad) const;
  building::Point direction(double heading_rad) const;
  double heading(building::Point direction) const;
  building::Point at() const { return {truth_.x_m, truth_.y_m}; }
  const std::vector<building::Segment>& near_walls();

  const building::Building& building_;
  const Options options_;
  Random random_;
  Truth truth_{};
  std::deque<Heard> heard_{};
  std::optional<Heard> last_{};  ///< what was acted on
  std::optional<Errand> errand_{};
  std::optional<Turn> turn_{};
  std::set<std::uint32_t> missed_{}, done_{};
  std::uint32_t reacting_to_ = 0;
  double reaction_s_ = 1.0;
  double turn_error_rad_ = 0.0;
  bool walking_ = false;
  double wish_rad_ = 0.0;  ///< where one wants to walk
  double veer_rad_ = 0.0;
  double pace_mps_ = 0.0;
  double walked_m_ = 0.0;
  double blocked_s_ = 0.0;
  milliseconds careful_until_{0};  ///< one looks around behind a door, and where one is about to turn
  /// By level: walls, and doors, which are closed but for who goes through.
  std::map<double, std::vector<building::Segment>> barriers_{};
  std::vector<building::Segment> walls_{};  ///< those nearby
  std::optional<building::PathPoint> walls_at_{};
};

}  // namespace fiona::simulator
