// That people err, and by how much. Shares and spreads are those of many draws with fixed seeds.
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include <fiona/building/geometry.hpp>
#include <fiona/simulator/guided_walker.hpp>

#include "osm_text.hpp"

namespace fiona::simulator {
namespace {

using building::Building;
using building::Point;
using hmi::Instruction;
using hmi::NextTurn;

constexpr std::uint64_t kDraws = 1000;
constexpr double kTurn = 2.0 * std::numbers::pi;

/// From its middle no wall is in sight.
const Building& hall() {
  static const Building kHall = building::Osm().rectangle(10, 0, 0, 80, 80, "indoor=room level=0 name=Hall").read();
  return kHall;
}

/// A door in the middle of each wall; from the middle of the room to the right of it stairs, and to the left a lift.
const Building& room() {
  static const Building kRoom = [] {
    building::Osm osm;
    osm.node(10, 0, 0).node(11, 11, 0).node(12, 11, 11).node(13, 0, 11);
    osm.node(20, 5.5, 0, "door=hinged level=0").node(21, 11, 5.5, "door=hinged level=0");
    osm.node(22, 5.5, 11, "door=hinged level=0").node(23, 0, 5.5, "door=hinged level=0");
    osm.way(10, {10, 20, 11, 21, 12, 22, 13, 23, 10}, "indoor=room level=0 name=Room");
    osm.rectangle(30, 0, 0, 11, 11, "indoor=room level=1 name=Above");
    osm.node(40, 7, 5.5).node(41, 10, 5.5).way(40, {40, 41}, "highway=steps level=0;1");
    osm.node(50, 4, 5.5, "highway=elevator level=0;1");
    return osm.read();
  }();
  return kRoom;
}

Point at(const GuidedWalker& walker) { return {walker.truth().x_m, walker.truth().y_m}; }

Instruction told(std::uint32_t number, Instruction::Kind kind, double distance_m = 0.0,
                 NextTurn::TypeOfTurn hour = NextTurn::HOUR_12) {
  Instruction said;
  said.set_number(number), said.set_kind(kind), said.set_hour(hour), said.set_distance(distance_m);
  return said;
}

Instruction stop(std::uint32_t number) {
  Instruction said;
  said.set_number(number), said.set_kind(Instruction::LOST);
  return said;
}

double mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

double deviation(const std::vector<double>& values) {
  double squares = 0.0;
  for (const double value : values) squares += (value - mean(values)) * (value - mean(values));
  return std::sqrt(squares / static_cast<double>(values.size()));
}

/// From the word until the person moves, or stands.
double reaction_s(GuidedWalker& walker, const Instruction& said, bool until_moving) {
  const auto from = walker.truth().t;
  walker.hear(said);
  double before_mps = walker.truth().speed_mps;
  for (auto t = from; t < from + milliseconds(4000); t += milliseconds(5)) {
    walker.advance(t);
    const double now_mps = walker.truth().speed_mps;
    const bool reacted = until_moving ? now_mps > 0.0 : now_mps < before_mps - 0.005;
    if (reacted) return static_cast<double>((t - from).count()) / 1000.0;
    before_mps = now_mps;
  }
  return INFINITY;
}

TEST(GuidedWalker, ReactsAfterHalfASecondToOneAndAHalf) {
  std::vector<double> reactions_s;
  for (std::uint64_t seed = 1; seed <= kDraws; ++seed) {
    GuidedWalker walker(hall(), seed, {.start_room = "Hall"});
    reactions_s.push_back(reaction_s(walker, told(1, Instruction::START), true));
  }
  std::sort(reactions_s.begin(), reactions_s.end());
  EXPECT_GE(reactions_s.front(), 0.5);
  EXPECT_LE(reactions_s.front(), 0.52);
  EXPECT_GE(reactions_s.back(), 1.48);
  EXPECT_LE(reactions_s.back(), 1.51);
  EXPECT_NEAR(reactions_s[kDraws / 4], 0.75, 0.05);
  EXPECT_NEAR(reactions_s[kDraws / 2], 1.0, 0.05);
  EXPECT_NEAR(reactions_s[3 * kDraws / 4], 1.25, 0.05);
}

TEST(GuidedWalker, ReactsToEachWordAnew) {
  GuidedWalker walker(hall(), 1, {.start_room = "Hall"});
  std::vector<double> reactions_s;
  milliseconds t{0};
  for (std::uint32_t number = 1; number <= 40; number += 2) {
    reactions_s.push_back(reaction_s(walker, told(number, Instruction::START), true));
    walker.hear(stop(number + 1));
    walker.advance(t = walker.truth().t + milliseconds(4000));
  }
  EXPECT_GT(deviation(reactions_s), 0.2);
}

TEST(GuidedWalker, StopsAsLateAsItReacts) {
  for (std::uint64_t seed = 1; seed <= 100; ++seed) {
    GuidedWalker walker(hall(), seed, {.start_room = "Hall"});
    walker.hear(told(1, Instruction::START));
    walker.advance(milliseconds(5000));
    const double stops_s = reaction_s(walker, stop(2), false);
    EXPECT_GE(stops_s, 0.5) << seed;
    EXPECT_LE(stops_s, 1.51) << seed;
  }
}

/// By how much who walks and is told to turn right turns.
double turned_rad(std::uint64_t seed) {
  GuidedWalker walker(hall(), seed, {.start_room = "Hall"});
  walker.hear(told(1, Instruction::START));
  walker.advance(milliseconds(4000));
  const double before_rad = walker.truth().heading_rad;
  // The same word with another distance is the same word.
  for (int i = 0; i < 3; ++i) {
    walker.hear(told(2, Instruction::TURN, 2.2 - 0.26 * i, NextTurn::HOUR_3));
    walker.advance(walker.truth().t + milliseconds(200));
  }
  walker.advance(milliseconds(10'000));
  return std::remainder(walker.truth().heading_rad - before_rad, kTurn);
}

TEST(GuidedWalker, OneTurnOfTwentyIsMissedAndTheOthersErrBySixDegrees) {
  std::vector<double> errors_rad;
  std::size_t missed = 0;
  for (std::uint64_t seed = 1; seed <= 2 * kDraws; ++seed) {
    const double turned = turned_rad(seed);
    if (std::abs(turned) < 0.01) {
      ++missed;
    } else {
      errors_rad.push_back(turned - kTurn / 4.0);
    }
  }
  EXPECT_NEAR(static_cast<double>(missed) / (2 * kDraws), 0.05, 0.012);
  EXPECT_NEAR(mean(errors_rad), 0.0, 0.01);
  EXPECT_NEAR(deviation(errors_rad), 0.1, 0.008);
}

TEST(GuidedWalker, WhoMissedATurnMayNoticeTheNextWord) {
  std::size_t missed = 0, noticed = 0;
  for (std::uint64_t seed = 1; seed <= kDraws; ++seed) {
    GuidedWalker walker(hall(), seed, {.start_room = "Hall", .missed_share = 0.5});
    walker.hear(told(1, Instruction::START));
    walker.advance(milliseconds(4000));
    const double before_rad = walker.truth().heading_rad;
    walker.hear(told(2, Instruction::TURN, 0.5, NextTurn::HOUR_3));
    walker.advance(milliseconds(8000));
    if (walker.truth().heading_rad != before_rad) continue;
    ++missed;
    walker.hear(told(3, Instruction::TURN, 0.5, NextTurn::HOUR_3));
    walker.advance(milliseconds(12'000));
    if (walker.truth().heading_rad != before_rad) ++noticed;
  }
  EXPECT_NEAR(static_cast<double>(noticed) / static_cast<double>(missed), 0.5, 0.08);
}

TEST(GuidedWalker, WalksBesideWhereItLooksByThreeDegrees) {
  std::vector<double> beside_rad;
  for (std::uint64_t seed = 1; seed <= kDraws; ++seed) {
    GuidedWalker walker(hall(), seed, {.start_room = "Hall"});
    walker.hear(told(1, Instruction::START));
    walker.advance(milliseconds(15'000));
    const Truth& now = walker.truth();
    const double goes_rad = std::atan2(now.velocity_x_mps, now.velocity_y_mps) + hall().reference().heading_rad;
    beside_rad.push_back(std::remainder(goes_rad - now.heading_rad, kTurn));
  }
  EXPECT_NEAR(mean(beside_rad), 0.0, 0.006);
  EXPECT_NEAR(deviation(beside_rad), 0.05, 0.006);
}

/// Of those who stand in the middle of the room and are told to, the share that has not done it by then.
double missed_share(const Instruction& said, milliseconds by,
                    const std::function<bool(const GuidedWalker&)>& has_done) {
  std::size_t missed = 0;
  for (std::uint64_t seed = 1; seed <= kDraws; ++seed) {
    GuidedWalker walker(room(), seed, {.start_room = "Room"});
    walker.hear(said);
    walker.advance(by);
    if (!has_done(walker)) ++missed;
  }
  return static_cast<double>(missed) / kDraws;
}

TEST(GuidedWalker, OneDoorOfTwentyIsMissed) {
  const auto is_out = [](const GuidedWalker& walker) {
    return !building::contains(room().room("Room").polygon, at(walker));
  };
  EXPECT_NEAR(missed_share(told(1, Instruction::DOOR, 2.0), milliseconds(8000), is_out), 0.05, 0.02);
}

TEST(GuidedWalker, OneFlightOfTwentyIsMissed) {
  Instruction climb = told(1, Instruction::STAIRS, 1.5);
  climb.set_to_level(1.0);
  const auto climbs = [](const GuidedWalker& walker) { return walker.truth().level > 0.0; };
  EXPECT_NEAR(missed_share(climb, milliseconds(8000), climbs), 0.05, 0.02);
}

TEST(GuidedWalker, OneLiftOfTwentyIsMissed) {
  Instruction ride = told(1, Instruction::LIFT, 1.5);
  ride.set_to_level(1.0);
  const auto stands_in_it = [](const GuidedWalker& walker) {
    return walker.truth().speed_mps == 0.0 && distance_m(at(walker), Point{4.0, 5.5}) < 0.1;
  };
  EXPECT_NEAR(missed_share(ride, milliseconds(6000), stands_in_it), 0.05, 0.02);
}

}  // namespace
}  // namespace fiona::simulator
