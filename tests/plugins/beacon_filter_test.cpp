// The filter over beacons, steps and walls, on one level.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include <Eigen/LU>

#include "beacon_hall.hpp"

namespace fiona::beacons {
namespace {

using namespace std::chrono_literals;

TEST(BeaconFilter, WithoutReadingsThereIsNoPosition) {
  Hall hall;
  for (int i = 0; i < 20; ++i) hall.filter.advance(hall.now += 200ms);
  EXPECT_EQ(hall.filter.estimate().validity, Validity::NoEvidence);
}

TEST(BeaconFilter, TheFirstPlaceIsToldWithinASecond) {
  Hall hall;
  hall.filter.advance(hall.now);
  hall.readings(6, 13);
  hall.filter.advance(hall.now += 600ms);
  EXPECT_FALSE(hall.filter.estimate().is_valid());
  hall.filter.advance(hall.now += 200ms);
  EXPECT_TRUE(hall.filter.estimate().is_valid());
}

TEST(BeaconFilter, WhoStandsAmongBeaconsIsFound) {
  Hall hall;
  for (int i = 0; i < 20; ++i) hall.hear(6, 13);
  const Estimate at = hall.filter.estimate();
  ASSERT_TRUE(at.is_valid());
  EXPECT_NEAR(at.x_m, 6, 2.0);
  EXPECT_NEAR(at.y_m, 13, 2.0);
}

TEST(BeaconFilter, AReceiversOffsetIsLearntAndMovesNobody) {
  Hall hall;
  for (int i = 0; i < 30; ++i) hall.hear(6, 13, 8.0);
  const Estimate at = hall.filter.estimate();
  EXPECT_NEAR(at.rssi_offset_db, 8.0, 3.0);
  EXPECT_NEAR(at.x_m, 6, 2.5);
  EXPECT_NEAR(at.y_m, 13, 2.5);
}

TEST(BeaconFilter, AHeadingBiasIsLearntOnTheWay) {
  FilterOptions options;
  options.still_diffusion_m = 0.2;
  Hall hall(options);
  for (int i = 0; i < 5; ++i) hall.hear(2, 10);
  for (double x = 2; x < 18; x += 1.0) {  // eastward; the steps say 0.25 rad to the left of that
    hall.filter.step({1.0, 0.1, 0.25, 0.1});
    hall.hear(x + 1, 10);
  }
  EXPECT_LT(hall.filter.estimate().heading_bias_rad, -0.04) << "the truth is -0.25; beacons alone tell it slowly";
}

TEST(BeaconFilter, ACompassThatTheBuildingTurnsLeadsNobodyAstray) {
  const auto beside_m = [](const std::string& text) {
    FilterOptions options;
    options.still_diffusion_m = 0.2;
    Hall hall(options, {}, text);
    for (int i = 0; i < 5; ++i) hall.hear(4, 10);
    double turned_rad = 0.0;  // of their headings, which follow the compass
    for (double x = 4; x < 18; x += 0.7) {
      turned_rad += -std::expm1(-0.15) * ((x < 8 ? 0.0 : 0.5) - turned_rad);
      hall.filter.step({0.7, 0.05, turned_rad, 0.05});
      hall.filter.advance(hall.now += 1000ms);
    }
    return std::abs(hall.filter.estimate().y_m - 10.0);
  };
  const double unknown_m = beside_m(kFourBeacons), known_m = beside_m(with_steel(8));
  EXPECT_GT(unknown_m, 2.0);
  EXPECT_LT(known_m, 0.5 * unknown_m);
}

TEST(BeaconFilter, AWallHoldsBackWhoseStepsRunIntoIt) {
  navigation::CommLevelMap plan;
  add_wall(plan, 12, -10, 12, 40);
  const auto walked = [&](bool walls) {
    FilterOptions options;
    options.walls = walls;
    Hall hall(options, plan);
    for (int i = 0; i < 10; ++i) hall.hear(8, 10);
    for (int i = 0; i < 10; ++i) hall.filter.step({1.0, 0.05, 0.0, 0.05});
    return hall.filter.estimate().x_m;
  };
  EXPECT_LT(walked(true), walked(false) - 2.0);
}

TEST(BeaconFilter, WhatWasHeardOnTheWayHoldsNobodyBack) {
  Hall hall;
  for (int i = 0; i < 8; ++i) hall.hear(3, 10);
  double behind_m = 0.0;
  int seconds = 0;
  for (double x = 3; x < 17; x += 1.4, ++seconds) {  // two steps a second, heard in the middle
    hall.filter.step({0.7, 0.05, 0.0, 0.05});
    hall.readings(x + 0.7, 10);
    hall.filter.step({0.7, 0.05, 0.0, 0.05});
    hall.filter.advance(hall.now += 1s);
    behind_m += x + 1.4 - hall.filter.estimate().x_m;
  }
  EXPECT_NEAR(behind_m / seconds, 0.0, 0.35);
}

TEST(BeaconFilter, NobodyIsCarriedOffWhileTheyStand) {
  Hall hall;
  for (int i = 0; i < 8; ++i) hall.hear(4, 10);
  hall.filter.step({0.5, 0.05, 0.0, 0.05});
  hall.hear(4.5, 10);
  for (int i = 0; i < 15; ++i) hall.hear(16, 10);  // as in a lift: not what is heard here
  EXPECT_LT(hall.filter.estimate().x_m, 10.0);
}

/// Two beacons in a row: what is heard to their left is heard to their right.
struct Row {
  BeaconMap map = parse(
      "name: 'row'\n"
      "beacons { id: '02:00:00:00:00:01' x: 0 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
      "beacons { id: '02:00:00:00:00:02' x: 20 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n",
      "row");
  std::array<Extent, 1> hall{Extent{0, -10, -10, 30, 10}};
  std::shared_ptr<const BeaconField> field = std::make_shared<const BeaconField>(map, hall);
  BeaconFilter filter{field, std::make_shared<const FloorPlan>(navigation::CommLevelMap()), map.accuracy(),
                      map.radio().offset()};
  Time now{0};

