#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "../temporary_directory.hpp"
#include "error_statistics.hpp"
#include "fiona/testing/bench.hpp"
#include "thinned_track.hpp"
#include "track_recorder.hpp"
#include "truth_comparison.hpp"

namespace fiona::recorder {
namespace {

namespace fs = std::filesystem;
using localisation::CommLocation;
using localisation::LocationProvider;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using namespace std::chrono_literals;

using Recorder = testing::Bench<TrackRecorder>;

CommLocation outdoors(double x_m, double y_m) {
  CommLocation location;
  location.mutable_position()->set_x(x_m);
  location.mutable_position()->set_y(y_m);
  location.mutable_position()->set_is_valid(true);
  location.set_is_valid(true);
  return location;
}

CommLocation at(double x_m, double y_m, double level) {
  CommLocation location = outdoors(x_m, y_m);
  location.mutable_position()->set_z(level);
  return location;
}

CommLocation not_valid() {
  CommLocation location = at(9, 9, 9);
  location.set_is_valid(false);
  return location;
}

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

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

class TrackRecorderTest : public ::testing::Test {
 protected:
  std::string path(const std::string& name) const { return (directory_.path / name).string(); }
  std::size_t files() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(directory_.path), fs::directory_iterator()));
  }

  tests::TemporaryDirectory directory_;
};

void put(Recorder& recorder, CommLocation location) { recorder.put<LocationProvider>("location", std::move(location)); }

void put_truth(Recorder& recorder, CommLocation location) {
  recorder.put<LocationProvider>("truth", std::move(location));
}

bool stop(Recorder& recorder) { return !recorder.hull().shut_down(2s); }

TEST_F(TrackRecorderTest, TheCsvHasALineForEachValidLocation) {
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.set("trace", "a7");
  recorder.start();
  recorder.advance(200ms);
  put(recorder, at(1.25, -2.0004, 1));
  recorder.advance(200ms);
  put(recorder, not_valid());
  recorder.advance(200ms);
  put(recorder, at(3, 4.5, -1));
  EXPECT_EQ(content(path("track.csv")),
            "trace,t_ms,x,y,floor,cov_xx,cov_xy,cov_yy\na7,200,1.250,-2.000,1,,,\na7,600,3.000,4.500,-1,,,\n");
}

TEST_F(TrackRecorderTest, TheCsvHasTheHorizontalCovarianceWhereTheLocationTellsIt) {
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.start();
  CommLocation location = at(1, 2, 0);
  for (const double value : {4.0, 0.5, 0.0, 0.5, 9.0, 0.0, 0.0, 0.0, 0.25}) {
    location.mutable_position()->add_confidence(value);
  }
  put(recorder, location);
  EXPECT_THAT(content(path("track.csv")), HasSubstr("\nwalk,0,1.000,2.000,0,4.0000,0.5000,9.0000\n"));
}

TEST_F(TrackRecorderTest, LevelsAreRoundedHalvesUp) {
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.start();
  for (const double level : {0.49, 0.5, -0.5, -0.6}) put(recorder, at(0, 0, level));
  EXPECT_THAT(
      content(path("track.csv")),
      HasSubstr(
          "\nwalk,0,0.000,0.000,0,,,\nwalk,0,0.000,0.000,1,,,\nwalk,0,0.000,0.000,0,,,\nwalk,0,0.000,0.000,-1,,,\n"));
}

TEST_F(TrackRecorderTest, OutdoorsTheFloorIsEmpty) {
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.start();
  put(recorder, outdoors(1, 2));
  EXPECT_THAT(content(path("track.csv")), HasSubstr("\nwalk,0,1.000,2.000,,,,\n"));
}

