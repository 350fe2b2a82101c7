#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>
#include <fiona/walk/dataset.hpp>
#include <fiona/walk/imu_merger.hpp>

#include "../temporary_directory.hpp"
#include "walk_archive.hpp"

namespace fiona::walk {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using tests::write_archive;

constexpr const char* kSurvey =
    "# trace=north start_ms=1575603597141 floor=0 floor_name=F1\n"
    "P\t0\t10.0\t20.0\n"
    "W\t2000\taa0000000001\t-60\t2437\t1200\n"
    "B\t2100\t9195B3AD\t0\t0\t-56\t-90\tE078A33DB5B4\n"
    "P\t10000\t20.0\t20.0\n";

constexpr const char* kMuseum =
    "# trace=T01R01 phone=SM-A520F\n"
    "M\t-3\t-2.1\t-34.14\t-45.42\n"
    "G\t-2\t1.0\t0\t0\n"
    "A\t0\t0\t0\t9.80665\n"
    "N\t5\t49.46\t11.11\t350\t12\t0\t0\t7\t0\n"
    "W\t10\t000000000007\t-71\t5180\n"
    "H\t20\t976.2\n"
    "P\t30\t1.5\t19.4\t-2\n";

std::vector<Walk> survey_of(const Dataset& dataset) {
  std::vector<Walk> walks;
  dataset.for_each_survey_walk([&](const Walk& walk) {
    walks.push_back(walk);
    return true;
  });
  return walks;
}

/// The error that reading the only survey walk of a dataset with this text gives.
std::string error_of(const std::string& text, const Limits& limits = {}) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "F1" / "train.tar.xz", {{"train/north.tsv", text}});
  try {
    survey_of(Dataset::open(folder.path, limits));
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(WalkTrace, FloorFoldersGiveTheirLevelsInOrder) {
  const tests::TemporaryDirectory folder;
  for (const char* floor : {"F7", "B2", "F1"}) {
    const int level = *level_of_floor_name(floor);
    write_archive(
        folder.path / floor / "train.tar.xz",
        {{"train/a.tsv", "# trace=" + std::string(floor) + " floor=" + std::to_string(level) + "\nP\t1\t2\t3\n"}});
  }
  std::vector<std::pair<std::string, int>> found;
  for (const Walk& walk : survey_of(Dataset::open(folder.path))) found.emplace_back(walk.name, *walk.level);
  EXPECT_THAT(found, ElementsAre(std::pair<std::string, int>("B2", -2), std::pair<std::string, int>("F1", 0),
                                 std::pair<std::string, int>("F7", 6)));
}

TEST(WalkTrace, FloorNamesOfOtherKindsAreNotGuessed) {
  EXPECT_EQ(level_of_floor_name("1F"), 0);
  for (const char* name : {"F0", "G", "B", "Fx", "F-1", "1B", "mezzanine", ""}) {
    EXPECT_FALSE(level_of_floor_name(name)) << name;
  }
}

TEST(WalkTrace, AWiFiRowKeepsWhenItWasReallyHeard) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "F1" / "train.tar.xz", {{"train/north.tsv", kSurvey}});
  const Walk walk = survey_of(Dataset::open(folder.path)).at(0);
  const auto& row = std::get<WifiRow>(walk.events.at(1).data);
  EXPECT_EQ(walk.events[1].t_ms, 2000);
  EXPECT_EQ(row.heard_ms, 1200);
  EXPECT_EQ(walk.transmitters.at(row.transmitter), "aa0000000001");
  EXPECT_EQ(walk.start_ms, 1575603597141);
}

Walk walk_of(const std::string& text) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "F1" / "train.tar.xz", {{"train/north.tsv", text}});
  return survey_of(Dataset::open(folder.path)).at(0);
}

TEST(WalkTrace, ABeaconWithAPowerKeepsItsIdentityInLowerCase) {
  const Walk walk = walk_of("# trace=north\nB\t5\t9195B3AD-A9D0\t7\t65535\t-56\t-90\tE078A33DB5B4\n");
  const auto& row = std::get<BeaconRow>(walk.events.at(0).data);
  EXPECT_EQ(walk.beacons.at(row.beacon), (BeaconIdentity{"9195b3ad-a9d0", 7, 65535, -56}));
  EXPECT_EQ(walk.transmitters.at(row.transmitter), "E078A33DB5B4");
  EXPECT_FLOAT_EQ(row.rssi_dbm, -90);
}

TEST(WalkTrace, ABeaconWithoutAPowerSaysSo) {
  const Walk walk = walk_of("# trace=north\nB\t5\tBEAC-2023\t1\t2\t-90\tBEAC20230001\n");
  const auto& row = std::get<BeaconRow>(walk.events.at(0).data);
  EXPECT_EQ(walk.beacons.at(row.beacon), (BeaconIdentity{"beac-2023", 1, 2, std::nullopt}));
  EXPECT_FLOAT_EQ(row.rssi_dbm, -90);
}

