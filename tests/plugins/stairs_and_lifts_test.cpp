// The filter between levels.
#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <numbers>
#include <optional>
#include <string>

#include "beacon_hall.hpp"

namespace fiona::beacons {
namespace {

using namespace std::chrono_literals;

/// Beacons of two levels, and at (10, 10) what leads from one to the other.
std::string two_levels() {
  std::string text = "name: 'house'\n";
  for (int level = 0; level < 2; ++level) {
    for (int i = 0; i < 4; ++i) {
      text += "beacons { id: '02:00:00:00:0" + std::to_string(level) + ":0" + std::to_string(i + 1) +
              "' x: " + (i % 2 == 1 ? "20" : "0") + " y: " + (i >= 2 ? "20" : "0") +
              " heard { level: " + std::to_string(level) + " power: -59 } exponent: 2 }\n";
    }
  }
  return text;
}

/// Two halls of 20 m, one above the other, and a staircase that is as wide as its flight between the middles of their
/// eastern and western walls.
void add_staircase(navigation::CommLevelMap& plan, double length_m) {
  const double end = 10 + length_m;
  for (const int level : {0, 1}) {
    const double west = level == 0 ? -10.0 : end, side = level == 0 ? 10.0 : end;
    for (const auto& [x1, y1, x2, y2] : {std::array{west, 0.0, west + 20, 20.0}, std::array{10.0, 9.5, end, 10.5}}) {
      auto& room = *plan.add_rooms();
      room.set_level(level);
      for (const double x : {x1, x2, x2, x1}) room.mutable_outline()->add_x(x);
      for (const double y : {y1, y1, y2, y2}) room.mutable_outline()->add_y(y);
    }
    for (const auto& [x1, y1, x2, y2] : {std::array{side, 0.0, side, 9.5}, std::array{side, 10.5, side, 20.0},
                                         std::array{10.0, 9.5, end, 9.5}, std::array{10.0, 10.5, end, 10.5}}) {
      auto& wall = *plan.add_walls();
      wall.set_level(level);
      wall.set_x1(x1), wall.set_y1(y1), wall.set_x2(x2), wall.set_y2(y2);
    }
  }
}

struct House {
  explicit House(navigation::MapEdge::Kind kind, double far_m)
      : map(parse(two_levels(), "house")), field(std::make_shared<const BeaconField>(map)) {
    navigation::CommLevelMap plan;
    for (const double level : {0.0, 1.0}) {
      auto& told = *plan.add_levels();
      told.set_level(level), told.set_floor(3.5 * level);
      add_wall(plan, -30, -30, -30, 50, level);
      auto& node = *plan.add_nodes();
      node.set_x(10 + level * far_m), node.set_y(10), node.set_level(level);
    }
    auto& edge = *plan.add_edges();
    edge.set_from(0), edge.set_to(1), edge.set_kind(kind);
    if (kind != navigation::MapEdge::LIFT) add_staircase(plan, far_m);
    filter.emplace(field, std::make_shared<const FloorPlan>(plan), map.accuracy(), map.radio().offset(),
                   FilterOptions{});
  }

  /// A second in the place; what is on another level, and all where `loss_db` says so, is weaker.
  void hear(double x, double y, int level, double loss_db = 0.0) {
    for (int beacon = 0; beacon < 8; ++beacon) {
      const bool same = beacon / 4 == level;
      const double dbm = rssi_dbm(x, y, beacon % 4) - loss_db - (same ? 0.0 : map.radio().level_loss());
      if (dbm > -95.0) filter->heard(static_cast<std::uint32_t>(beacon), dbm);
    }
    filter->advance(now += 1s);
  }

  /// Stands for 8 s at (6, 10) of level 0, then walks a metre a second.
  void stand_and_walk_east_to(double to_x) {
    for (int i = 0; i < 8; ++i) hear(6, 10, 0);
    for (double x = 6; x < to_x; x += 1.0) {
      filter->step({1.0, 0.05, 0.0, 0.05});
      hear(x + 1, 10, 0);
    }
  }