TEST_F(TrackRecorderTest, WhatWasRecordedBeforeIsKeptAside) {
  const std::string header = "trace,t_ms,x,y,floor,cov_xx,cov_xy,cov_yy\n";
  std::ofstream(path("track.svg")) << "the drawing of yesterday";
  for (int start = 0; start < 3; ++start) {
    Recorder recorder("rec");
    recorder.set("csv", path("track.csv"));
    recorder.set("svg", path("track.svg"));
    recorder.start();
    EXPECT_EQ(content(path("track.csv")), header);
    put(recorder, at(start, 2, 0));
  }
  EXPECT_EQ(content(path("track.csv.1")), header + "walk,0,0.000,2.000,0,,,\n");
  EXPECT_EQ(content(path("track.csv.2")), header + "walk,0,1.000,2.000,0,,,\n");
  EXPECT_EQ(content(path("track.csv")), header + "walk,0,2.000,2.000,0,,,\n");
  EXPECT_EQ(content(path("track.svg.1")), "the drawing of yesterday");
}

TEST_F(TrackRecorderTest, RecordingsWithoutALocationDoNotPileUp) {
  for (int start = 0; start < 3; ++start) {
    Recorder recorder("rec");
    recorder.set("csv", path("track.csv"));
    recorder.set("svg", path("track.svg"));
    recorder.start();
    ASSERT_TRUE(stop(recorder));
  }
  EXPECT_EQ(files(), 2u);
}

TEST_F(TrackRecorderTest, ALinkStaysAndWhatItLeadsToIsKeptAside) {
  fs::create_directory(path("big"));
  for (const std::string name : {"track.csv", "track.svg"}) {
    std::ofstream(path("big/" + name)) << "of yesterday";
    fs::create_symlink("big/" + name, path(name));
  }
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.set("svg", path("track.svg"));
  recorder.start();
  put(recorder, at(1, 2, 0));
  ASSERT_TRUE(stop(recorder));
  for (const std::string name : {"track.csv", "track.svg"}) {
    EXPECT_TRUE(fs::is_symlink(path(name))) << name;
    EXPECT_EQ(content(path("big/" + name + ".1")), "of yesterday");
    EXPECT_GT(fs::file_size(path("big/" + name)), 40u) << name;
  }
  EXPECT_EQ(files(), 3u);
}

TEST_F(TrackRecorderTest, WhereNoNumberIsFreeItSaysWhatToDo) {
  std::ofstream(path("track.csv")) << "of yesterday";
  for (int number = 1; number <= 9999; ++number) std::ofstream(path("track.csv." + std::to_string(number)));
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  const Error error = error_of([&] { recorder.start(); });
  EXPECT_THAT(error.text().what, HasSubstr("9999 recordings of before lie beside it"));
  EXPECT_EQ(error.text().next, "move them elsewhere, or name another file");
  EXPECT_EQ(content(path("track.csv")), "of yesterday");
}

TEST_F(TrackRecorderTest, ACsvInNoDirectoryFailsTheStart) {
  Recorder recorder("rec");
  recorder.set("csv", path("missing/track.csv"));
  const Error error = error_of([&] { recorder.start(); });
  EXPECT_EQ(error.code(), ErrorCode::ComponentFailed);
  EXPECT_EQ(error.text().next, "check that the directory exists, may be written and has space, or name another file");
  EXPECT_EQ(recorder.reason(),
            path("missing/track.csv") + ": cannot write " + path("missing/track.csv") + ": No such file or directory");
}

TEST_F(TrackRecorderTest, AFullDiskFailsTheInstance) {
  Recorder recorder("rec");
  recorder.set("csv", "/dev/full");
  error_of([&] { recorder.start(); });
  EXPECT_THAT(recorder.reason(), HasSubstr("cannot write /dev/full: No space left on device"));
}

TEST_F(TrackRecorderTest, ABuildingThatIsMissingLeavesTheOldCsvAlone) {
  std::ofstream(path("track.csv")) << "a line of yesterday\n";
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.set("building", path("house.osm"));
  error_of([&] { recorder.start(); });
  EXPECT_THAT(recorder.reason(), HasSubstr("cannot read the building file " + path("house.osm")));
  EXPECT_EQ(content(path("track.csv")), "a line of yesterday\n");
}

