#include <cmath>
#include <filesystem>
#include <numbers>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/objects/imu.hpp"
#include "fiona/simulator/building_simulator.hpp"
#include "fiona/testing/bench.hpp"

namespace fiona::simulator {
namespace {

using localisation::LocationProvider;
using sensors::GetIMU;
using sensors::GetIMUService;
using sensors::IbeaconlistProvider;
using sensors::PhoneAxes;
using sensors::RFSignalRSSIService;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

std::filesystem::path package() { return std::filesystem::path(FIONA_BUILDING_FILE).parent_path(); }

struct Simulation : testing::Bench<BuildingSimulator> {
  Simulation() : Bench("sim", package()) {}
};

template <class F>
Error error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error;
  }
  ADD_FAILURE() << "nothing was refused";
  return {ErrorCode::Failed, "nothing was refused"};
}

template <class S>
std::string bytes_from(Simulation& simulation, std::string_view port) {
  std::string all;
  for (const auto& message : simulation.take<S>(port)) {
    all += std::to_string(message.origin.time_since_epoch().count()) + " " + message->SerializeAsString();
  }
  return all;
}

std::string all_bytes(Simulation& simulation) {
  return bytes_from<GetIMUService>(simulation, "imu") + bytes_from<RFSignalRSSIService>(simulation, "wifi") +
         bytes_from<IbeaconlistProvider>(simulation, "beacons") + bytes_from<LocationProvider>(simulation, "truth");
}

std::string bytes_of_walk(int walk) {
  Simulation simulation;
  simulation.set("walk", walk);
  simulation.start();
  simulation.advance(10s);
  return all_bytes(simulation);
}

TEST(ImuAxes, AMessageIsAQuarterTurnAwayFromThePhone) {
  const GetIMU imu = sensors::from_phone_axes({.acceleration_g = PhoneAxes::Vector{1, 2, 3}});
  EXPECT_EQ(imu.out_x_ac(), 2);
  EXPECT_EQ(imu.out_y_ac(), -1);
  EXPECT_EQ(imu.out_z_ac(), 3);
}

TEST(ImuAxes, RatesOfTurnGoToRollPitchYawInThisOrder) {
  const GetIMU imu = sensors::from_phone_axes({.rotation_deg_s = PhoneAxes::Vector{1, 2, 3}});
  EXPECT_EQ(imu.roll_g(), 2);
  EXPECT_EQ(imu.pitch_g(), -1);
  EXPECT_EQ(imu.yaw_g(), 3);
}

TEST(ImuAxes, BackInThePhoneNothingHasChanged) {
  const PhoneAxes phone{.acceleration_g = PhoneAxes::Vector{1, 2, 3},
                        .rotation_deg_s = PhoneAxes::Vector{4, 5, 6},
                        .magnetic_gauss = PhoneAxes::Vector{7, 8, 9}};
  EXPECT_EQ(sensors::to_phone_axes(sensors::from_phone_axes(phone)), phone);
}

TEST(ImuAxes, ASensorThatLacksAComponentIsAbsent) {
  GetIMU imu = sensors::from_phone_axes({.magnetic_gauss = PhoneAxes::Vector{7, 8, 9}});
  imu.clear_out_y_m();
  EXPECT_EQ(sensors::to_phone_axes(imu), PhoneAxes{});
}

TEST(BuildingSimulator, TheImuIsReadFiftyTimesASecond) {
  Simulation simulation;
  simulation.start();
  simulation.advance(2s);
  EXPECT_EQ(simulation.take<GetIMUService>("imu").size(), 100u);
}

TEST(BuildingSimulator, TheSameParametersGiveTheSameMessages) { EXPECT_EQ(bytes_of_walk(3), bytes_of_walk(3)); }

TEST(BuildingSimulator, AnotherWalkGivesOtherMessages) { EXPECT_NE(bytes_of_walk(3), bytes_of_walk(4)); }

TEST(BuildingSimulator, ARaisedTopEdgeIsFeltAlongTheAxisThatPointsAhead) {
  Simulation simulation;
  simulation.start();
  simulation.advance(30s);
  double x_g = 0, y_g = 0, z_g = 0;
  const auto readings = simulation.take<GetIMUService>("imu");
  for (const auto& imu : readings) x_g += imu->out_x_ac(), y_g += imu->out_y_ac(), z_g += imu->out_z_ac();
  const auto count = static_cast<double>(readings.size());
  EXPECT_NEAR(x_g / count, std::sin(8.0 * std::numbers::pi / 180.0), 0.04);
  EXPECT_NEAR(y_g / count, -std::sin(2.0 * std::numbers::pi / 180.0), 0.04);
  EXPECT_NEAR(z_g / count, 0.99, 0.04);
}