TEST(WalkTrace, TransmittersOfOneIdentityShareIt) {
  const Walk walk = walk_of(
      "# trace=north\nB\t1\tAB\t0\t0\t-56\t-90\taa\nB\t2\tab\t0\t0\t-56\t-91\tbb\n"
      "B\t3\tab\t0\t1\t-56\t-92\tbb\n");
  std::vector<std::uint32_t> identities;
  for (const Event& event : walk.events) identities.push_back(std::get<BeaconRow>(event.data).beacon);
  EXPECT_THAT(identities, ElementsAre(0, 0, 1));
  EXPECT_EQ(walk.beacons.size(), 2u);
}

TEST(WalkTrace, ABeaconBeyondTheRangeOfItsFieldsIsGarbled) {
  EXPECT_THAT(error_of("# trace=north\nB\t5\tab\t65536\t0\t-90\taa\n"), HasSubstr("a major from 0 to 65535"));
  EXPECT_THAT(error_of("# trace=north\nB\t5\tab\t0\t-1\t-90\taa\n"), HasSubstr("a minor from 0 to 65535"));
  EXPECT_THAT(error_of("# trace=north\nB\t5\tab\t0\t0\t200\t-90\taa\n"), HasSubstr("a power at 1 m"));
  EXPECT_THAT(error_of("# trace=north\nB\t5\t\t0\t0\t-90\taa\n"), HasSubstr("a beacon's UUID"));
}

TEST(WalkTrace, OneArchiveAtTheTopCarriesLevelsInItsWayPoints) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "train.tar.xz", {{"train/T01R01.tsv", kMuseum}});
  const Walk walk = survey_of(Dataset::open(folder.path)).at(0);
  EXPECT_EQ(way_points_of(walk).at(0).second.level, -2);
  EXPECT_FLOAT_EQ(std::get<Pressure>(walk.events.at(4).data).hectopascal, 976.2f);
  EXPECT_EQ(std::get<WifiRow>(walk.events.at(3).data).heard_ms, 10);
}

TEST(WalkTrace, PositionIsEvenBetweenWayPoints) {
  const std::vector<std::pair<std::int64_t, WayPoint>> points = {{0, {10, 20, 0}}, {10'000, {20, 20, 0}}};
  EXPECT_DOUBLE_EQ(position_at(points, 2500)->x_m, 12.5);
  EXPECT_DOUBLE_EQ(position_at(points, 99'000)->x_m, 20.0);
}

TEST(WalkTrace, PositionBetweenLevelsIsUnknown) {
  const std::vector<std::pair<std::int64_t, WayPoint>> points = {{0, {10, 20, 0}}, {10'000, {20, 20, -1}}};
  EXPECT_FALSE(position_at(points, 5000));
}

TEST(WalkTrace, MergedSamplesCarryTheUnitsOfGetImu) {
  ImuMerger merger;
  EXPECT_FALSE(merger.feed({0, Magnetometer{0, 20, -40}}));
  EXPECT_FALSE(merger.feed({1, Gyroscope{1, 0, 0}}));
  EXPECT_FALSE(merger.feed({2, Gyroscope{3, 0, 0}}));
  const auto sample = merger.feed({3, Accelerometer{0, 0, 9.80665f}});
  ASSERT_TRUE(sample);
  EXPECT_NEAR(sample->acceleration_g[2], 1.0, 1e-6);
  EXPECT_NEAR(sample->rate_dps[0], 2.0 * 57.2957795, 1e-6);
  EXPECT_NEAR(sample->field_gauss[2], -0.4, 1e-6);
}

TEST(WalkTrace, ATestWalkIsFoundByName) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "test.tar.xz",
                {{"test/one.tsv", "# trace=one\nW\t5\tab\t-50\t2412\t1\n"}, {"test/two.tsv", "# trace=two\n"}});
  const Dataset dataset = Dataset::open(folder.path);
  EXPECT_THAT(dataset.walk_names(), ElementsAre("one", "two"));
  EXPECT_EQ(dataset.walk("two").name, "two");
}

TEST(WalkTrace, AnUnknownNameIsToldWithItsNeighbours) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "test.tar.xz", {{"test/T01R02.tsv", "# trace=T01R02\n"}});
  try {
    Dataset::open(folder.path).walk("T01R03");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_THAT(error.what(), HasSubstr("no recorded walk is called T01R03"));
    EXPECT_THAT(error.text().near, ElementsAre("T01R02"));
  }
}

TEST(WalkTrace, AFolderWithoutWalksIsRefusedWithTheLayoutsItMayHave) {
  const tests::TemporaryDirectory folder;
  try {
    Dataset::open(folder.path);
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_THAT(error.text().expected, HasSubstr("train.tar.xz"));
  }
}

TEST(WalkTrace, AFloorWithoutALevelIsRefusedByName) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "mezzanine" / "train.tar.xz", {{"a.tsv", kSurvey}});
  try {
    Dataset::open(folder.path);
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("mezzanine"));
  }
}

