// The components of a recorded walk on the bench: what they put, and what they refuse.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>

#include "../error_of.hpp"
#include "../temporary_directory.hpp"
#include "fiona/objects/imu.hpp"
#include "fiona/testing/bench.hpp"
#include "radio_localisation.hpp"
#include "radio_map_file.hpp"
#include "step_heading.hpp"
#include "trace_player.hpp"
#include "walk_archive.hpp"

namespace fiona {
namespace {

using tests::error_of;

using namespace std::chrono_literals;
using radio_localisation::RadioLocalisation;
using step_heading::StepHeading;
using testing::Bench;
using trace_player::TracePlayer;

/// Walking east with two steps a second, the phone held flat, its top edge ahead.
sensors::GetIMU gait(double t_s) {
  const double swing_g = 0.25 * std::sin(2 * std::numbers::pi * 2.0 * t_s);
  return sensors::from_phone_axes({.acceleration_g = sensors::PhoneAxes::Vector{0, 0, 1 + swing_g},
                                   .rotation_deg_s = sensors::PhoneAxes::Vector{0, 0, 0},
                                   .magnetic_gauss = sensors::PhoneAxes::Vector{-0.2, 0, -0.42}});
}

TEST(StepHeadingComponent, TwoStepsASecondEastward) {
  Bench<StepHeading> bench;
  bench.start();
  for (int i = 0; i < 500; ++i) {
    bench.put<sensors::GetIMUService>("imu", gait(0.02 * i));
    bench.advance(20ms);
  }
  const auto steps = bench.take<localisation::StepProvider>("steps");
  EXPECT_NEAR(static_cast<double>(steps.size()), 20.0, 2.0);
  ASSERT_FALSE(steps.empty());
  EXPECT_NEAR(steps.back()->heading(), 0.0, 0.1) << "counter-clockwise from east";
  EXPECT_GT(steps.back()->length(), 0.3);
  EXPECT_TRUE(steps.back()->is_valid());
}

TEST(StepHeadingComponent, DeclinationTurnsTheHeadingClockwise) {
  Bench<StepHeading> bench;
  bench.set("declination", 10.0);
  bench.start();
  for (int i = 0; i < 500; ++i) {
    bench.put<sensors::GetIMUService>("imu", gait(0.02 * i));
    bench.advance(20ms);
  }
  const auto steps = bench.take<localisation::StepProvider>("steps");
  ASSERT_FALSE(steps.empty());
  EXPECT_NEAR(steps.back()->heading(), -10.0 * std::numbers::pi / 180, 0.1);
}

TEST(StepHeadingComponent, TheMapsPlaceTellsTheDeclination) {
  Bench<StepHeading> bench;
  bench.set("declination", -100.0);  // is not asked where a map is
  navigation::CommLevelMap seattle;
  seattle.mutable_reference()->set_reference_lat(47.6);
  seattle.mutable_reference()->set_reference_long(-122.3);
  bench.answer_with<navigation::LevelMap>("levels", [&](const auto&) { return seattle; });
  bench.start();
  bench.advance(1s);
  for (int i = 0; i < 500; ++i) {
    bench.put<sensors::GetIMUService>("imu", gait(0.02 * i));
    bench.advance(20ms);
  }
  const auto steps = bench.take<localisation::StepProvider>("steps");
  ASSERT_FALSE(steps.empty());
  EXPECT_NEAR(steps.back()->heading(), -15.0 * std::numbers::pi / 180, 0.05);
}

TEST(StepHeadingComponent, TheOrientationIsThatOfTheDeviceAgainstMagneticNorth) {
  Bench<StepHeading> bench;
  bench.set("declination", 10.0);
  bench.start();
  for (int i = 0; i < 100; ++i) {
    bench.put<sensors::GetIMUService>("imu", gait(0.02 * i));
    bench.advance(20ms);
  }
  const auto all = bench.take<localisation::OrientationProvider>("orientation");
  ASSERT_FALSE(all.empty());
  EXPECT_TRUE(all.back()->is_valid());
  EXPECT_NEAR(all.back()->yaw(), 1.5 * std::numbers::pi, 0.1) << "east: counter-clockwise from magnetic north";
  EXPECT_NEAR(std::sin(all.back()->pitch()), 0.0, 0.05);
  EXPECT_EQ(all.back()->confidence_size(), 9);
}

TEST(StepHeadingComponent, WhoMeasuresNothingHasNoValidOrientation) {
  Bench<StepHeading> bench;
  bench.start();
  for (int i = 0; i < 100; ++i) {
    bench.put<sensors::GetIMUService>("imu", gait(0.02 * i));
    bench.advance(20ms);
  }
  bench.advance(1s);
  EXPECT_FALSE(bench.take<localisation::OrientationProvider>("orientation").back()->is_valid());
}

TEST(StepHeadingComponent, ASampleWithoutMagnetometerIsLeftOut) {
  Bench<StepHeading> bench;
  bench.start();
  for (int i = 0; i < 100; ++i) {
    auto imu = gait(0.02 * i);
    imu.clear_out_x_m();
    bench.put<sensors::GetIMUService>("imu", imu);
    bench.advance(20ms);
  }
  EXPECT_TRUE(bench.take<localisation::StepProvider>("steps").empty());
  EXPECT_EQ(bench.mode(), "active");
}

/// Walks for so many samples of 20 ms, whether or not the magnetometer reads anything.
void walk_for(Bench<StepHeading>& bench, int samples, bool magnetometer) {
  for (int i = 0; i < samples; ++i) {
    auto imu = gait(0.02 * i);
    if (!magnetometer) imu.set_out_x_m(0), imu.set_out_y_m(0), imu.set_out_z_m(0);
    bench.put<sensors::GetIMUService>("imu", imu);
    bench.advance(20ms);
  }
}

long no_heading_told(const Bench<StepHeading>& bench) {
  const auto log = bench.log();
  return std::count_if(log.begin(), log.end(),
                       [](const auto& line) { return line.find("no steps can be told") != std::string::npos; });
}

TEST(StepHeadingComponent, WhoseMagnetometerReadsNothingIsSilentAndSaysSoOnce) {
  Bench<StepHeading> bench;
  bench.start();
  walk_for(bench, 500, false);
  EXPECT_TRUE(bench.take<localisation::StepProvider>("steps").empty());
  EXPECT_TRUE(bench.take_silence("steps")) << "nobody may take the person for one who stands";
  EXPECT_EQ(no_heading_told(bench), 1);
}

TEST(StepHeadingComponent, AMagnetometerThatReadsNothingAfterAPauseLeavesNoOldHeading) {
  Bench<StepHeading> bench;
  bench.start();
  walk_for(bench, 500, true);
  EXPECT_FALSE(bench.take<localisation::StepProvider>("steps").empty());
  bench.advance(3s);
  walk_for(bench, 500, false);
  EXPECT_TRUE(bench.take<localisation::StepProvider>("steps").empty());
  EXPECT_EQ(no_heading_told(bench), 1);
}

TEST(StepHeadingComponent, AHeadingThatWasKnownMeanwhileIsNotMissingSinceBefore) {
  Bench<StepHeading> bench;
  bench.start();
  walk_for(bench, 50, false);
  walk_for(bench, 250, true);
  bench.advance(2s);
  walk_for(bench, 50, false);
  EXPECT_EQ(no_heading_told(bench), 0);
}

TEST(RadioLocalisationComponent, WithoutAMapItRefusesToStartAndSaysHowToMakeOne) {
  Bench<RadioLocalisation> bench("radio");
  const std::string error = error_of([&] { bench.start(); });
  EXPECT_NE(error.find("no radio map is named"), std::string::npos) << error;
  EXPECT_NE(error.find("fiona-radiomap learn FOLDER -o FILE"), std::string::npos) << error;
  EXPECT_EQ(bench.mode(), "failed");
}

TEST(RadioLocalisationComponent, AMapThatIsMissingIsNamed) {
  Bench<RadioLocalisation> bench("radio");
  bench.set("map", "nowhere.radiomap");
  EXPECT_NE(error_of([&] { bench.start(); }).find("nowhere.radiomap"), std::string::npos);
}

TEST(RadioLocalisationComponent, ParticlesOutsideTheirRangeChangeNothing) {
  Bench<RadioLocalisation> bench("radio");
  const std::string error = error_of([&] { bench.set("particles", 5); });
  EXPECT_NE(error.find("particles is 5, below 100"), std::string::npos) << error;
  EXPECT_EQ(bench.hull().parameters()->status().at(1).value(), "1500");
}

TEST(TracePlayerComponent, WithoutARecordingItRefusesToStart) {
  Bench<TracePlayer> bench("walk");
  const std::string error = error_of([&] { bench.start(); });
  EXPECT_NE(error.find("no recording is named"), std::string::npos) << error;
  EXPECT_NE(error.find("load trace-player as walk dataset=FOLDER trace=NAME"), std::string::npos) << error;
}

/// A recording of two short walks, whose addresses are written in two ways.
class ShortWalks : public ::testing::Test {
 protected:
  ShortWalks() {
    tests::write_archive(folder_.path / "test.tar.xz", {{"one.tsv",
                                                         "# trace=one\nB\t100\tab\t1\t2\t-56\t-90\tE078A33DB5B4\n"
                                                         "B\t100\tab\t1\t3\t-56\t-91\te0:78:a3:3d:b5:b5\n"
                                                         "B\t100\tab\t1\t4\t-56\t-92\tmall-7\n"
                                                         "W\t200\tAA0000000001\t-60\t2437\n"},
                                                        {"two.tsv", "# trace=two\nA\t0\t0\t0\t9.8\n"}});
    bench_.set("dataset", folder_.path.string());
    bench_.set("at_end", "HOLD");
    bench_.start();
  }
  tests::TemporaryDirectory folder_;
  Bench<TracePlayer> bench_{"walk"};
};

TEST_F(ShortWalks, AreFixedOnceThePlayerHasStarted) {
  const std::string error = error_of([&] { bench_.set("trace", "two"); });
  EXPECT_NE(error.find("the walk is read when the instance starts"), std::string::npos) << error;
  EXPECT_NE(error.find("load another instance with dataset=" + folder_.path.string() + " trace=two, and swap"),
            std::string::npos)
      << error;
  EXPECT_NE(error_of([&] { bench_.set("dataset", "elsewhere"); }), "");
  bench_.set("at_end", "END_RUN");
}

TEST_F(ShortWalks, ArePlayedWithAddressesAsTheServicesSay) {
  bench_.advance(1s);
  std::vector<std::string> addresses;
  for (const auto& list : bench_.take<sensors::IbeaconlistProvider>("beacons")) {
    for (const auto& beacon : list->beacon_list()) addresses.push_back(beacon.address());
  }
  for (const auto& row : bench_.take<sensors::RFSignalRSSIService>("wifi")) addresses.push_back(row->transmitter_id());
  EXPECT_EQ(addresses,
            (std::vector<std::string>{"e0:78:a3:3d:b5:b4", "e0:78:a3:3d:b5:b5", "mall-7", "aa:00:00:00:00:01"}));
}

/// One recorded walk, where `$FIONA_DATA` has it.
class RecordedWalk : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* data = std::getenv("FIONA_DATA");
    folder_ = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "indoor20_site1";
    if (!std::filesystem::exists(folder_)) GTEST_SKIP() << "no recording at " << folder_ << ": set FIONA_DATA";
  }
  std::filesystem::path folder_;
};

TEST_F(RecordedWalk, IsPlayedAtItsOwnTimesAndEndsTheRun) {
  Bench<TracePlayer> bench("walk");
  bench.set("dataset", folder_.string());
  bench.set("trace", "5dd9e7ccc5b77e0006b1733f");
  bench.start();
  bench.advance(1s);
  const auto first_second = bench.take<sensors::GetIMUService>("imu");
  EXPECT_NEAR(static_cast<double>(first_second.size()), 44.0, 4.0) << "50 Hz from 127 ms on";
  EXPECT_FALSE(bench.run_end());
  bench.advance(60s);
  ASSERT_TRUE(bench.run_end());
  EXPECT_EQ(bench.run_end()->first, 0);
  EXPECT_EQ(bench.run_end()->second, "end of walk 5dd9e7ccc5b77e0006b1733f");
  for (const auto& row : bench.take<sensors::RFSignalRSSIService>("wifi")) {
    EXPECT_EQ(row.origin.time_since_epoch(), std::chrono::milliseconds(row->t())) << "the time it was heard";
  }
}

}  // namespace
}  // namespace fiona