  void hear(double x, double y) {
    for (std::uint32_t beacon = 0; beacon < 2; ++beacon) {
      filter.heard(beacon, -59 - 10 * std::log10(std::pow(x - 20.0 * beacon, 2) + y * y + 1.0));
    }
    filter.advance(now += 1000ms);
  }
};

TEST(BeaconFilter, StandingTellsNobodyApartWhomOneSecondDoesNot) {
  Row row;
  row.filter.expect_steps(true);
  row.hear(4, 6);
  row.hear(4, 6);
  const double first_m2 = row.filter.estimate().spread(1, 1);
  for (int i = 0; i < 40; ++i) row.hear(4, 6);
  EXPECT_GT(first_m2, 15.0);
  EXPECT_GT(row.filter.estimate().spread(1, 1), 0.7 * first_m2);
}

TEST(BeaconFilter, WhoHasStoodIsFollowedFromTheirFirstStepOn) {
  Hall hall;
  hall.filter.expect_steps(true);
  for (int i = 0; i < 20; ++i) hall.hear(5, 10);
  for (int i = 1; i <= 10; ++i) {
    for (int step = 0; step < 2; ++step) hall.filter.step({0.5, 0.05, 0.0, 0.05});
    hall.hear(5.0 + i, 10);
  }
  const Estimate at = hall.filter.estimate();
  ASSERT_TRUE(at.is_valid());
  EXPECT_NEAR(at.x_m, 15, 1.5);
  EXPECT_NEAR(at.y_m, 10, 1.5);
}

TEST(BeaconFilter, WhoseStepsEndIsFollowedByWhatIsHeard) {
  Hall hall;
  hall.filter.expect_steps(true);
  for (int i = 0; i < 5; ++i) hall.hear(3, 10);
  hall.filter.step({0.5, 0.05, 0.0, 0.05});
  hall.hear(3.5, 10);
  hall.filter.expect_steps(false);  // who tells them has died, and they walk on
  for (double x = 4; x < 17; x += 1.0) hall.hear(x, 10);
  EXPECT_NEAR(hall.filter.estimate().x_m, 16, 4.0);
}

/// Up and down a corridor, with walls that steps run into, and nothing to hear: what they say is all that is left.
TEST(BeaconFilter, WhoseBeaconsFallSilentIsLessAndLessCertainAndAfterTwoMinutesNotPlaced) {
  navigation::CommLevelMap plan;
  add_wall(plan, -3, 8, 23, 8);
  add_wall(plan, -3, 12, 23, 12);
  Hall hall({}, plan);
  for (int i = 0; i < 10; ++i) hall.hear(4, 10);
  const double before_m2 = hall.filter.estimate().spread.trace();
  double x = 4.0;
  for (int second = 1; second <= 300; ++second) {
    const bool east = second / 12 % 2 == 0;
    x += east ? 1.0 : -1.0;
    hall.filter.step({1.0, 0.1, (east ? 0.0 : std::numbers::pi) + 0.3, 0.1});
    hall.filter.advance(hall.now += 1s);
    const Estimate at = hall.filter.estimate();
    EXPECT_EQ(at.validity, second <= 120 ? Validity::Valid : Validity::Unheard) << second;
    if (second == 15) {
      EXPECT_GT(at.spread.trace(), before_m2);
    }
    if (second == 60) {
      EXPECT_GT(at.covariance(0, 0), std::pow(0.1 * 45, 2));
    }
    EXPECT_GT(at.spread.trace(), 0.1) << second << ": few particles stand for all";
  }
  for (int i = 0; i < 20; ++i) {
    hall.filter.step({0.5, 0.1, i % 2 == 0 ? 0.0 : std::numbers::pi, 0.1});
    hall.hear(x, 10);
  }
  const Estimate again = hall.filter.estimate();
  EXPECT_TRUE(again.is_valid());
  EXPECT_NEAR(again.x_m, x, 3.0);
}

/// Hears a place, then nothing for so long, then another place: how far from that each second's estimate is, and how
/// far in the deviations that it tells.
struct Return {
  double off_m, off_sd;
};
std::vector<Return> return_after(std::chrono::seconds silence, double to_m, bool steps) {
  Hall hall;
  hall.filter.expect_steps(steps);
  const auto shuffle = [&](int i) {
    if (steps) hall.filter.step({0.5, 0.05, i % 2 == 0 ? 0.0 : std::numbers::pi, 0.1});
  };
  for (int i = 0; i < 15; ++i) shuffle(i), hall.hear(2, 2);
  for (int i = 0; i < silence.count(); ++i) {
    if (i % 2 == 0) shuffle(i / 2);
    hall.filter.advance(hall.now += 1s);
  }
  std::vector<Return> seconds;
  for (int i = 0; i < 20; ++i) {
    shuffle(i);
    hall.hear(to_m, to_m);
    const Estimate at = hall.filter.estimate();
    const Eigen::Vector2d off(at.x_m - to_m, at.y_m - to_m);
    if (at.is_valid()) seconds.push_back({off.norm(), std::sqrt(off.dot(at.covariance.inverse() * off))});
  }
  return seconds;
}

TEST(BeaconFilter, AfterTwoMinutesOfSilenceWhatIsHeardIsNotJudgedByWhereOneWas) {
  for (const bool steps : {true, false}) {
    for (const auto silence : {130s, 600s}) {
      const std::vector<Return> seconds = return_after(silence, 18.0, steps);
      ASSERT_GE(seconds.size(), 17u);
      for (const Return& second : seconds) EXPECT_LT(second.off_sd, 3.0) << silence.count() << " s, steps " << steps;
      EXPECT_LT(seconds[2].off_m, 5.0) << silence.count() << " s, steps " << steps;
    }
  }
}

TEST(BeaconFilter, TheDoubtOfASilentMinuteIsThatOfTheParticlesToo) {
  const std::vector<Return> seconds = return_after(100s, 10.0, true);
  ASSERT_EQ(seconds.size(), 20u);
  for (const Return& second : seconds) EXPECT_LT(second.off_sd, 3.0);
  EXPECT_LT(seconds[2].off_m, 4.0);
}

TEST(BeaconFilter, EqualInputsAndSeedGiveEqualAnswers) {
  Hall one, two;
  for (int i = 0; i < 10; ++i) one.hear(3, 4), two.hear(3, 4);
  EXPECT_EQ(one.filter.estimate().x_m, two.filter.estimate().x_m);
}

}  // namespace
}  // namespace fiona::beacons