TEST(WalkTrace, ATruncatedArchiveIsOneClearError) {
  const tests::TemporaryDirectory folder;
  const fs::path file = folder.path / "F1" / "train.tar.xz";
  std::string noise(200'000, 'x');
  for (std::size_t i = 0; i < noise.size(); ++i) noise[i] = static_cast<char>('a' + (i * i * 7919 >> 5) % 26);
  write_archive(file, {{"train/north.tsv", kSurvey}, {"train/noise.tsv", noise}});
  fs::resize_file(file, fs::file_size(file) / 2);
  try {
    survey_of(Dataset::open(folder.path));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("train.tar.xz"));
    EXPECT_FALSE(error.text().next.empty());
  }
}

TEST(WalkTrace, AFileThatIsNoArchiveIsOneClearError) {
  const tests::TemporaryDirectory folder;
  fs::create_directories(folder.path / "F1");
  std::ofstream(folder.path / "F1" / "train.tar.xz") << "hello";
  try {
    survey_of(Dataset::open(folder.path));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("the archive is truncated or garbled"));
  }
}

TEST(WalkTrace, AGarbledRowIsNamedByFileAndLine) {
  const std::string text = error_of("# trace=north floor=0\nP\t0\t10.0\t20.0\nW\t2000\taa\tloud\t2437\t1200\n");
  EXPECT_THAT(text, HasSubstr("train/north.tsv:3"));
  EXPECT_THAT(text, HasSubstr("an RSSI in dBm"));
  EXPECT_THAT(text, HasSubstr("loud"));
}

TEST(WalkTrace, ANumberThatIsNotFiniteIsGarbled) {
  EXPECT_THAT(error_of("# trace=north floor=0\nP\t0\tnan\t20.0\n"), HasSubstr("x in metres"));
}

TEST(WalkTrace, ATimeBeyondADayIsGarbled) {
  EXPECT_THAT(error_of("# trace=north floor=0\nP\t86400001\t1\t2\n"),
              HasSubstr("a time in ms from -86400000 to 86400000"));
  EXPECT_THAT(error_of("# trace=north floor=0\nP\t-9223372036854775808\t1\t2\n"), HasSubstr("a time in ms"));
}

TEST(WalkTrace, ANumberThatNoFloatHoldsIsGarbled) {
  EXPECT_THAT(error_of("# trace=north floor=0\nW\t5\taa\t1e300\t2437\n"), HasSubstr("an RSSI in dBm"));
}

TEST(WalkTrace, ATimeThatGoesBackIsNamed) {
  const std::string text = error_of("# trace=north floor=0\nP\t100\t1\t2\nA\t100\t0\t0\t9.8\nA\t99\t0\t0\t9.8\n");
  EXPECT_THAT(text, HasSubstr("time goes back within the walk"));
  EXPECT_THAT(text, HasSubstr("train/north.tsv:4"));
  EXPECT_THAT(text, HasSubstr("100 ms, as the row before, or later"));
}

TEST(WalkTrace, AnArchiveOfFilesThatAreNoWalksIsRefused) {
  const tests::TemporaryDirectory folder;
  write_archive(folder.path / "train.tar.xz", {{"train/north.txt", kSurvey}});
  write_archive(folder.path / "test.tar.xz", {{"test/north.txt", kSurvey}});
  const Dataset dataset = Dataset::open(folder.path);
  for (const auto& read : {std::function<void()>([&] { survey_of(dataset); }), {[&] { dataset.walk_names(); }}}) {
    try {
      read();
      FAIL() << "no error";
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("the archive holds no walk"));
      EXPECT_THAT(error.text().found, HasSubstr("none whose name ends in .tsv"));
    }
  }
}

TEST(WalkTrace, ARowCutShortIsNamed) {
  EXPECT_THAT(error_of("# trace=north floor=0\nA\t0\t1.0\n"), HasSubstr("tag, time, x, y, z"));
}

TEST(WalkTrace, AnUnknownTagIsNamed) {
  EXPECT_THAT(error_of("# trace=north floor=0\nQ\t0\t1.0\n"), HasSubstr("unknown tag"));
}

TEST(WalkTrace, AFileWithoutHeaderIsNotAWalk) {
  EXPECT_THAT(error_of("P\t0\t1\t2\n"), HasSubstr("# trace=NAME"));
  EXPECT_THAT(error_of(""), HasSubstr("an empty file"));
}

TEST(WalkTrace, AHeaderOfAnotherFloorThanItsFolderIsRefused) {
  EXPECT_THAT(error_of("# trace=north floor=3\n"), HasSubstr("another floor than its folder"));
}

TEST(WalkTrace, ALineBeyondTheLimitIsRefused) {
  EXPECT_THAT(error_of(std::string(200'000, 'x')), HasSubstr("a line is longer than the reader accepts"));
}

TEST(WalkTrace, AWalkBeyondTheLimitOfRowsIsRefused) {
  Limits limits;
  limits.walk_events = 1;
  EXPECT_THAT(error_of(kSurvey, limits), HasSubstr("at most 1 rows"));
}

}  // namespace
}  // namespace fiona::walk