TEST_F(TrackRecorderTest, TheDrawingHasBothTracksWhenItStops) {
  Recorder recorder("rec");
  recorder.set("svg", path("track.svg"));
  recorder.set("trace", "Walk <7>");
  recorder.start();
  for (int i = 0; i < 5; ++i) {
    recorder.advance(200ms);
    put(recorder, at(i, 1, 0));
    put_truth(recorder, at(i, 2, 0));
  }
  ASSERT_TRUE(stop(recorder));
  const std::string svg = content(path("track.svg"));
  EXPECT_THAT(svg, HasSubstr("<title id=\"title\">Walk &lt;7&gt;</title>"));
  EXPECT_THAT(svg, HasSubstr("Tracks: truth, location."));
  EXPECT_THAT(svg, HasSubstr("</svg>"));
}

TEST_F(TrackRecorderTest, TheDrawingLiesOverTheFloorPlan) {
  Recorder recorder("rec");
  recorder.set("svg", path("track.svg"));
  recorder.set("building", FIONA_BUILDING_FILE);
  recorder.start();
  put(recorder, at(10, 5, 0));
  ASSERT_TRUE(stop(recorder));
  EXPECT_THAT(content(path("track.svg")), HasSubstr("aria-label=\"Ground Floor\""));
}

TEST_F(TrackRecorderTest, AFolderOfFloorPlansLiesUnderTheTrackOnTheLevelsItVisits) {
  for (const int floor : {1, 2}) {
    const fs::path folder = directory_.path / "site" / ("F" + std::to_string(floor));
    fs::create_directories(folder);
    std::ofstream(folder / "floor_info.json") << R"({"map_info":{"width":20,"height":10}})";
    std::ofstream(folder / "geojson_map.json")
        << R"({"features":[{"properties":{"name":"Floor )" << floor << R"(","floor_num":)" << floor
        << R"(},"geometry":{"type":"Polygon","coordinates":[[[0,0],[2,0],[2,1],[0,1]]]}}]})";
  }
  Recorder recorder("rec");
  recorder.set("svg", path("track.svg"));
  recorder.set("building", path("site"));
  recorder.start();
  put(recorder, at(10, 5, 1));
  ASSERT_TRUE(stop(recorder));
  EXPECT_THAT(content(path("track.svg")), HasSubstr("aria-label=\"Floor 2\""));
  EXPECT_THAT(content(path("track.svg")), Not(HasSubstr("Floor 1")));
}

TEST_F(TrackRecorderTest, AFolderWithoutFloorPlansLeavesTheOldCsvAlone) {
  std::ofstream(path("track.csv")) << "old\n";
  fs::create_directories(path("site"));
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.set("building", path("site"));
  const Error error = error_of([&] { recorder.start(); });
  EXPECT_THAT(error.what(), HasSubstr("this folder holds no floor plan"));
  EXPECT_EQ(content(path("track.csv")), "old\n");
}

TEST_F(TrackRecorderTest, ADrawingThatCannotBeWrittenFailsTheStart) {
  fs::create_directories(path("track.svg"));
  Recorder recorder("rec");
  recorder.set("svg", path("track.svg"));
  error_of([&] { recorder.start(); });
  EXPECT_THAT(recorder.reason(), HasSubstr("cannot write " + path("track.svg") + ": Is a directory"));
  EXPECT_EQ(files(), 1u) << "a part of the drawing was left";
}

TEST_F(TrackRecorderTest, ADrawingThatCannotBeWrittenLeavesTheOldCsvAlone) {
  std::ofstream(path("track.csv")) << "old\n";
  for (const std::string& svg : {path("nowhere/track.svg"), directory_.path.string()}) {
    Recorder recorder("rec");
    recorder.set("csv", path("track.csv"));
    recorder.set("svg", svg);
    EXPECT_THAT(error_of([&] { recorder.start(); }).what(), HasSubstr("cannot write " + svg));
    EXPECT_EQ(content(path("track.csv")), "old\n");
  }
  EXPECT_EQ(files(), 1u) << "nothing was left beside it";
}

