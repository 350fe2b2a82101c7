// Beacon maps, walls, and the component around the filter over them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>

#include <Eigen/Cholesky>

#include "../error_of.hpp"
#include "beacon_field.hpp"
#include "beacon_hall.hpp"
#include "beacon_map.hpp"
#include "fiona/error.hpp"
#include "fiona/objects/step.hpp"
#include "fiona/testing/bench.hpp"
#include "floor_plan.hpp"
#include "smart_bluetooth_localization.hpp"
#include "survey_learner.hpp"
#include "survey_walks.hpp"

namespace fiona::beacons {
namespace {

using tests::error_of;

using namespace std::chrono_literals;
using smart_bluetooth_localization::SmartBluetoothLocalization;
using testing::Bench;

/// Places of a survey around a beacon, a metre apart, with what was heard beyond its path loss.
struct Surveyed {
  Surveyed() {
    for (int x = 0; x < 24; ++x) {
      for (int y = 0; y < 12; ++y) {
        points.push_back({static_cast<double>(x), static_cast<double>(y)});
        beyond_db.push_back(6.0 * std::sin(0.7 * x) * std::cos(0.4 * y));
      }
    }
  }
  BeaconMap map() const {
    BeaconMap result = parse("beacons { id: 'c0de/1/1' x: 3 y: 4 heard { level: 0 power: -59 } exponent: 2 }", "grid");
    for (std::size_t i = 0; i < points.size(); ++i) {
      auto& place = *result.add_survey();
      place.set_x(points[i].x());
      place.set_y(points[i].y());
      auto& reading = *place.add_readings();
      reading.set_rssi(path_loss_dbm(points[i]) + beyond_db[i]);
      reading.set_count(1);
    }
    return result;
  }
  static double path_loss_dbm(const Eigen::Vector2d& at) {
    return -59 - 10 * std::log10((at - Eigen::Vector2d(3, 4)).squaredNorm() + 1.0);
  }

