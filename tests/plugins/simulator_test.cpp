#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <numbers>
#include <set>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

#include <fiona/building/building.hpp>
#include <fiona/building/geometry.hpp>
#include <fiona/error.hpp>
#include <fiona/simulator/guided_walker.hpp>
#include <fiona/simulator/imu_model.hpp>
#include <fiona/simulator/radio_model.hpp>
#include <fiona/simulator/random.hpp>
#include <fiona/simulator/survey.hpp>
#include <fiona/simulator/walker.hpp>

#include "../temporary_directory.hpp"

namespace fiona::simulator {
namespace {

using building::Building;

const Building& house() {
  static const Building kHouse = Building::read(FIONA_BUILDING_FILE);
  return kHouse;
}

constexpr milliseconds kMinutes{60'000};
constexpr double kTurn = 2.0 * std::numbers::pi;

Truth standing(double x_m, double y_m, double level, double heading_rad = 0.0) {
  Truth truth;
  truth.x_m = x_m, truth.y_m = y_m, truth.level = level;
  truth.height_m = house().height_m(level);
  truth.heading_rad = heading_rad;
  return truth;
}

/// A person who walks straight north for ever.
Truth walking(milliseconds t) {
  Truth truth = standing(30, 10, 0);
  truth.t = t;
  truth.speed_mps = truth.velocity_y_mps = 1.3;
  truth.cadence_hz = 1.8;
  truth.steps = 1.8 * static_cast<double>(t.count()) / 1000.0;
  return truth;
}

TEST(GuidedWalker, ToldToStartWithoutADirectionTheyLeaveTheRoom) {
  hmi::Instruction start, stop;
  start.set_number(1), start.set_kind(hmi::Instruction::START);
  stop.set_number(2), stop.set_kind(hmi::Instruction::LOST);
  for (const char* name : {"0.01", "0.02", "1.01"}) {
    const building::Room& room = house().room(name);
    GuidedWalker walker(house(), 1, {.start_room = name});
    walker.hear(start);
    walker.advance(milliseconds(6000));
    walker.hear(stop);
    walker.advance(milliseconds(9000));
    EXPECT_FALSE(building::contains(room.polygon, {walker.truth().x_m, walker.truth().y_m})) << name;
    EXPECT_EQ(walker.truth().speed_mps, 0.0);
  }
}

TEST(GuidedWalker, WhoStandsAtADoorGoesThroughItWithoutTurningRound) {
  const building::Room& room = house().room("0.01");
  const auto door = std::find_if(house().doors().begin(), house().doors().end(), [&](const building::Door& one) {
    const auto sides = building::edges(room.polygon);
    return one.level == room.level && std::any_of(sides.begin(), sides.end(), [&](const building::Segment& side) {
             return distance_m(one.at, side) < 0.05;
           });
  });
  ASSERT_NE(door, house().doors().end());
  GuidedWalker walker(house(), 1, {.start_room = "0.01", .veer_rad = 0.0, .missed_share = 0.0});
  const building::Point way = door->at - room.centre;
  const double bearing = std::atan2(way.x_m, way.y_m) + house().reference().heading_rad;
  hmi::Instruction on, through;
  on.set_number(1), on.set_kind(hmi::Instruction::START);
  const auto hour_to = [&](double rad) {
    const int hour = static_cast<int>(std::lround((rad - walker.truth().heading_rad) / (kTurn / 12.0)));
    return static_cast<hmi::NextTurn::TypeOfTurn>(((hour % 12) + 11) % 12 + 1);
  };
  on.set_hour(hour_to(bearing));
  walker.hear(on);
  const auto to_door_m = [&] { return distance_m(door->at, building::Point{walker.truth().x_m, walker.truth().y_m}); };
  int t = 0;
  while (to_door_m() >= 1.5 && t < 8000) walker.advance(milliseconds(t += 50));
  hmi::Instruction stop;
  stop.set_number(2), stop.set_kind(hmi::Instruction::LOST);
  walker.hear(stop);
  walker.advance(milliseconds(t += 2500));
  ASSERT_LT(to_door_m(), 1.0) << "they stand at it";
  const building::Point out = door->normal * (dot(way, door->normal) < 0.0 ? -1.0 : 1.0);
  const double through_rad = std::atan2(out.x_m, out.y_m) + house().reference().heading_rad;
  through.set_number(3), through.set_kind(hmi::Instruction::DOOR), through.set_hour(hour_to(through_rad));
  through.set_distance(to_door_m());
  walker.hear(through);
  for (const int end = t + 5500; t <= end; t += 50) {
    walker.advance(milliseconds(t));
    ASSERT_LT(std::abs(std::remainder(walker.truth().heading_rad - through_rad, kTurn)), 1.75) << t;
  }
  EXPECT_FALSE(building::contains(room.polygon, {walker.truth().x_m, walker.truth().y_m}));
}

TEST(GuidedWalker, NobodyWalksSidewardsAlongAWall) {
  for (int hour = 1; hour <= 12; ++hour) {
    GuidedWalker walker(house(), 1, {.start_room = "0.01", .veer_rad = 0.0, .missed_share = 0.0});
    hmi::Instruction on;
    on.set_number(1), on.set_kind(hmi::Instruction::START);
    on.set_hour(static_cast<hmi::NextTurn::TypeOfTurn>(hour));
    walker.hear(on);
    int sidewards = 0, longest = 0;
    for (int t = 50; t <= 8000; t += 50) {
      walker.advance(milliseconds(t));
      const Truth& now = walker.truth();
      const double gets_on_rad = std::atan2(now.velocity_x_mps, now.velocity_y_mps) + house().reference().heading_rad;
      const bool aslant = std::abs(std::remainder(gets_on_rad - now.heading_rad, kTurn)) > 0.3;
      sidewards = now.speed_mps > 0.3 && aslant ? sidewards + 1 : 0;
      longest = std::max(longest, sidewards);
    }
    EXPECT_LE(longest * 50, 1000) << "ms, to hour " << hour;
  }
}

TEST(Random, MatchesTheReferenceOfPcg32) {
  // The first numbers of the demonstration program of the PCG library for seed 42, stream 54.
  Random random{42, 54};
  for (std::uint32_t expected : {0xa15c02b7u, 0x7b47f409u, 0xba1d3330u, 0x83d2f293u, 0xbfa4784bu, 0xcbed606eu}) {
    EXPECT_EQ(random.next(), expected);
  }
}

TEST(Random, NormalVariatesHaveMeanZeroAndDeviationOne) {
  Random random{1};
  double sum = 0.0, squares = 0.0;
  constexpr int kCount = 100'000;
  for (int i = 0; i < kCount; ++i) {
    const double value = random.normal();
    sum += value, squares += value * value;
  }
  EXPECT_NEAR(sum / kCount, 0.0, 0.02);
  EXPECT_NEAR(squares / kCount, 1.0, 0.02);
}

TEST(SpatialField, IsSmoothWithinItsSizeAndUnrelatedBeyond) {
  double near = 0.0, far = 0.0;
  constexpr int kFields = 400;
  for (int i = 0; i < kFields; ++i) {
    Random random{static_cast<std::uint64_t>(i)};
    const SpatialField field{random, 3.0};
    near += field.at(0, 0, 0) * field.at(0.6, 0, 0) / kFields;
    far += field.at(0, 0, 0) * field.at(30, 0, 0) / kFields;
  }
  EXPECT_NEAR(near, 0.98, 0.15);
  EXPECT_NEAR(far, 0.0, 0.15);
}

TEST(Walker, TheTruthDoesNotDependOnHowOftenItIsAskedFor) {
  Walker often{house(), 3}, seldom{house(), 3};
  for (int t = 0; t <= 300'000; t += 35) often.advance(milliseconds{t});
  often.advance(5 * kMinutes);
  seldom.advance(5 * kMinutes);
  EXPECT_EQ(often.truth().t, seldom.truth().t);
  EXPECT_EQ(often.truth().x_m, seldom.truth().x_m);
  EXPECT_EQ(often.truth().steps, seldom.truth().steps);
  EXPECT_EQ(often.truth().heading_rad, seldom.truth().heading_rad);
}

TEST(Walker, AnotherSeedGoesAnotherWay) {
  Walker one{house(), 1}, two{house(), 2};
  one.advance(kMinutes);
  two.advance(kMinutes);
  EXPECT_NE(one.truth().x_m, two.truth().x_m);
}

TEST(Walker, NeverWalksThroughAWallNorJumps) {
  Walker walker{house(), 5};
  Truth before = walker.truth();
  for (milliseconds t{20}; t <= 20 * kMinutes; t += milliseconds{20}) {
    walker.advance(t);
    const Truth& now = walker.truth();
    ASSERT_LT(std::hypot(now.x_m - before.x_m, now.y_m - before.y_m), 0.03) << t.count();
    ASSERT_LT(std::abs(now.height_m - before.height_m), 0.03) << t.count();
    if (now.level == before.level && now.level == std::round(now.level)) {
      const auto crossed = house().walls_crossed({before.x_m, before.y_m}, {now.x_m, now.y_m}, now.level);
      ASSERT_EQ(crossed.walls, 0) << t.count() << " at " << now.x_m << ", " << now.y_m;
    }
    before = now;
  }
}

TEST(Walker, WalksAtTheSpeedAndCadenceOfItsGait) {
  Walker walker{house(), 5};
  std::vector<double> speeds, cadences;
  for (milliseconds t{20}; t <= 10 * kMinutes; t += milliseconds{20}) {
    walker.advance(t);
    if (walker.truth().cadence_hz == 0.0) continue;
    speeds.push_back(walker.truth().speed_mps);
    cadences.push_back(walker.truth().cadence_hz);
  }
  const auto median = [](std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
    return values[values.size() / 2];
  };
  EXPECT_NEAR(median(speeds), 1.3, 0.05);
  EXPECT_NEAR(median(cadences), 1.8, 0.05);
}

TEST(Walker, TheHeadingPointsWhereThePersonWalks) {
  Walker walker{house(), 8};
  int checked = 0, off = 0;
  for (milliseconds t{20}; t <= 10 * kMinutes; t += milliseconds{20}) {
    walker.advance(t);
    const Truth& now = walker.truth();
    if (now.speed_mps < 1.25) continue;
    const double course = std::atan2(now.velocity_x_mps, now.velocity_y_mps);
    ++checked;
    off += std::abs(std::remainder(course - now.heading_rad, kTurn)) > 0.2;
  }
  EXPECT_GT(checked, 10'000);
  EXPECT_LT(off, checked / 50);
}

TEST(Walker, UsesStairsAndLiftAndClimbsGradually) {
  Walker walker{house(), 4};
  std::set<int> tenths_on_stairs;
  bool rode = false;
  for (milliseconds t{20}; t <= 60 * kMinutes; t += milliseconds{20}) {
    walker.advance(t);
    const Truth& now = walker.truth();
    if (now.cadence_hz > 0.0) tenths_on_stairs.insert(static_cast<int>(now.level * 10));
    rode = rode || (now.cadence_hz == 0.0 && now.velocity_up_mps != 0.0);
    ASSERT_NEAR(now.height_m, house().height_m(now.level), 1e-9);
  }
  EXPECT_EQ(tenths_on_stairs.size(), 11u);
  EXPECT_TRUE(rode);
}

TEST(Walker, KeepsToItsLevels) {
  Walker::Options options;
  options.levels = {1.0};
  options.routes = {.stairs = false, .lift = false};
  Walker walker{house(), 4, options};
  for (milliseconds t{100}; t <= 10 * kMinutes; t += milliseconds{100}) {
    walker.advance(t);
    ASSERT_EQ(walker.truth().level, 1.0);
  }
}

TEST(Walker, ABuildingWithoutDoorsIsRefusedWithTheNextStep) {
  const Building cell = Building::parse(
      "<osm version='0.6'><node id='1' lat='48' lon='10'/><node id='2' lat='48' lon='10.0001'/>"
      "<node id='3' lat='48.0001' lon='10.0001'/><way id='4'><nd ref='1'/><nd ref='2'/><nd ref='3'/><nd "
      "ref='1'/>"
      "<tag k='indoor' v='room'/><tag k='level' v='0'/><tag k='name' v='Cell'/></way></osm>",
      "cell.osm");
  try {
    Walker{cell, 1};
    FAIL() << "no error";
  } catch (const Error& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("nobody can walk in cell: no way leads from Cell to another room"), std::string::npos) << text;
    EXPECT_NE(text.find("draw the doors"), std::string::npos) << text;
  }
}

/// R. D. Peters, "Ideal lift kinematics": one that carries people, over a storey and over six.
TEST(LiftRide, StartsAndStopsAsLiftsDo) {
  for (const double rise_m : {3.3, -3.3, 20.0, 2.5}) {
    const LiftRide lift(rise_m);
    double before_m = 0.0, before_mps = 0.0, before_mps2 = 0.0, most_mps = 0.0, most_mps2 = 0.0, most_mps3 = 0.0;
    for (double t_s = 0.01; t_s < lift.duration_s() + 1.0; t_s += 0.01) {
      const double mps = (lift.risen_m(t_s) - before_m) / 0.01, mps2 = (mps - before_mps) / 0.01;
      most_mps = std::max(most_mps, std::abs(mps));
      most_mps2 = std::max(most_mps2, std::abs(mps2));
      most_mps3 = std::max(most_mps3, std::abs(mps2 - before_mps2) / 0.01);
      before_m = lift.risen_m(t_s), before_mps = mps, before_mps2 = mps2;
    }
    EXPECT_EQ(lift.risen_m(-1.0), 0.0);
    EXPECT_NEAR(before_m, rise_m, 1e-9);
    EXPECT_NEAR(before_mps, 0.0, 1e-9);
    EXPECT_LE(most_mps2, 0.81) << rise_m;
    EXPECT_LE(most_mps3, 1.05) << rise_m;
    EXPECT_NEAR(most_mps, building::kLiftPace_mps, 1e-6) << rise_m;
  }
  EXPECT_EQ(LiftRide(0.0).risen_m(1.0), 0.0);
}

TEST(ImuModel, AtRestThePhoneFeelsOneG) {
  ImuModel imu{1};
  double sum = 0.0;
  for (int i = 0; i < 500; ++i) {
    const auto a = imu.sample(standing(30, 17, 0)).acceleration_g;
    sum += std::hypot(a[0], a[1], a[2]) / 500;
  }
  EXPECT_NEAR(sum, 1.0, 0.03);
}

/// Steps by the textbook: peaks of the smoothed magnitude above 1.08 g, at least 300 ms apart.
int peaks(ImuModel& imu, milliseconds until, Truth (*person)(milliseconds)) {
  int count = 0;
  double smooth = 1.0, before = 1.0, rising = 0.0;
  milliseconds last{-1000};
  for (milliseconds t{0}; t < until; t += ImuModel::kPeriod) {
    const auto a = imu.sample(person(t)).acceleration_g;
    before = smooth;
    smooth += 0.35 * (std::hypot(a[0], a[1], a[2]) - smooth);
    if (smooth < before && rising > 0.0 && before > 1.08 && t - last > milliseconds{300}) ++count, last = t;
    rising = smooth - before;
  }
  return count;
}

TEST(ImuModel, APlainPeakDetectorCountsTheStepsOfTheGait) {
  ImuModel imu{2};
  EXPECT_NEAR(peaks(imu, kMinutes, walking), 108, 2);
}

TEST(ImuModel, APlainPeakDetectorCountsNothingWhileStanding) {
  ImuModel imu{2};
  EXPECT_EQ(peaks(imu, kMinutes,
                  [](milliseconds t) {
                    Truth truth = standing(30, 17, 0);
                    truth.t = t;
                    return truth;
                  }),
            0);
}

TEST(ImuModel, ATurnToTheRightIsNegativeAboutZAndAddsUpToItsAngle) {
  ImuOptions still;
  still.rotation_bias_deg_s = 0.0;
  still.pitch_deg = still.roll_deg = 0.0;
  ImuModel imu{3, still};
  double turned_deg = 0.0;
  for (int i = 0; i <= 50; ++i) {
    Truth truth = standing(30, 17, 0, i * std::numbers::pi / 100.0);
    truth.t = milliseconds{20 * i};
    turned_deg += imu.sample(truth).rotation_deg_s[2] * 0.02;
  }
  EXPECT_NEAR(turned_deg, -90.0, 1.0);
}

TEST(ImuModel, TheCompassPointsToMagneticNorth) {
  ImuOptions clean;
  clean.anomaly_gauss = clean.magnetic_bias_gauss = clean.magnetic_noise_gauss = 0.0;
  clean.pitch_deg = clean.roll_deg = 0.0;
  clean.declination_deg = 15.0;
  ImuModel imu{3, clean};
  // Facing true east: magnetic north lies 75 degrees to the left.
  const auto m = imu.sample(standing(30, 17, 0, std::numbers::pi / 2)).magnetic_gauss;
  EXPECT_NEAR(std::atan2(-m[0], m[1]) * 180.0 / std::numbers::pi, 75.0, 1e-6);
  EXPECT_NEAR(std::atan2(-m[2], std::hypot(m[0], m[1])) * 180.0 / std::numbers::pi, clean.dip_deg, 1e-6);
  EXPECT_NEAR(std::hypot(m[0], m[1], m[2]), clean.field_gauss, 1e-9);
}

TEST(ImuModel, AnomaliesBelongToThePlaceAndNotToTheRun) {
  ImuOptions clean;
  clean.magnetic_bias_gauss = clean.magnetic_noise_gauss = 0.0;
  ImuModel one{3, clean, 1}, two{3, clean, 2};
  const auto there = one.sample(standing(20, 9, 0)).magnetic_gauss;
  EXPECT_EQ(there, two.sample(standing(20, 9, 0)).magnetic_gauss);
  EXPECT_NE(there, one.sample(standing(40, 9, 0)).magnetic_gauss);
}

TEST(RadioModel, EveryTransmitterOfTheFileIsThere) {
  const RadioModel radio{house(), 1};
  EXPECT_EQ(radio.transmitters(), house().landmarks().size());
}

TEST(RadioModel, PowerFallsWithDistanceWallsAndFloors) {
  RadioOptions clean;
  clean.shadowing_db = 0.0;
  const RadioModel radio{house(), 1, clean};
  std::size_t lobby = 0;
  while (radio.name(lobby) != "02:f1:0a:00:00:06") ++lobby;  // stands at (30, 17.5) on level 0
  const double near = radio.mean_rssi_dbm(lobby, standing(30, 16, 0));
  const double far = radio.mean_rssi_dbm(lobby, standing(30, 11.5, 0));
  const double behind_a_wall =
      radio.mean_rssi_dbm(lobby, standing(36, 17.5, 0)) - radio.mean_rssi_dbm(lobby, standing(39.5, 18, 0));
  const double above = radio.mean_rssi_dbm(lobby, standing(30, 16, 1));
  EXPECT_NEAR(near - far, 21.0 * std::log10(std::hypot(6.0, 1.5) / std::hypot(1.5, 1.5)), 0.1);
  EXPECT_GT(behind_a_wall, 8.0);
  EXPECT_GT(near - above, 15.0);
}

TEST(RadioModel, ShadowsAreConstantInPlace) {
  const RadioModel one{house(), 9, {}, 1}, two{house(), 9, {}, 2}, other{house(), 10, {}, 1};
  const Truth here = standing(20, 9, 0);
  EXPECT_EQ(one.mean_rssi_dbm(3, here), two.mean_rssi_dbm(3, here));
  EXPECT_NE(one.mean_rssi_dbm(3, here), other.mean_rssi_dbm(3, here));
}

TEST(RadioModel, ScansComeEveryTwoSecondsAndRowsTellWhenTheyWereHeard) {
  RadioModel radio{house(), 1};
  std::vector<WifiScan> scans;
  bool stale = false;
  for (milliseconds t{0}; t <= kMinutes; t += milliseconds{20}) {
    Truth truth = standing(30, 9, 0);
    truth.t = t;
    for (const WifiScan& scan : radio.advance(truth).scans) scans.push_back(scan);
  }
  ASSERT_EQ(scans.size(), 30u);
  for (std::size_t i = 0; i < scans.size(); ++i) {
    EXPECT_EQ(scans[i].t, milliseconds{2000} * static_cast<int>(i + 1));
    EXPECT_GE(scans[i].readings.size(), 3u);
    for (const WifiReading& reading : scans[i].readings) {
      EXPECT_LE(reading.heard, scans[i].t);
      EXPECT_LE(scans[i].t - reading.heard, RadioOptions{}.stale_age);
      stale = stale || scans[i].t - reading.heard > milliseconds{2000};
    }
  }
  EXPECT_TRUE(stale);
}

TEST(RadioModel, TheNearestBeaconIsHeardSeveralTimesASecondAtAboutItsDistance) {
  RadioModel radio{house(), 1};
  std::vector<double> distances;
  for (milliseconds t{0}; t <= kMinutes; t += milliseconds{20}) {
    Truth truth = standing(24, 8.6, 0);  // beacon 2 stands at (24, 9.2), 1 m above the phone
    truth.t = t;
    for (const BeaconBatch& batch : radio.advance(truth).batches) {
      for (const BeaconReading& reading : batch.readings) {
        if (reading.minor == 2) distances.push_back(reading.distance_m);
      }
    }
  }
  ASSERT_GT(distances.size(), 200u);
  std::sort(distances.begin(), distances.end());
  EXPECT_GT(distances[distances.size() / 2], 0.4);
  EXPECT_LT(distances[distances.size() / 2], 3.5);
}

TEST(RadioModel, BeaconDistanceFollowsThePathLossFormula) {
  EXPECT_DOUBLE_EQ(beacon_distance_m(-59, -59), 1.0);
  EXPECT_DOUBLE_EQ(beacon_distance_m(-59, -79), 10.0);
}

TEST(RadioModel, ABeaconThatCannotBeReadIsNamed) {
  const Building hall = Building::parse(
      "<osm version='0.6'><node id='1' lat='48' lon='10'/><node id='2' lat='48' lon='10.0001'/>"
      "<node id='3' lat='48.0001' lon='10.0001'><tag k='level' v='0'/><tag k='fiona:beacon' "
      "v='abc/1'/></node>"
      "<way id='4'><nd ref='1'/><nd ref='2'/><nd ref='3'/><nd ref='1'/><tag k='indoor' v='area'/>"
      "<tag k='level' v='0'/></way></osm>",
      "hall.osm");
  try {
    RadioModel{hall, 1};
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().where, "node 3");
    EXPECT_EQ(error.text().expected, "UUID/MAJOR/MINOR, the numbers from 0 to 65535");
    EXPECT_EQ(error.text().found, "fiona:beacon=abc/1");
  }
}

SurveyOptions quick() {
  SurveyOptions options;
  options.spacing_m = 6.0;
  options.inertial_walks = 1;
  options.test_walks = 1;
  options.test_duration = milliseconds{10'000};
  return options;
}

TEST(Survey, TheWalkComesNearEveryRoomOfTheLevel) {
  const auto traces = survey_walk(house(), 0, 1, quick());
  for (const building::Room& room : house().rooms()) {
    if (room.level != 0.0 || room.kind == building::RoomKind::Lift) continue;
    const bool visited = std::any_of(traces.begin(), traces.end(), [&](const Trace& trace) {
      return std::any_of(trace.waypoints.begin(), trace.waypoints.end(), [&](const Truth& p) {
        return contains(room.polygon, {p.x_m, p.y_m});
      });
    });
    EXPECT_TRUE(visited) << room.name;
  }
}

TEST(Survey, WalksAreStraightBetweenWaypoints) {
  for (const Trace& trace : survey_walk(house(), 1, 1, quick())) {
    for (std::size_t i = 1; i < trace.waypoints.size(); ++i) {
      const Truth &a = trace.waypoints[i - 1], &b = trace.waypoints[i];
      ASSERT_LE(a.t, b.t);
      ASSERT_EQ(house().walls_crossed({a.x_m, a.y_m}, {b.x_m, b.y_m}, 1.0).walls, 0) << trace.id << " " << b.t.count();
    }
  }
}

TEST(Survey, ALevelWithoutRoomsIsRefused) {
  try {
    survey_walk(house(), 7, 1, quick());
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_NE(std::string(error.what()).find("level 7 of Blautal House cannot be surveyed: it has no room"),
              std::string::npos);
  }
}

std::string content(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

TEST(Survey, TheDirectoryHasTheLayoutOfTheDataSetAndTheSameSeedGivesTheSameBytes) {
  const tests::TemporaryDirectory folder;
  const auto one = folder.path / "one", two = folder.path / "two";
  const SurveyReport report = write_survey(house(), 5, one, quick());
  write_survey(house(), 5, two, quick());
  EXPECT_EQ(report.levels, 2u);
  for (const char* file : {"F1/train.tar.xz", "F1/floor_info.json", "F2/train.tar.xz", "test.tar.xz", "test_truth.csv",
                           "traces.csv", "README.md"}) {
    EXPECT_FALSE(content(one / file).empty()) << file;
    EXPECT_EQ(content(one / file), content(two / file)) << file;
  }
  EXPECT_EQ(content(one / "test_truth.csv").substr(0, 21), "trace,t_ms,x,y,floor\n");
}

TEST(Survey, ADirectoryThatIsNotEmptyIsLeftAlone) {
  const tests::TemporaryDirectory folder;
  const auto directory = folder.path / "filled";
  std::filesystem::create_directories(directory / "mine");
  try {
    write_survey(house(), 5, directory, quick());
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("it is not empty"), std::string::npos);
  }
  EXPECT_FALSE(std::filesystem::exists(directory / "F1"));
}

}  // namespace
}  // namespace fiona::simulator