TEST_F(TrackRecorderTest, ADirectoryThatVanishedIsToldWhenItStops) {
  fs::create_directories(path("here"));
  Recorder recorder("rec");
  recorder.set("svg", path("here/track.svg"));
  recorder.start();
  fs::remove_all(path("here"));
  ASSERT_TRUE(stop(recorder));
  EXPECT_EQ(recorder.mode(), "failed");
  EXPECT_THAT(recorder.reason(), HasSubstr("cannot write " + path("here/track.svg") + ": No such file or directory"));
}

TEST_F(TrackRecorderTest, ItReportsPositionLevelAndError) {
  Recorder recorder("rec");
  recorder.set("report_period_s", 1);
  recorder.start();
  put_truth(recorder, at(0, 0, 0));
  put(recorder, at(3, 4, 0.2));
  recorder.advance(1s);
  EXPECT_THAT(recorder.log(), ElementsAre("1.0 s: x 3.00 m, y 4.00 m, level 0, error 5.00 m"));
}

TEST_F(TrackRecorderTest, ItReportsOncePerPeriod) {
  Recorder recorder("rec");
  recorder.set("report_period_s", 0.5);
  recorder.start();
  recorder.advance(2s);
  EXPECT_EQ(recorder.log().size(), 4u);
}

TEST_F(TrackRecorderTest, WithoutALocationItSaysSo) {
  Recorder recorder("rec");
  recorder.set("report_period_s", 1);
  recorder.start();
  recorder.advance(1s);
  EXPECT_THAT(recorder.log(), ElementsAre("1.0 s: no location yet"));
}

TEST_F(TrackRecorderTest, ALocationThatWasLostIsToldWithItsAge) {
  Recorder recorder("rec");
  recorder.set("report_period_s", 2);
  recorder.start();
  put(recorder, at(1, 2, 0));
  recorder.advance(1s);
  put(recorder, not_valid());
  recorder.advance(1s);
  EXPECT_THAT(recorder.log(), ElementsAre("2.0 s: x 1.00 m, y 2.00 m, level 0, not valid since 2.0 s"));
}

TEST_F(TrackRecorderTest, ReportsCanBeSwitchedOnWhileItRecords) {
  Recorder recorder("rec");
  recorder.start();
  recorder.advance(3s);
  recorder.set("report_period_s", 1);
  recorder.advance(1s);
  EXPECT_THAT(recorder.log(), ElementsAre("4.0 s: no location yet"));
}

TEST_F(TrackRecorderTest, TheSummaryHasTheErrorsAgainstTheTruth) {
  Recorder recorder("rec");
  recorder.start();
  for (int i = 1; i <= 10; ++i) {
    recorder.advance(200ms);
    put(recorder, at(i, 0, i <= 9 ? 0 : 1));
    put_truth(recorder, at(0, 0, 0));
  }
  ASSERT_TRUE(stop(recorder));
  EXPECT_EQ(recorder.log().back(),
            "walk: 10 points; error of 10: mean 5.50 m, median 5.00 m, p90 9.00 m; level right 90.0 %");
}

TEST_F(TrackRecorderTest, WithoutATruthTheSummaryCountsPointsOnly) {
  Recorder recorder("rec");
  recorder.start();
  put(recorder, at(1, 2, 0));
  ASSERT_TRUE(stop(recorder));
  EXPECT_EQ(recorder.log().back(), "walk: 1 points");
}

TEST_F(TrackRecorderTest, ATraceWithACommaIsRefused) {
  Recorder recorder("rec");
  EXPECT_STREQ(error_of([&] { recorder.set("trace", "a,b"); }).what(),
               "rec: parameter 'trace' does not take this value\n"
               "  expected: a name without comma, quotation mark and line break\n"
               "  found: a,b\n"
               "  next: get rec");
}