  std::vector<Eigen::Vector2d> points;
  std::vector<double> beyond_db;
};

TEST(BeaconField, OfBlocksIsThatOfTheWholeProcess) {
  const Surveyed surveyed;
  const BeaconMap map = surveyed.map();
  const BeaconField field(map);
  const auto n = static_cast<Eigen::Index>(surveyed.points.size());
  const double variance = std::pow(map.radio().shadowing(), 2), reach = map.radio().shadowing_reach();
  const auto between = [&](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return variance * std::exp(-0.5 * (a - b).squaredNorm() / (reach * reach));
  };
  Eigen::MatrixXd covariance(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) covariance(i, j) = between(surveyed.points[i], surveyed.points[j]);
    covariance(i, i) += std::pow(map.radio().reading(), 2);
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
  const Eigen::VectorXd weights = factor.solve(Eigen::Map<const Eigen::VectorXd>(surveyed.beyond_db.data(), n));
  for (std::size_t cell = 0; cell < field.cells(); cell += 7) {
    const auto centre = field.centre(0, cell);
    const Eigen::Vector2d at(centre.x_m, centre.y_m);
    Eigen::VectorXd to(n);
    for (Eigen::Index i = 0; i < n; ++i) to[i] = between(surveyed.points[i], at);
    const Expected& is = field.of_cell(cell)[0];
    ASSERT_NEAR(is.mean_dbm, Surveyed::path_loss_dbm(at) + to.dot(weights), 0.02) << at.transpose();
    ASSERT_NEAR(is.variance_db2, variance - to.dot(factor.solve(to)), 0.05) << at.transpose();
  }
}

TEST(BeaconField, ReachesTwoMetresBeyondTheSurveyAndFourBeyondBeacons) {
  const auto spans = [](const BeaconMap& map) {
    const BeaconField field(map);
    const auto& level = field.levels()[0];
    const auto first = field.centre(0, 0), last = field.centre(0, std::size_t{level.columns} * level.rows - 1);
    return Eigen::Vector4d(first.x_m, first.y_m, last.x_m, last.y_m);
  };
  EXPECT_LT((spans(Surveyed().map()) - Eigen::Vector4d(-2, -2, 25, 13)).cwiseAbs().maxCoeff(), 0.5);
  EXPECT_LT((spans(parse(kFourBeacons, "hall")) - Eigen::Vector4d(-4, -4, 24, 24)).cwiseAbs().maxCoeff(), 0.5);
}

TEST(BeaconField, TurnsACompassWhereTheSurveySaysSo) {
  const BeaconField field(parse(with_steel(10), "hall"));
  EXPECT_TRUE(field.knows_compass());
  EXPECT_NEAR(field.compass_deviation_rad(0, 15, 10), 0.5, 0.05);
  EXPECT_NEAR(field.compass_deviation_rad(0, 5, 10), 0.0, 0.01);
  EXPECT_FALSE(BeaconField(parse(kFourBeacons, "hall")).knows_compass());
}

TEST(BeaconField, OfMoreBeaconsAndLevelsThanItCanHoldIsRefused) {
  BeaconMap map;
  map.set_name("airport");
  for (int i = 0; i < 65'536; ++i) {
    auto& on = *map.add_beacons()->add_heard();
    on.set_level(i % 300);
    on.set_power(-59);
  }
  EXPECT_EQ(
      error_of([&] { BeaconField field(map); }),
      "airport: the beacon map is too large\n  expected: 16777216 values, a beacon on a level each\n  found: 65536 "
      "beacons, 300 levels\n  next: a map for each building");
}

TEST(BeaconMap, AMapByHandTakesTheUsualRadio) {
  const BeaconMap map = parse(kFourBeacons, "hall");
  EXPECT_EQ(map.beacons_size(), 4);
  EXPECT_EQ(map.radio().reading(), usual_radio().reading());
}

TEST(BeaconMap, WhatIsNoMapIsNamedByLineAndColumn) {
  const std::string error = error_of([] { parse("name: 'hall'\nbeacon { }", "hall.beacons"); });
  EXPECT_NE(error.find("hall.beacons:2:"), std::string::npos) << error;
  EXPECT_NE(error.find("this is no beacon map"), std::string::npos) << error;
}

TEST(BeaconMap, ABeaconWhoseValueCannotBeIsNamed) {
  const std::string error = error_of([] { parse("beacons { id: 'a' x: nan heard { level: 0 power: -59 } }", "hall"); });
  EXPECT_NE(error.find("beacon 'a': x cannot be"), std::string::npos) << error;
}

TEST(BeaconMap, ADeviationOfMoreThanHalfATurnIsNamed) {
  const std::string text = std::string(kFourBeacons) + "compass { angle: 0.2 steps: 3 } compass { angle: 4 steps: 3 }";
  const std::string error = error_of([&] { parse(text, "hall"); });
  EXPECT_NE(error.find("compass 2: angle cannot be 4"), std::string::npos) << error;
}

TEST(BeaconMap, OneBeaconTwiceIsRefusedHoweverItsAddressIsSpelt) {
  const std::string error = error_of([] {
    parse("beacons { id: 'AA:01' heard { level: 0 power: -59 } } beacons { id: 'aa01' heard { level: 0 power: -59 } }",
          "hall");
  });
  EXPECT_NE(error.find("beacon 'aa01' is there twice"), std::string::npos) << error;
}

TEST(FloorPlan, AWallIsBetweenItsSidesAndNotBesideItsEnds) {
  navigation::CommLevelMap map;
  add_wall(map, 5, 0, 5, 10);
  const FloorPlan plan(map);
  EXPECT_TRUE(plan.wall_between(0, 4, 5, 6, 5));
  EXPECT_FALSE(plan.wall_between(0, 4, 11, 6, 11));
  EXPECT_FALSE(plan.wall_between(0, 3, 5, 4, 5));
  EXPECT_FALSE(plan.wall_between(1, 4, 5, 6, 5)) << "another level";
}

TEST(FloorPlan, WallsLongerThanABucketAreSeenEverywhere) {
  navigation::CommLevelMap map;
  add_wall(map, -50, -30, 50, 30);
  const FloorPlan plan(map);
  for (double x = -49; x < 50; x += 1.7) EXPECT_TRUE(plan.wall_between(0, x, 0.6 * x - 0.5, x, 0.6 * x + 0.5)) << x;
}

TEST(FloorPlan, AMapLargerThanABuildingIsRefused) {
  navigation::CommLevelMap map;
  add_wall(map, 0, 0, 1e5, 1e5);
  const std::string error = error_of([&] { FloorPlan plan(map); });
  EXPECT_NE(error.find("the level map is larger than a building"), std::string::npos) << error;
}

TEST(FloorPlan, AMapOfTooManyLongWallsIsRefused) {
  navigation::CommLevelMap map;
  for (int i = 0; i < 1000; ++i) add_wall(map, 0, 0, 500, 500);
  const std::string error = error_of([&] { FloorPlan plan(map); });
  EXPECT_NE(error.find("too many long walls and large rooms"), std::string::npos) << error;
}

TEST(FloorPlan, StairsOverALandingAreOneWayUpAndOneDown) {
  navigation::CommLevelMap map;
  for (const double level : {0.0, 0.5, 1.0}) {
    auto& node = *map.add_nodes();
    node.set_x(level), node.set_level(level);
  }
  for (std::uint32_t i = 0; i < 2; ++i) {
    auto& edge = *map.add_edges();
    edge.set_from(i), edge.set_to(i + 1), edge.set_kind(navigation::MapEdge::STAIRS);
  }
  const FloorPlan plan(map);
  ASSERT_EQ(plan.ways().size(), 2u);
  EXPECT_EQ(plan.ways()[0].to_level, 1);
  EXPECT_EQ(plan.ways()[1].to_level, 0);
  const FloorPlan::Way& up = plan.ways()[0];
  EXPECT_FALSE(up.is_lift());
  ASSERT_EQ(up.path.size(), 3u);
  EXPECT_EQ(up.length_m(), 1.0);
  EXPECT_EQ(up.at(0.75).x_m, 0.75);
  EXPECT_EQ(up.at(0.75).level, 0.75);
}

/// As where its shaft is drawn level by level.
TEST(FloorPlan, ALiftIsOneThoughItsStopsAreNotRightAboveEachOther) {
  navigation::CommLevelMap map;
  for (const double level : {0.0, 1.0}) {
    auto& node = *map.add_nodes();
    node.set_x(3 * level), node.set_level(level);
  }
  auto& edge = *map.add_edges();
  edge.set_from(0), edge.set_to(1), edge.set_kind(navigation::MapEdge::LIFT);
  const FloorPlan lift(map);
  ASSERT_EQ(lift.ways().size(), 2u);
  EXPECT_TRUE(lift.ways()[0].is_lift());
  EXPECT_TRUE(lift.ways()[1].is_lift());
  EXPECT_EQ(lift.ways()[0].at(1.0).x_m, 3.0);
  EXPECT_EQ(lift.ways()[0].at(0.5).level, 0.5);
  edge.set_kind(navigation::MapEdge::STAIRS);
  EXPECT_FALSE(FloorPlan(map).ways()[0].is_lift());
}

TEST(FloorPlan, WhatIsBetweenTwoLevelsStandsOnNeither) {
  navigation::CommLevelMap map;
  add_wall(map, 0, 0, 0, 10);
  add_wall(map, 5, 0, 5, 10);
  map.mutable_walls(1)->set_level(0.5);
  for (const auto& [level, floor_m] : {std::pair(0.0, 0.0), {1.0, 4.0}, {1.4, 5.5}}) {
    auto& told = *map.add_levels();
    told.set_level(level), told.set_floor(floor_m);
    auto& wall = *map.add_walls();
    wall.set_level(level), wall.set_x2(1);
  }
  const FloorPlan plan(map);
  EXPECT_FALSE(plan.wall_between(0, 4, 5, 6, 5));
  EXPECT_FALSE(plan.wall_between(1, 4, 5, 6, 5));
  EXPECT_EQ(plan.rise_m(0, 1), 4.0);
}

TEST(FloorPlan, ARoomThatNobodyMayEnterIsClosedAndNoPlaceToBe) {
  navigation::CommLevelMap map;
  for (const int access : {0, 10}) {
    auto& room = *map.add_rooms();
    room.set_access(access);
    const double west = access;
    for (const auto& [x, y] : {std::pair(west, 0.0), {west + 9, 0.0}, {west + 9, 9.0}, {west, 9.0}})
      room.mutable_outline()->add_x(x), room.mutable_outline()->add_y(y);
  }
  const FloorPlan plan(map);
  EXPECT_FALSE(plan.is_closed(0, 5, 5));
  EXPECT_TRUE(plan.may_be_at(0, 5, 5));
  EXPECT_TRUE(plan.is_closed(0, 15, 5));
  EXPECT_FALSE(plan.may_be_at(0, 15, 5));
  EXPECT_FALSE(plan.is_closed(1, 15, 5));
}

TEST(FloorPlan, WithoutHeightsOfItsFloorsNobodyIsToldHowFarTheyAreApart) {
  navigation::CommLevelMap map;
  for (const int level : {0, 1, 2}) add_wall(map, 0, 0, 10, 0, level);
  EXPECT_EQ(FloorPlan(map).rise_m(0, 1), std::nullopt);
  EXPECT_EQ(FloorPlan(map).rise_m(1, 1), 0.0);
  for (const int level : {0, 1, 2}) {
    auto& told = *map.add_levels();
    told.set_level(level), told.set_floor(3.5 * level);
  }
  EXPECT_EQ(FloorPlan(map).rise_m(2, 0), -7.0);
  EXPECT_EQ(FloorPlan(map).rise_m(0, 5), std::nullopt);
}

TEST(SurveyLearner, BeaconsAreFoundWhereTheyAreAndReceiversBesideEachOther) {
  std::vector<SurveySecond> survey;
  for (std::uint32_t walk = 0; walk < 2; ++walk) {
    for (double x = 0; x <= 20; x += 1.0) {
      for (double y = 0; y <= 20; y += 2.0) {
        SurveySecond second{walk, x, y, 0, {}};
        for (int b = 0; b < 4; ++b)
          second.rssi_dbm[std::to_string(b)] = static_cast<float>(rssi_dbm(x, y, b) + (walk == 0 ? 4 : -4));
        survey.push_back(second);
      }
    }
  }
  const BeaconMap map = learn(survey, "hall");
  ASSERT_EQ(map.beacons_size(), 4);
  EXPECT_NEAR(map.beacons(3).x(), 20, 1.0);
  EXPECT_NEAR(map.beacons(3).y(), 20, 1.0);
  EXPECT_NEAR(map.beacons(3).exponent(), 2.0, 0.1);
  EXPECT_NEAR(map.beacons(3).heard(0).power(), -59, 1.0);
}

/// By someone who walks eastwards and back, with a phone that they hold 0.1 rad to the left.
radio::Journey survey_walk(double steel_from_x_m) {
  radio::Journey walk;
  for (const auto& [t_ms, x] : {std::pair(0, 0.0), {20'000, 20.0}, {25'000, 20.0}, {45'000, 0.0}})
    walk.way_points.emplace_back(t_ms, walk::WayPoint{x, 3.0, 0});
  for (int t_ms = 0; t_ms < 45'000; t_ms += 500) {
    const double x = t_ms < 20'000 ? t_ms / 1000.0 : t_ms < 25'000 ? 20.0 : 45.0 - t_ms / 1000.0;
    const double way_rad = t_ms < 22'500 ? 0.0 : std::numbers::pi;
    const double compass_rad = way_rad + 0.1 + (x < steel_from_x_m ? -0.2 : 0.2);
    walk.told.push_back({Time(t_ms + 400), radio::StepInput{Time(t_ms), 0.5, 0.05, way_rad, 0.1, compass_rad}});
  }
  return walk;
}

TEST(SurveyLearner, WhatTurnsACompassInOnePlaceIsLearntAndWhatDoesEverywhereIsNot) {
  BeaconMap map;
  learn_compass({survey_walk(10), survey_walk(10)}, map);
  ASSERT_GT(map.compass_size(), 15);
  for (const auto& one : map.compass()) {
    if (std::abs(one.x() - 10) < 1.5) continue;  // a place of both
    EXPECT_NEAR(one.angle(), one.x() < 10 ? -0.2 : 0.2, 0.03) << "at " << one.x();
    EXPECT_NEAR(one.y(), 3.0, 1e-9);
    EXPECT_GE(one.steps(), 4U);
  }
}

TEST(SurveyLearner, WhoStandsOrTurnsTeachesNothingAboutTheCompass) {
  radio::Journey stands = survey_walk(10);
  stands.way_points = {{0, walk::WayPoint{5.0, 3.0, 0}}, {45'000, walk::WayPoint{5.0, 3.0, 0}}};
  BeaconMap map;
  learn_compass({stands}, map);
  EXPECT_EQ(map.compass_size(), 0);
}

/// The component over the hall's map in a file.
class Component : public ::testing::Test {
 protected:
  Component() {
    std::ofstream(file_) << kFourBeacons;
    bench_.set("beacons", file_.c_str());
  }
  void hear(double x, double y) { hear(bench_, x, y); }
  /// `told_ms`: when it was heard, by the scanner's clock.
  static void hear(Bench<SmartBluetoothLocalization>& bench, double x, double y,
                   std::optional<std::int64_t> told_ms = {}) {
    sensors::CommiBeaconList list;
    for (int b = 0; b < 4; ++b) {
      auto& beacon = *list.add_beacon_list();
      if (b < 3) beacon.set_address("02:00:00:00:00:0" + std::to_string(b + 1));
      beacon.set_uuid("c0de"), beacon.set_major(1), beacon.set_minor(static_cast<std::uint32_t>(b + 1));
      beacon.set_rssi(static_cast<int>(std::lround(rssi_dbm(x, y, b))));
      if (told_ms) beacon.set_t(*told_ms);
    }
    bench.put<sensors::IbeaconlistProvider>("beacons", list);
    bench.advance(1s);
  }
  localisation::CommLocation location() {
    const auto all = bench_.take<localisation::LocationProvider>("location");
    return all.empty() ? localisation::CommLocation() : *all.back();
  }

  const std::string file_ = ::testing::TempDir() + "hall" + std::to_string(::getpid()) + ".beacons";
  Bench<SmartBluetoothLocalization> bench_{"ble"};
};

TEST_F(Component, BeaconsByAddressAndByTripletGiveAValidLocationFiveTimesASecond) {
  bench_.start();
  for (int i = 0; i < 15; ++i) hear(6, 13);
  bench_.take<localisation::LocationProvider>("location");
  bench_.advance(2s);
  const auto all = bench_.take<localisation::LocationProvider>("location");
  ASSERT_NEAR(static_cast<double>(all.size()), 10, 1);
  EXPECT_TRUE(all.back()->is_valid());
  EXPECT_NEAR(all.back()->position().x(), 6, 2.5);
  EXPECT_EQ(all.back()->position().confidence_size(), 9);
}

/// The tablet's clock is an hour behind the laptop's, and half a minute later set to be an hour ahead.
TEST_F(Component, TheClockOfWhoListensIsNotItsOwn) {
  bench_.advance(2h);  // no reading is of a time below zero
  bench_.start();
  const std::int64_t hour_ms = 3'600'000;
  for (const std::int64_t off_ms : {-hour_ms, hour_ms, -hour_ms}) {
    for (int i = 0; i < 10; ++i) hear(bench_, 5, 10, to_milliseconds(bench_.now()) + off_ms);
    const auto told = location();
    ASSERT_TRUE(told.is_valid()) << off_ms;
    EXPECT_NEAR(told.position().x(), 5, 4.0);
  }
  EXPECT_EQ(bench_.probe<std::uint64_t>("old_readings").value_or(0), 0u);
}

TEST_F(Component, AReadingThatIsToldAgainIsUsedOnceAndOneOfLongAgoNotAtAll) {
  bench_.start();
  const std::int64_t began_ms = to_milliseconds(bench_.now());
  for (int i = 0; i < 3; ++i) hear(bench_, 5, 10, began_ms);
  bench_.take<localisation::LocationProvider>("location");
  sensors::CommiBeaconList list;
  for (const int ago_ms : {0, 4000}) {
    auto& beacon = *list.add_beacon_list();
    beacon.set_address(ago_ms == 0 ? "02:00:00:00:00:01" : "02:00:00:00:00:02");
    beacon.set_rssi(-60);
    beacon.set_t(began_ms + 10'000 - ago_ms);
  }
  bench_.put<sensors::IbeaconlistProvider>("beacons", list);
  bench_.advance(1s);
  EXPECT_EQ(bench_.probe<std::uint64_t>("old_readings"), 1u);
}

TEST_F(Component, BeforeAnythingIsHeardTheLocationIsInvalid) {
  bench_.start();
  bench_.advance(1s);
  EXPECT_FALSE(location().is_valid());
  EXPECT_EQ(bench_.probe<std::string>("validity"), "no known beacon heard yet");
}

TEST_F(Component, WhenNoBeaconIsHeardForTwoMinutesThereIsNoPositionUntilOneIs) {
  bench_.start();
  for (int i = 0; i < 10; ++i) hear(6, 13);
  bench_.advance(119s);
  EXPECT_TRUE(location().is_valid());
  bench_.advance(3s);
  EXPECT_FALSE(location().is_valid());
  EXPECT_EQ(bench_.probe<std::string>("validity"), "no known beacon heard for two minutes");
  hear(6, 13);
  bench_.advance(1s);
  EXPECT_TRUE(location().is_valid());
}

TEST_F(Component, AnotherMapOfTheSameBuildingLosesNobody) {
  navigation::CommLevelMap map;
  map.set_version(7);
  add_wall(map, 12, -10, 12, 40);
  bench_.answer_with<navigation::LevelMap>("levels", [&](const navigation::CommLevelMapRequest&) { return map; });
  bench_.start();
  bench_.advance(3s);
  for (int i = 0; i < 10; ++i) hear(6, 13);
  map.set_version(8);
  add_wall(map, 4, 0, 4, 5);
  navigation::LevelMapVersion changed;
  changed.set_version(8);
  ASSERT_EQ(bench_.fire<navigation::LevelMapChange>("map_change", changed), 1u);
  bench_.advance(1s);
  EXPECT_TRUE(location().is_valid()) << "at once, and not once it has been heard for a while";
}

TEST_F(Component, WallsComeFromTheLevelMap) {
  bench_.answer_with<navigation::LevelMap>("levels", [](const navigation::CommLevelMapRequest&) {
    navigation::CommLevelMap map;
    map.set_version(7);
    add_wall(map, 12, -10, 12, 40);
    return map;
  });
  bench_.start();
  bench_.advance(3s);
  EXPECT_EQ(bench_.probe<bool>("has_walls"), true);
}

TEST_F(Component, StepsAgainstTrueNorthLeadAlongTheAxesOfATurnedMap) {
  bench_.answer_with<navigation::LevelMap>("levels", [](const navigation::CommLevelMapRequest&) {
    navigation::CommLevelMap map;
    map.set_version(7);
    map.mutable_reference()->set_reference_lat(48.4), map.mutable_reference()->set_reference_long(10.0);
    map.mutable_reference()->set_reference_heading(90);  // its y axis points east
    return map;
  });
  bench_.start();
  for (int i = 0; i < 10; ++i) hear(4, 10);
  bench_.take<localisation::LocationProvider>("location");
  for (int i = 0; i < 8; ++i) {
    localisation::CommStep east;
    east.set_is_valid(true), east.set_length(0.7), east.set_length_var(0.01), east.set_heading_var(0.01);
    bench_.put<localisation::StepProvider>("steps", east);
    bench_.advance(500ms);
  }
  const auto position = location().position();
  EXPECT_NEAR(position.x(), 4, 2.5);
  EXPECT_NEAR(position.y(), 10 + 8 * 0.7, 2.5);
  EXPECT_EQ(position.reference_heading(), 90);
}

TEST_F(Component, BeaconsStayWhereTheyAreWhenTheBuildingIsDrawnAroundAnotherOrigin) {
  std::ofstream(file_) << kFourBeacons << " reference { latitude: 48.4 longitude: 10.0 }";
  navigation::CommLevelMap map;
  map.set_version(7);
  map.mutable_reference()->set_reference_lat(48.4), map.mutable_reference()->set_reference_long(10.0);
  map.mutable_reference()->set_reference_heading(90);  // its y axis points east, and x south
  bench_.answer_with<navigation::LevelMap>("levels", [&](const navigation::CommLevelMapRequest&) { return map; });
  bench_.start();
  bench_.advance(3s);
  for (int i = 0; i < 15; ++i) hear(6, 13);
  const auto turned = location().position();
  EXPECT_NEAR(turned.x(), -13, 2.5);
  EXPECT_NEAR(turned.y(), 6, 2.5);
  EXPECT_EQ(turned.reference_heading(), 90);
  map.set_version(8);
  map.mutable_reference()->set_reference_heading(0);
  navigation::LevelMapVersion changed;
  changed.set_version(8);
  ASSERT_EQ(bench_.fire<navigation::LevelMapChange>("map_change", changed), 1u);
  bench_.advance(1s);
  for (int i = 0; i < 15; ++i) hear(6, 13);
  const auto back = location().position();
  EXPECT_NEAR(back.x(), 6, 2.5);
  EXPECT_NEAR(back.y(), 13, 2.5);
}

TEST_F(Component, WithoutABuildingTheFrameIsThatOfTheBeaconMap) {
  std::ofstream(file_) << kFourBeacons << " reference { latitude: 48.4 longitude: 10.0 heading: 30 }";
  bench_.start();
  for (int i = 0; i < 15; ++i) hear(6, 13);
  const auto position = location().position();
  EXPECT_EQ(position.reference_lat(), 48.4);
  EXPECT_NEAR(position.reference_heading(), 30, 1e-9);
}

TEST_F(Component, ALevelBetweenTwoIsTold) {
  bench_.answer_with<navigation::LevelMap>("levels", [](const navigation::CommLevelMapRequest&) {
    navigation::CommLevelMap map;
    map.set_version(7);
    map.set_name("hall");
    for (const double level : {0.0, 0.5}) {
      auto& room = *map.add_rooms();
      room.set_level(level);
      for (const auto& [x, y] : {std::pair{0, 0}, {30, 0}, {30, 30}})
        room.mutable_outline()->add_x(x), room.mutable_outline()->add_y(y);
    }
    return map;
  });
  bench_.start();
  bench_.advance(3s);
  EXPECT_THAT(bench_.log(), ::testing::Contains(::testing::HasSubstr(
                                "positions have whole levels: who is on 0.5 of 'hall' is found on one beside it")));
}

TEST(CommStep, ThatTellsNoVarianceIsNotExact) {
  localisation::CommStep step;
  step.set_length(0.7);
  EXPECT_NEAR(localisation::length_sd_m(step), 0.14, 1e-9);
  EXPECT_NEAR(localisation::heading_sd_rad(step), 0.3, 1e-9);
  step.set_length_var(0.0), step.set_heading_var(0.04);
  EXPECT_EQ(localisation::length_sd_m(step), 0.0);
  EXPECT_NEAR(localisation::heading_sd_rad(step), 0.2, 1e-9);
}

TEST_F(Component, TheOrientationIsPassedOnLessTheBiasOfTheHeading) {
  bench_.start();
  for (int i = 0; i < 10; ++i) hear(6, 13);
  localisation::CommOrientation held;
  held.set_is_valid(true), held.set_yaw(1.0);
  for (int i = 0; i < 9; ++i) held.add_confidence(i % 4 == 0 ? 0.01 : 0.0);
  bench_.put<localisation::OrientationProvider>("orientation", held);
  bench_.advance(200ms);
  const auto told = location().orientation();
  ASSERT_TRUE(told.is_valid());
  EXPECT_NEAR(told.yaw(), 1.0 + *bench_.probe<double>("heading_bias"), 1e-9);
  EXPECT_GT(told.confidence(0), 0.01) << "and what the bias is not known by comes on top";
  EXPECT_EQ(told.confidence(4), 0.01);
  bench_.advance(2s);
  EXPECT_FALSE(location().has_orientation()) << "one of two seconds ago says nothing of now";
}

TEST_F(Component, ABeaconThatIsNotInTheMapIsCounted) {
  bench_.start();
  sensors::CommiBeaconList list;
  list.add_beacon_list()->set_rssi(-60);
  bench_.put<sensors::IbeaconlistProvider>("beacons", list);
  EXPECT_EQ(bench_.probe<std::uint64_t>("unknown_beacons"), 1u);
}

TEST(SmartBluetoothLocalization, WithoutABeaconMapItRefusesToStartAndSaysHowToMakeOne) {
  Bench<SmartBluetoothLocalization> bench("ble");
  const std::string error = error_of([&] { bench.start(); });
  EXPECT_NE(error.find("no beacon map is named"), std::string::npos) << error;
  EXPECT_NE(error.find("fiona-beaconmap learn FOLDER -o FILE"), std::string::npos) << error;
}

}  // namespace
}  // namespace fiona::beacons