TEST(BuildingSimulator, EveryWifiRowIsDatedWhenItWasHeard) {
  Simulation simulation;
  simulation.start();
  simulation.advance(20s);
  const auto rows = simulation.take<RFSignalRSSIService>("wifi");
  ASSERT_GT(rows.size(), 20u);
  for (const auto& row : rows) EXPECT_EQ(row->t(), to_milliseconds(row.origin));
}

TEST(BuildingSimulator, SomeWifiRowsAreOlderThanTheirScan) {
  Simulation simulation;
  simulation.start();
  simulation.advance(20s - 1ms);
  simulation.take<RFSignalRSSIService>("wifi");
  simulation.advance(20ms);
  int stale = 0;
  for (const auto& row : simulation.take<RFSignalRSSIService>("wifi")) stale += simulation.now() - row.origin > 2s;
  EXPECT_GT(stale, 0);
}

TEST(BuildingSimulator, ABeaconStandsOnceInAListStrongestFirst) {
  Simulation simulation;
  simulation.start();
  simulation.advance(3s);
  const auto lists = simulation.take<IbeaconlistProvider>("beacons");
  ASSERT_EQ(lists.size(), 10u);
  for (const auto& list : lists) {
    ASSERT_GT(list->beacon_list_size(), 0);
    std::set<std::uint32_t> minors;
    int before_dbm = 20;
    for (const auto& beacon : list->beacon_list()) {
      EXPECT_TRUE(minors.insert(beacon.major() << 16u | beacon.minor()).second);
      EXPECT_LE(beacon.rssi(), before_dbm);
      before_dbm = beacon.rssi();
    }
  }
}

TEST(BuildingSimulator, TheTruthWalksNoFasterThanThePerson) {
  Simulation simulation;
  simulation.set("speed_mps", 1.0);
  simulation.start();
  simulation.advance(60s);
  const auto truth = simulation.take<LocationProvider>("truth");
  ASSERT_EQ(truth.size(), 300u);
  double way_m = 0;
  for (std::size_t i = 1; i < truth.size(); ++i) {
    const auto& from = truth[i - 1]->position();
    const auto& to = truth[i]->position();
    const double step_m = std::hypot(to.x() - from.x(), to.y() - from.y());
    EXPECT_LE(step_m, 0.2 + 1e-9);
    way_m += step_m;
  }
  EXPECT_GT(way_m, 20.0);
}

TEST(BuildingSimulator, TheYawOfTheTruthIsTheCourseFromMagneticNorth) {
  Simulation simulation;
  simulation.start();
  simulation.advance(60s);
  const auto truth = simulation.take<LocationProvider>("truth");
  int compared = 0;
  int right = 0;
  for (std::size_t i = 1; i < truth.size(); ++i) {
    const auto& from = truth[i - 1]->position();
    const auto& to = truth[i]->position();
    if (std::hypot(to.x() - from.x(), to.y() - from.y()) < 0.2) continue;
    const double course_from_east = std::atan2(to.y() - from.y(), to.x() - from.x());
    const double declination = ImuOptions{}.declination_deg * std::numbers::pi / 180.0;
    const double expected_yaw = course_from_east - std::numbers::pi / 2 + declination;
    const double off = std::remainder(truth[i]->orientation().yaw() - expected_yaw, 2 * std::numbers::pi);
    ++compared;
    right += std::abs(off) < 0.1;
  }
  ASSERT_GT(compared, 50);
  EXPECT_GT(right, 0.8 * compared);
}

TEST(BuildingSimulator, TheRunEndsWithTheWalk) {
  Simulation simulation;
  simulation.set("duration_s", 1);
  simulation.start();
  simulation.advance(3s);
  ASSERT_TRUE(simulation.run_end());
  EXPECT_EQ(*simulation.run_end(), std::pair(0, std::string("the walk of 1 s is over")));
}

TEST(BuildingSimulator, NothingIsSaidAfterTheWalk) {
  Simulation simulation;
  simulation.set("duration_s", 1);
  simulation.start();
  simulation.advance(3s);
  EXPECT_EQ(simulation.take<GetIMUService>("imu").size(), 50u);
  EXPECT_EQ(simulation.take<LocationProvider>("truth").size(), 5u);
}