TEST_F(TrackRecorderTest, OneFileForBothIsRefused) {
  Recorder recorder("rec");
  recorder.set("csv", "track");
  EXPECT_EQ(error_of([&] { recorder.set("svg", "track"); }).text().expected, "another file than that of csv");
}

TEST_F(TrackRecorderTest, ARecordingThatHasBegunKeepsItsFile) {
  Recorder recorder("rec");
  recorder.set("csv", path("track.csv"));
  recorder.start();
  EXPECT_STREQ(error_of([&] { recorder.set("csv", path("other.csv")); }).what(),
               "rec: the recording has begun: only report_period_s can still be changed\n"
               "  next: unload rec, then load it with the new parameters");
}

TEST(ThinnedTrack, StaysWithinItsBoundAndKeepsBothEnds) {
  ThinnedTrack track(100);
  for (int i = 0; i <= 12345; ++i) track.add({i, 0, 0, 0});
  const auto points = track.points();
  EXPECT_LE(points.size(), 101u);
  EXPECT_GE(points.size(), 45u);
  EXPECT_EQ(points.front().t_ms, 0);
  EXPECT_EQ(points.back().t_ms, 12345);
}

TEST(ThinnedTrack, KeepsEvenDistances) {
  ThinnedTrack track(8);
  for (int i = 0; i < 8; ++i) track.add({i, 0, 0, 0});
  for (int i = 8; i < 12; ++i) track.add({i, 0, 0, 0});
  std::vector<std::int64_t> times;
  for (const auto& point : track.points()) times.push_back(point.t_ms);
  EXPECT_THAT(times, ElementsAre(0, 2, 4, 6, 8, 10, 11));
}

TEST(ErrorStatistics, QuantilesAreExactToTheirBin) {
  ErrorStatistics errors;
  for (int i = 1; i <= 1000; ++i) errors.add(0.01 * i);
  EXPECT_NEAR(errors.quantile_m(0.9), 9.0, 0.02);
}

TEST(ErrorStatistics, BeyondTheBinsAQuantileIsTheLargest) {
  ErrorStatistics errors;
  errors.add(1.0);
  errors.add(1e6);
  EXPECT_EQ(errors.quantile_m(0.9), 1e6);
}

Fix fix(Duration time, double x_m) { return {TimePoint(time), x_m, 0.0, 0.0}; }

TEST(TruthComparison, ATruthThatComesLaterIsCompared) {
  TruthComparison comparison;
  comparison.add_truth(fix(0s, 0));
  comparison.add_estimate(fix(1s, 5));
  EXPECT_EQ(comparison.errors().count(), 0u);
  comparison.add_truth(fix(1s, 3));
  EXPECT_EQ(comparison.latest_m(), 2.0);
}

TEST(TruthComparison, BetweenTwoTruthsTheDeviceWentStraight) {
  TruthComparison comparison;
  comparison.add_truth(fix(0s, 0));
  comparison.add_truth(fix(1s, 2));
  comparison.add_estimate(fix(500ms, 4));
  EXPECT_EQ(comparison.latest_m(), 3.0);
}

TEST(TruthComparison, AcrossAGapNothingIsCompared) {
  TruthComparison comparison;
  comparison.add_truth(fix(0s, 0));
  comparison.add_truth(fix(3s, 2));
  comparison.add_estimate(fix(1s, 4));
  EXPECT_EQ(comparison.errors().count(), 0u);
}

TEST(TruthComparison, AnEstimateBeforeAllTruthIsNotCompared) {
  TruthComparison comparison;
  comparison.add_truth(fix(2s, 0));
  comparison.add_estimate(fix(1s, 4));
  EXPECT_EQ(comparison.errors().count(), 0u);
}

}  // namespace
}  // namespace fiona::recorder