  BeaconMap map;
  std::shared_ptr<const BeaconField> field;
  std::optional<BeaconFilter> filter;
  std::chrono::milliseconds now{0};
};

TEST(BeaconFilter, WhoTakesALiftIsInItAndThenOnTheOtherLevel) {
  House house(navigation::MapEdge::LIFT, 0.0);
  house.stand_and_walk_east_to(10);
  for (int i = 0; i < 15; ++i) {
    house.hear(10, 10, 0, 12.0);  // the cabin
    EXPECT_TRUE(house.filter->estimate().is_valid());
  }
  Estimate at = house.filter->estimate();
  EXPECT_EQ(at.level, 0);
  EXPECT_NEAR(at.x_m, 10.0, 1.0);
  EXPECT_NEAR(at.y_m, 10.0, 1.0);
  for (int i = 0; i < 6; ++i) house.hear(10, 10, 1, 12.0);
  at = house.filter->estimate();
  EXPECT_EQ(at.level, 1);
  EXPECT_NEAR(at.x_m, 10.0, 0.5);
  EXPECT_NEAR(at.y_m, 10.0, 0.5);
}

TEST(BeaconFilter, WhoTakesStairsComesOutAtTheirEnd) {
  House house(navigation::MapEdge::STAIRS, 6.0);
  house.stand_and_walk_east_to(10);
  for (double x = 10; x < 16; x += 0.6) {  // two steps a second, that seem to be of 0.6 m and are of half that
    house.filter->step({0.6, 0.05, 0.0, 0.05});
    house.filter->step({0.6, 0.05, 0.0, 0.05});
    house.hear(x + 0.6, 10, x < 14 ? 0 : 1);
  }
  const Estimate at = house.filter->estimate();
  EXPECT_EQ(at.level, 1);
  EXPECT_NEAR(at.x_m, 16.0, 2.0);
  EXPECT_NEAR(at.y_m, 10.0, 1.5);
}

TEST(BeaconFilter, WhoStandsOnAnEscalatorIsCarriedToItsEnd) {
  House house(navigation::MapEdge::ESCALATOR, 8.0);
  house.stand_and_walk_east_to(11);
  for (double x = 11; x < 18; x += 0.5) house.hear(x + 0.5, 10, x < 14 ? 0 : 1);
  const Estimate at = house.filter->estimate();
  EXPECT_EQ(at.level, 1);
  EXPECT_NEAR(at.x_m, 18.0, 1.5);
  EXPECT_NEAR(at.y_m, 10.0, 1.0);
}

TEST(BeaconFilter, NobodyWalksOnBelowStairsThatTheyClimb) {
  House house(navigation::MapEdge::STAIRS, 6.0);
  house.stand_and_walk_east_to(12);
  for (int step = 0; step < 40; ++step) house.filter->step({0.6, 0.05, 0.0, 0.05});  // and nothing is heard
  house.filter->advance(house.now += 1s);
  EXPECT_EQ(house.filter->estimate().level, 1);
  EXPECT_LT(house.filter->estimate().level_variance, 0.02);
}

/// Nothing is heard: the stairs alone tell.
TEST(BeaconFilter, StairsTellHowMuchACompassErrs) {
  House house(navigation::MapEdge::STAIRS, 6.0);
  house.stand_and_walk_east_to(11);
  for (int step = 0; step < 10; ++step) house.filter->step({0.6, 0.05, 0.25, 0.05});
  house.filter->advance(house.now += 1s);
  EXPECT_NEAR(house.filter->estimate().heading_bias_rad, -0.25, 0.17);
}

/// East, south over a landing, and west.
struct StairsOverALanding : House {
  StairsOverALanding() : House(navigation::MapEdge::STAIRS, 6.0) {
    navigation::CommLevelMap plan;
    for (const double level : {0.0, 1.0}) {
      add_wall(plan, 9, -30, 9, 6.4, level);
      add_wall(plan, 9, 6.4, 14.6, 6.4, level);
      add_wall(plan, 14.6, 6.4, 14.6, 10.6, level);
      add_wall(plan, 9, 10.6, 14.6, 10.6, level);
      add_wall(plan, 9, 10.6, 9, 50, level);
    }
    for (const auto& [x, y, level] : {std::array{10.0, 10.0, 0.0}, std::array{14.0, 10.0, 0.5},
                                      std::array{14.0, 7.0, 0.5}, std::array{10.0, 7.0, 1.0}}) {
      auto& node = *plan.add_nodes();
      node.set_x(x), node.set_y(y), node.set_level(level);
    }
    for (std::uint32_t i = 0; i < 3; ++i) {
      auto& edge = *plan.add_edges();
      edge.set_from(i), edge.set_to(i + 1), edge.set_kind(navigation::MapEdge::STAIRS);
    }
    filter->use(std::make_shared<const FloorPlan>(plan));
  }

  /// Steps that seem to be of 0.6 m; and nothing is heard.
  void climb(int steps, double heading_rad) {
    for (int step = 0; step < steps; ++step) filter->step({0.6, 0.05, heading_rad, 0.05});
    filter->advance(now += 1s);
  }
};

/// They are of 0.3 m.
TEST(BeaconFilter, TurnsOnStairsTellHowLongTheirStepsAre) {
  StairsOverALanding house;
  house.stand_and_walk_east_to(10);
  house.climb(13, 0.0);
  house.climb(10, -std::numbers::pi / 2);
  house.climb(7, std::numbers::pi);
  const Estimate at = house.filter->estimate();
  EXPECT_EQ(at.level, 1);
  EXPECT_NEAR(at.x_m, 14.0 - 7 * 0.3, 0.6);
}

/// What is heard in the cabin is that of the level below, all the way.
TEST(BeaconFilter, WhoFeltALiftIsOnTheLevelThatItCarriedThemTo) {
  const auto level_after = [](std::optional<double> rise_m) {
    House house(navigation::MapEdge::LIFT, 0.0);
    house.stand_and_walk_east_to(10);
    for (int i = 0; i < 20; ++i) house.hear(10, 10, 0, 12.0);
    house.filter->step({0.7, 0.05, 0.0, 0.05, rise_m});
    house.filter->advance(house.now += 1s);
    return house.filter->estimate().level;
  };
  EXPECT_EQ(level_after(std::nullopt), 0);
  EXPECT_EQ(level_after(0.0), 0);
  EXPECT_EQ(level_after(3.3), 1);
  EXPECT_EQ(level_after(-3.3), 0) << "there is nothing below";
}

/// Most of the second in which they leave it is heard in the cabin.
TEST(BeaconFilter, WhoWalksOutOfALiftIsNotHeldInIt) {
  House house(navigation::MapEdge::LIFT, 0.0);
  house.stand_and_walk_east_to(10);
  for (int i = 0; i < 15; ++i) house.hear(10, 10, 0, 15.0);
  for (int i = 0; i < 6; ++i) house.hear(10, 10, 1, 15.0);
  house.filter->step({0.7, 0.05, 0.0, 0.05});
  house.hear(10.4, 10, 1, 13.0);
  house.filter->step({0.7, 0.05, 0.0, 0.05});
  house.hear(11.1, 10, 1);
  EXPECT_NEAR(house.filter->estimate().x_m, 11.1, 0.7);
}

}  // namespace
}  // namespace fiona::beacons