TEST(BuildingSimulator, ThePersonStandsStillInNeutral) {
  Simulation simulation;
  simulation.start();
  simulation.advance(20s);
  const auto before = simulation.take<LocationProvider>("truth").back();
  simulation.start("neutral");
  simulation.advance(60s);
  simulation.start();
  simulation.advance(200ms);
  const auto after = simulation.take<LocationProvider>("truth");
  ASSERT_EQ(after.size(), 1u);
  EXPECT_EQ(after[0].origin, simulation.now());
  EXPECT_LE(
      std::hypot(after[0]->position().x() - before->position().x(), after[0]->position().y() - before->position().y()),
      0.3);
}

TEST(BuildingSimulator, NoWifiRowIsOlderThanThePauseBeforeIt) {
  Simulation simulation;
  simulation.start();
  simulation.advance(19s);
  simulation.start("neutral");
  simulation.advance(60s);
  const TimePoint resumed = simulation.now();
  simulation.take<RFSignalRSSIService>("wifi");
  simulation.start();
  simulation.advance(4s);
  const auto rows = simulation.take<RFSignalRSSIService>("wifi");
  ASSERT_FALSE(rows.empty());
  for (const auto& row : rows) EXPECT_GE(row.origin, resumed);
}

TEST(BuildingSimulator, AMissingBuildingFileFailsTheInstanceWithItsName) {
  Simulation simulation;
  simulation.set("building", "no/such/house.osm");
  EXPECT_EQ(error_of([&] { simulation.start(); }).code(), ErrorCode::ComponentFailed);
  EXPECT_EQ(simulation.mode(), "failed");
  EXPECT_THAT(simulation.reason(), HasSubstr("cannot read the building file no/such/house.osm: there is no such file"));
}

TEST(BuildingSimulator, APackageWithoutItsHouseIsTold) {
  testing::Bench<BuildingSimulator> bench("sim");
  error_of([&] { bench.start(); });
  EXPECT_THAT(bench.reason(), HasSubstr("the package of 'sim' has no file 'building.osm'"));
}

TEST(BuildingSimulator, AMistypedStartRoomIsToldWithTheNearestNames) {
  Simulation simulation;
  simulation.set("start_room", "Libary");
  const auto error = error_of([&] { simulation.start(); });
  EXPECT_THAT(error.what(), HasSubstr("did you mean: Library"));
  EXPECT_THAT(simulation.reason(), HasSubstr("there is no room Libary"));
}

TEST(BuildingSimulator, ASpeedThatNobodyWalksIsRefused) {
  Simulation simulation;
  EXPECT_EQ(error_of([&] { simulation.set("speed_mps", 9.0); }).text().what, "refused: speed_mps is 9, above 2.5 m/s");
}

TEST(BuildingSimulator, AWalkThatHasBegunKeepsItsWorld) {
  Simulation simulation;
  simulation.start();
  EXPECT_STREQ(error_of([&] { simulation.set("seed", 7); }).what(),
               "sim: the walk has begun: only duration_s can still be changed\n"
               "  next: unload sim, then load it with the new parameters");
}

TEST(BuildingSimulator, ItsEndCanBeMovedWhileItWalks) {
  Simulation simulation;
  simulation.start();
  simulation.advance(1s);
  simulation.set("duration_s", 2);
  simulation.advance(2s);
  EXPECT_TRUE(simulation.run_end());
}

TEST(BuildingSimulator, ABareNameIsThatOfABuildingOfThePackage) {
  Simulation simulation;
  simulation.set("building", "institute.osm");
  simulation.start();
  EXPECT_THAT(simulation.log().front(), HasSubstr("3 levels"));
}

TEST(BuildingSimulator, BeaconsHaveTheirAddressAsTheServiceSays) {
  Simulation simulation;
  simulation.start();
  simulation.advance(5s);
  std::size_t beacons = 0;
  for (const auto& list : simulation.take<IbeaconlistProvider>("beacons")) {
    for (const auto& beacon : list->beacon_list()) {
      ++beacons;
      EXPECT_THAT(beacon.address(), ::testing::MatchesRegex("[0-9a-f]{2}(:[0-9a-f]{2}){5}"));
    }
  }
  EXPECT_GT(beacons, 0U);
}

}  // namespace
}  // namespace fiona::simulator
