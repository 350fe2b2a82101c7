// Beacon maps, walls, the filter over them, and the component around it.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>

#include <Eigen/Cholesky>

#include "beacon_field.hpp"
#include "beacon_filter.hpp"
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

using namespace std::chrono_literals;
using smart_bluetooth_localization::SmartBluetoothLocalization;
using testing::Bench;

std::string error_of(const std::function<void()>& act) {
  try {
    act();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

constexpr const char* kFourBeacons =
    "name: 'hall'\n"
    "beacons { id: '02:00:00:00:00:01' x: 0 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: '02:00:00:00:00:02' x: 20 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: '02:00:00:00:00:03' x: 0 y: 20 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: 'c0de/1/4' x: 20 y: 20 heard { level: 0 power: -59 } exponent: 2 }\n";

double rssi_dbm(double x, double y, int beacon) {
  const double dx = x - (beacon % 2 == 1 ? 20.0 : 0.0), dy = y - (beacon >= 2 ? 20.0 : 0.0);
  return -59 - 10 * std::log10(dx * dx + dy * dy + 1.0);
}

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

/// The hall with steel in its east, which turns compasses there to the left.
std::string with_steel(double from_x_m) {
  std::string text = kFourBeacons;
  for (int x = 0; x <= 20; ++x) {
    for (int y = 0; y <= 20; ++y)
      text += "compass { x: " + std::to_string(x) + " y: " + std::to_string(y) +
              " angle: " + (x < from_x_m ? "0.0" : "0.5") + " steps: 4 }\n";
  }
  return text;
}

TEST(BeaconField, TurnsACompassWhereTheSurveySaysSo) {
  const BeaconField field(parse(with_steel(10), "hall"));
  EXPECT_TRUE(field.knows_compass());
  EXPECT_NEAR(field.compass_deviation_rad(0, 15, 10), 0.5, 0.05);
  EXPECT_NEAR(field.compass_deviation_rad(0, 5, 10), 0.0, 0.01);
  EXPECT_FALSE(BeaconField(parse(kFourBeacons, "hall")).knows_compass());
}

/// A filter over the hall, for one who is heard there `offset_db` too strong.
struct Hall {
  explicit Hall(const FilterOptions& options = {}, navigation::CommLevelMap plan_map = {},
                const std::string& text = kFourBeacons)
      : map(parse(text, "hall")),
        field(std::make_shared<const BeaconField>(map)),
        filter(field, std::make_shared<const FloorPlan>(plan_map), map.accuracy(), map.radio().offset(), options) {}

  void readings(double x, double y, double offset_db = 0.0) {
    for (int beacon = 0; beacon < 4; ++beacon)
      filter.heard(static_cast<std::uint32_t>(beacon), rssi_dbm(x, y, beacon) + offset_db);
  }
  void hear(double x, double y, double offset_db = 0.0) {
    readings(x, y, offset_db);
    filter.advance(now += 1000ms);
  }

  BeaconMap map;
  std::shared_ptr<const BeaconField> field;
  BeaconFilter filter;
  Time now{0};
};

void add_wall(navigation::CommLevelMap& map, double x1, double y1, double x2, double y2, double level = 0) {
  auto& wall = *map.add_walls();
  wall.set_x1(x1), wall.set_y1(y1), wall.set_x2(x2), wall.set_y2(y2), wall.set_level(level);
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
  row.filter.expect_steps();
  row.hear(4, 6);
  row.hear(4, 6);
  const double first_m2 = row.filter.estimate().spread(1, 1);
  for (int i = 0; i < 40; ++i) row.hear(4, 6);
  EXPECT_GT(first_m2, 15.0);
  EXPECT_GT(row.filter.estimate().spread(1, 1), 0.7 * first_m2);
}

TEST(BeaconFilter, WhoHasStoodIsFollowedFromTheirFirstStepOn) {
  Hall hall;
  hall.filter.expect_steps();
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
    if (kind == navigation::MapEdge::STAIRS) add_staircase(plan, far_m);
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

TEST(BeaconFilter, EqualInputsAndSeedGiveEqualAnswers) {
  Hall one, two;
  for (int i = 0; i < 10; ++i) one.hear(3, 4), two.hear(3, 4);
  EXPECT_EQ(one.filter.estimate().x_m, two.filter.estimate().x_m);
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
  static void hear(Bench<SmartBluetoothLocalization>& bench, double x, double y) {
    sensors::CommiBeaconList list;
    for (int b = 0; b < 4; ++b) {
      auto& beacon = *list.add_beacon_list();
      if (b < 3) beacon.set_address("02:00:00:00:00:0" + std::to_string(b + 1));
      beacon.set_uuid("c0de"), beacon.set_major(1), beacon.set_minor(static_cast<std::uint32_t>(b + 1));
      beacon.set_rssi(static_cast<int>(std::lround(rssi_dbm(x, y, b))));
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

TEST_F(Component, BeforeAnythingIsHeardTheLocationIsInvalid) {
  bench_.start();
  bench_.advance(1s);
  EXPECT_FALSE(location().is_valid());
  EXPECT_EQ(bench_.probe<std::string>("validity"), "no known beacon heard yet");
}

TEST_F(Component, WallsComeFromTheLevelMap) {
  bench_.answer_with<navigation::LevelMap>("map", [](const navigation::CommLevelMapRequest&) {
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
  bench_.answer_with<navigation::LevelMap>("map", [](const navigation::CommLevelMapRequest&) {
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
