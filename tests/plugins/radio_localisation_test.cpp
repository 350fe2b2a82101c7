#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <Eigen/LU>

#include <fiona/error.hpp>

#include "../temporary_directory.hpp"
#include "accuracy.hpp"
#include "fiona/testing/bench.hpp"
#include "level_tracker.hpp"
#include "radio_filter.hpp"
#include "radio_localisation.hpp"
#include "radio_map_file.hpp"
#include "radio_map_learner.hpp"

namespace fiona::radio {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

/// A building of two levels, 60 m x 30 m, with a transmitter every 10 m on each.
struct Building {
  struct Mast {
    std::string id;
    double x_m, y_m;
    int level;
  };
  std::vector<Mast> masts;
  double ceiling_db = 18.0;

  explicit Building(const std::string& prefix = "aa00") {
    for (int level = 0; level < 2; ++level) {
      for (int x = 5; x < 60; x += 10) {
        for (int y = 5; y < 30; y += 10) {
          masts.push_back({prefix + std::to_string(1000 * level + 10 * x + y), double(x), double(y), level});
        }
      }
    }
  }

  /// Log-distance path loss and a ceiling; nothing below -85 dBm is heard.
  double rssi_dbm(const Mast& mast, int level, double x_m, double y_m) const {
    const double distance_m = std::hypot(mast.x_m - x_m, mast.y_m - y_m, 2.0);
    return -38.0 - 30.0 * std::log10(distance_m) - ceiling_db * std::abs(mast.level - level);
  }

  template <typename Use>
  void sweep(int level, double x_m, double y_m, Random& random, Use&& use) const {
    for (const Mast& mast : masts) {
      const double rssi = rssi_dbm(mast, level, x_m, y_m) + 4.0 * random.normal();
      if (rssi > -85.0) use(mast.id, rssi);
    }
  }
};

void survey(RadioMapLearner& learner, const Building& building, double offset_db, std::uint64_t seed) {
  Random random(seed);
  for (int level = 0; level < 2; ++level) {
    for (double y_m = 2.0; y_m < 30.0; y_m += 4.0) {
      learner.begin_walk();
      for (double x_m = 0.0; x_m <= 60.0; x_m += 1.0) {
        learner.path(level, x_m, y_m);
        learner.sweep(Radio::WiFi, level, x_m, y_m);
        building.sweep(level, x_m, y_m, random, [&](const std::string& id, double rssi_dbm) {
          learner.heard(id, Radio::WiFi, level, x_m, y_m, rssi_dbm + offset_db);
        });
      }
    }
  }
}

std::shared_ptr<const RadioMap> learnt_map() {
  static const auto map = [] {
    RadioMapLearner learner;
    survey(learner, Building(), 0.0, 7);
    return std::make_shared<const RadioMap>(learner.learn("hall"));
  }();
  return map;
}

/// Someone in the building whose receiver sweeps every two seconds.
class Walker {
 public:
  Walker(RadioFilter& filter, const Building& building, int level, double x_m, double y_m, std::uint64_t seed = 3)
      : filter_(filter), building_(building), level_(level), x_m_(x_m), y_m_(y_m), random_(seed) {}

  /// Two steps of 0.7 m a second, then a sweep, for so many times.
  void walk(int sweeps, double heading_rad) {
    for (int i = 0; i < sweeps; ++i) {
      for (int s = 0; s < 4; ++s) {
        now_ += milliseconds(500);
        x_m_ += 0.7 * std::cos(heading_rad);
        y_m_ += 0.7 * std::sin(heading_rad);
        filter_.step({now_, 0.7, 0.1, heading_rad, 0.1});
        filter_.advance(now_);
      }
      listen();
    }
  }
  void stand(int sweeps) {
    for (int i = 0; i < sweeps; ++i) {
      now_ += milliseconds(2000);
      filter_.advance(now_);
      listen();
    }
  }
  void carry_to(int level, double x_m, double y_m) { level_ = level, x_m_ = x_m, y_m_ = y_m; }
  double error_m() const {
    const Estimate at = filter_.estimate();
    return std::hypot(at.x_m - x_m_, at.y_m - y_m_);
  }

 private:
  void listen() {
    building_.sweep(level_, x_m_, y_m_, random_, [&](const std::string& id, double rssi_dbm) {
      filter_.signal(now_, {id, Radio::WiFi, rssi_dbm, now_ - milliseconds(100)});
    });
    now_ += milliseconds(200);
    filter_.advance(now_);
  }
  RadioFilter& filter_;
  const Building& building_;
  int level_;
  double x_m_, y_m_;
  Random random_;
  milliseconds now_{10'000};
};

std::string bytes_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// The error that loading these bytes gives.
Error error_of(const std::string& bytes) {
  const tests::TemporaryDirectory folder;
  std::ofstream(folder.path / "hall.radiomap", std::ios::binary) << bytes;
  try {
    load(folder.path / "hall.radiomap");
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Usage, "no error");
}

std::string saved_map() {
  const tests::TemporaryDirectory folder;
  save(*learnt_map(), folder.path / "hall.radiomap");
  return bytes_of(folder.path / "hall.radiomap");
}

TEST(RadioMap, TransmittersAreFoundHoweverTheirAddressIsSpelt) {
  RadioMapLearner learner;
  learner.path(0, 0, 0);
  learner.sweep(Radio::WiFi, 0, 0, 0);
  learner.heard("a8:0c:ca:03:9d:d7", Radio::WiFi, 0, 0, 0, -50);
  EXPECT_EQ(learner.learn("x").find("A8-0C-CA-03-9D-D7"), 0u);
}

TEST(RadioMap, WhatWasHeardIsExpectedWhereItWasHeard) {
  const auto map = learnt_map();
  const auto number = map->find("aa0055");
  ASSERT_TRUE(number);
  const auto& span = map->transmitters[*number].spans.at(0);
  const auto cell = static_cast<std::uint32_t>(map->cell_at(0, 5.5, 6.0));
  for (std::uint32_t i = span.begin; i < span.end; ++i) {
    if (map->expectations[i].cell != cell) continue;
    EXPECT_NEAR(expected_rssi_dbm(map->expectations[i]), -55.0, 4.0);
    EXPECT_GT(heard_probability(map->expectations[i]), 0.9);
    return;
  }
  FAIL() << "the cell next to the transmitter expects nothing";
}

TEST(RadioMap, AnOddPhoneInTheSurveyDoesNotShiftTheMap) {
  RadioMapLearner mixed;
  survey(mixed, Building(), 0.0, 7);
  survey(mixed, Building(), 8.0, 8);
  LearnerOptions plain_options;
  plain_options.offset_rounds = 0;
  RadioMapLearner plain(plain_options);
  survey(plain, Building(), 0.0, 7);
  survey(plain, Building(), 8.0, 8);
  // Both maps lie 4 dB above the first phone; only with offsets the walks agree, so a fix of the first is sharper.
  auto sharpness = [](const RadioMap& map) {
    const RadioLikelihood likelihood(map);
    std::vector<float> field(map.cells.size(), 0.0f);
    std::vector<HeardRow> rows;
    Random random(1);
    Building().sweep(0, 30, 14, random, [&](const std::string& id, double rssi_dbm) {
      rows.push_back({*map.find(id), static_cast<float>(rssi_dbm + 4.0), 1.0f});
    });
    likelihood.add_rows(rows, 0.0, field);
    return likelihood.at(field, 0, 30, 14, -1e9f);
  };
  EXPECT_GE(sharpness(mixed.learn("m")), sharpness(plain.learn("p")) - 0.5f);
}

TEST(RadioMap, AWalkThatIsLeftOutTeachesNothing) {
  const auto bytes = [](const RadioMap& map) {
    const tests::TemporaryDirectory folder;
    save(map, folder.path / "map");
    return bytes_of(folder.path / "map");
  };
  RadioMapLearner plain, more;
  survey(plain, Building(), 0.0, 7);
  survey(more, Building(), 0.0, 7);
  const std::uint32_t odd = more.begin_walk();
  for (double x_m = 0.0; x_m <= 90.0; x_m += 1.0) {
    more.path(2, x_m, 10.0);
    more.path(0, x_m, 10.0);
    more.sweep(Radio::WiFi, 0, x_m, 10.0);
    more.heard("aa0055", Radio::WiFi, 0, x_m, 10.0, -30.0);
    more.heard("cc0001", Radio::WiFi, 0, x_m, 10.0, -50.0);
  }
  EXPECT_EQ(bytes(more.learn("hall", {odd})), bytes(plain.learn("hall")));
  EXPECT_NE(bytes(more.learn("hall")), bytes(plain.learn("hall")));
}

TEST(RadioMap, OtherWalksNearAPlaceAreCountedOnceEach) {
  RadioMapLearner learner;
  for (int i = 0; i < 3; ++i) {
    learner.begin_walk();
    learner.path(0, 10.0, 0.0);
    learner.path(0, 11.0, 0.0);
  }
  learner.path(1, 10.0, 0.0);
  EXPECT_EQ(learner.other_walks_near(3, 0, 10.0, 3.0, 5.0), 2u);
  EXPECT_EQ(learner.other_walks_near(0, 0, 10.0, 3.0, 5.0), 3u);
  EXPECT_EQ(learner.other_walks_near(1, 1, 10.0, 3.0, 5.0), 1u);
  EXPECT_EQ(learner.other_walks_near(1, 0, 10.0, 6.0, 5.0), 0u);
}

TEST(RadioMap, WayPointsThatAreTooFarApartAreTold) {
  RadioMapLearner learner;
  learner.path(0, 0.0, 0.0);
  learner.path(0, 40'000.0, 40'000.0);
  learner.heard("aa01", Radio::WiFi, 0, 0.0, 0.0, -50.0);
  try {
    learner.learn("x");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("a level of the survey is too wide"));
  }
}

TEST(RadioMap, NothingHeardIsNoMap) {
  try {
    RadioMapLearner().learn("empty");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("no radio map can be learnt"));
  }
}

TEST(RadioMapFile, AMapComesBackAsItWasSaved) {
  const tests::TemporaryDirectory folder;
  RadioMap map = *learnt_map();
  map.reference = Reference{49.4611419, 11.1109429};
  map.accuracy = {2.25, 0.75};
  save(map, folder.path / "a");
  const RadioMap back = load(folder.path / "a");
  save(back, folder.path / "b");
  EXPECT_EQ(bytes_of(folder.path / "a"), bytes_of(folder.path / "b"));
  EXPECT_EQ(back.name, "hall");
  EXPECT_DOUBLE_EQ(back.reference->longitude_deg, 11.1109429);
  EXPECT_DOUBLE_EQ(back.accuracy.covariance_factor, 2.25);
  EXPECT_DOUBLE_EQ(back.accuracy.covariance_floor_m, 0.75);
  EXPECT_EQ(back.transmitters.size(), map.transmitters.size());
  EXPECT_EQ(back.cell_at(1, 20.0, 10.0), map.cell_at(1, 20.0, 10.0));
}

/// The error that loading a map gives after `change`.
std::string error_after(const std::function<void(RadioMap&)>& change) {
  const tests::TemporaryDirectory folder;
  RadioMap map = *learnt_map();
  change(map);
  save(map, folder.path / "a");
  return error_of(bytes_of(folder.path / "a")).what();
}

TEST(RadioMapFile, AnImpossibleAccuracyIsTold) {
  for (const Accuracy accuracy : {Accuracy{std::nan(""), 1.0}, Accuracy{0.0, 1.0}, Accuracy{1.0, -1.0}}) {
    EXPECT_THAT(error_after([&](RadioMap& map) { map.accuracy = accuracy; }), HasSubstr("an impossible accuracy"));
  }
}

TEST(RadioMapFile, ARasterBeyondTheMemoryGrantedIsTold) {
  const auto widen = [](RadioMap& map) { map.levels[0].columns = kMostSquares; };
  EXPECT_THAT(error_after(widen), HasSubstr("a level of impossible extent"));
}

TEST(RadioMapFile, LevelsOutOfOrderAreTold) {
  EXPECT_THAT(error_after([](RadioMap& map) { map.levels[1].level = 0; }), HasSubstr("levels that do not ascend"));
  EXPECT_THAT(error_after([](RadioMap& map) { map.levels[1].level = 5000; }),
              HasSubstr("a level of impossible number"));
}

TEST(RadioMapFile, AReferenceOffTheGlobeIsTold) {
  const auto move = [](RadioMap& map) { map.reference = Reference{49.0, 1000.0}; };
  EXPECT_THAT(error_after(move), HasSubstr("no place on Earth"));
}

TEST(RadioMapFile, EveryTruncationIsTold) {
  const std::string bytes = saved_map();
  for (const std::size_t size : {std::size_t{0}, std::size_t{9}, std::size_t{27}, bytes.size() / 2, bytes.size() - 1}) {
    EXPECT_THAT(error_of(bytes.substr(0, size)).what(), HasSubstr("the radio map is garbled")) << size;
  }
}

TEST(RadioMapFile, AFlippedBitIsTold) {
  std::string bytes = saved_map();
  bytes[bytes.size() / 3] ^= 0x10;
  EXPECT_THAT(error_of(bytes).what(), HasSubstr("a checksum that does not fit"));
}

TEST(RadioMapFile, AnotherVersionIsToldWithBothNumbers) {
  std::string bytes = saved_map();
  bytes[8] = 9;
  const Error error = error_of(bytes);
  EXPECT_EQ(error.text().expected, "version 2");
  EXPECT_EQ(error.text().found, "version 9");
}

TEST(RadioMapFile, AnotherKindOfFileIsTold) {
  EXPECT_THAT(error_of("#!/bin/sh\necho this is not a radio map at all\n").what(), HasSubstr("another kind of file"));
}

TEST(RadioMapFile, AMissingFileIsNotFound) {
  const tests::TemporaryDirectory folder;
  try {
    load(folder.path / "none");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_THAT(error.text().next, HasSubstr("fiona-radiomap learn"));
  }
}

TEST(RadioMapFile, AFolderThatDoesNotExistIsToldBeforeAnythingIsLost) {
  const tests::TemporaryDirectory folder;
  for (const auto& write : {std::function<void()>([&] { save(*learnt_map(), folder.path / "none" / "hall"); }),
                            {[&] { check_writable(folder.path / "none" / "hall"); }}}) {
    try {
      write();
      FAIL() << "no error";
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("the file cannot be written: No such file or directory"));
    }
  }
  EXPECT_THROW(check_writable(folder.path), Error);
  check_writable(folder.path / "hall");
  EXPECT_FALSE(fs::exists(folder.path / "hall")) << "nothing is left";
}

TEST(RadioFilter, IsSilentBeforeTheFirstEvidence) {
  RadioFilter filter(learnt_map());
  filter.advance(milliseconds(5000));
  filter.step({milliseconds(5000), 0.7, 0.1, 0.0, 0.1});
  EXPECT_EQ(filter.estimate().validity, Validity::NoEvidence);
}

TEST(RadioFilter, FindsAWalkerAndTheLevel) {
  const Building building;
  RadioFilter filter(learnt_map());
  Walker walker(filter, building, 1, 10.0, 14.0);
  walker.walk(8, 0.0);
  ASSERT_TRUE(filter.estimate().is_valid());
  EXPECT_EQ(filter.estimate().level, 1);
  EXPECT_LT(walker.error_m(), 3.0);
}

TEST(RadioFilter, StandsStillWithTheWalker) {
  const Building building;
  RadioFilter filter(learnt_map());
  Walker walker(filter, building, 0, 30.0, 14.0);
  walker.stand(30);
  EXPECT_TRUE(filter.estimate().is_valid());
  EXPECT_LT(walker.error_m(), 3.0);
}

TEST(RadioFilter, LearnsAWrongCompass) {
  const Building building;
  RadioFilter filter(learnt_map());
  Walker walker(filter, building, 0, 5.0, 10.0);
  walker.walk(3, 0.0);
  for (int i = 0; i < 12; ++i) {
    filter.step({milliseconds(0), 0.0, 0.0, 0.0, 0.1});
  }
  walker.walk(12, 0.25);
  EXPECT_LT(walker.error_m(), 4.0);
}

TEST(RadioFilter, LearnsTheOffsetOfAnotherPhone) {
  const Building building;
  RadioFilter filter(learnt_map());
  Random random(5);
  for (int t_ms = 0; t_ms < 60'000; t_ms += 2000) {
    building.sweep(0, 30.0, 14.0, random, [&](const std::string& id, double rssi_dbm) {
      filter.signal(milliseconds(t_ms), {id, Radio::WiFi, rssi_dbm - 7.0, milliseconds(t_ms)});
    });
    filter.advance(milliseconds(t_ms + 500));
  }
  EXPECT_NEAR(filter.receiver_offset_db(), -7.0, 2.5);
}

TEST(RadioFilter, FindsAWalkerAgainWhoWasCarriedToAnotherLevel) {
  const Building building;
  RadioFilter filter(learnt_map());
  Walker walker(filter, building, 0, 5.0, 6.0);
  walker.stand(10);
  ASSERT_EQ(filter.estimate().level, 0);
  walker.carry_to(1, 55.0, 26.0);
  walker.stand(6);
  EXPECT_EQ(filter.estimate().level, 1);
  EXPECT_LT(walker.error_m(), 4.0);
}

Building with_thin_ceiling() {
  Building building;
  building.ceiling_db = 12.0;
  return building;
}

/// From 14 m to 46 m one walk went on level 0, with a phone that listed only what it heard well; on level 1 many went.
std::shared_ptr<const RadioMap> map_with_a_gap() {
  const Building building = with_thin_ceiling();
  RadioMapLearner learner;
  Random random(7);
  for (int level = 0; level < 2; ++level) {
    for (double y_m = 2.0; y_m < 30.0; y_m += 4.0) {
      learner.begin_walk();
      for (double x_m = 0.0; x_m <= 60.0; x_m += 1.0) {
        const bool gap = level == 0 && x_m > 14.0 && x_m < 46.0;
        if (gap && y_m != 14.0) continue;
        learner.path(level, x_m, y_m);
        learner.sweep(Radio::WiFi, level, x_m, y_m);
        building.sweep(level, x_m, y_m, random, [&](const std::string& id, double rssi_dbm) {
          if (!gap || rssi_dbm > -60.0) learner.heard(id, Radio::WiFi, level, x_m, y_m, rssi_dbm);
        });
      }
    }
  }
  return std::make_shared<const RadioMap>(learner.learn("gap"));
}

TEST(RadioFilter, KnowsTheLevelWhereItsSurveyHasAGap) {
  const Building building = with_thin_ceiling();
  const auto map = map_with_a_gap();
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    RadioFilter filter(map);
    Walker(filter, building, 0, 26.0, 14.0, seed).walk(3, 0.0);
    ASSERT_TRUE(filter.estimate().is_valid()) << seed;
    EXPECT_EQ(filter.estimate().level, 0) << seed;
    EXPECT_GT(filter.estimate().level_probability, 0.8) << seed;
  }
}

TEST(RadioFilter, KnowsTheLevelAboveTheGapToo) {
  const Building building = with_thin_ceiling();
  const auto map = map_with_a_gap();
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    RadioFilter filter(map);
    Walker walker(filter, building, 1, 26.0, 14.0, seed);
    walker.walk(3, 0.0);
    EXPECT_EQ(filter.estimate().level, 1) << seed;
    EXPECT_LT(walker.error_m(), 6.0) << seed;
  }
}

TEST(LevelTracker, WeighsEvidenceByBayesRule) {
  LevelTracker tracker(2);
  tracker.observe(0.0, std::vector{std::log(3.0), 0.0});
  EXPECT_NEAR(tracker.probability()[0], 0.75, 1e-12);
  tracker.observe(0.0, std::vector{std::log(3.0), 0.0});
  EXPECT_NEAR(tracker.probability()[0], 0.9, 1e-12);
  EXPECT_EQ(tracker.best(), 0u);
}

TEST(LevelTracker, AMoveBetweenLevelsForgetsWhatCameBefore) {
  LevelTracker tracker(4);
  for (int i = 0; i < 1000; ++i) tracker.observe(0.0, std::vector{5.0, 0.0, 0.0, 0.0});
  tracker.observe(1.0, std::vector{0.0, 0.0, 0.0, std::log(2.0)});
  EXPECT_NEAR(tracker.probability()[3], 0.4, 1e-12);
  EXPECT_NEAR(tracker.probability()[0], 0.2, 1e-12);
}

TEST(LevelTracker, LongCertaintyDoesNotKeepItFromAnotherLevel) {
  LevelTracker tracker(2);
  for (int i = 0; i < 1000; ++i) tracker.observe(1e-3, std::vector{20.0, 0.0});
  for (int i = 0; i < 3; ++i) tracker.observe(1e-3, std::vector{0.0, 5.0});
  EXPECT_EQ(tracker.best(), 1u);
}

TEST(LevelTracker, ALevelWithoutCellsIsNeverTheBest) {
  LevelTracker tracker(2);
  for (int i = 0; i < 3; ++i) tracker.observe(0.1, std::vector{-std::numeric_limits<double>::infinity(), -1000.0});
  EXPECT_EQ(tracker.best(), 1u);
  EXPECT_EQ(tracker.probability()[1], 1.0);
}

/// What one row says of both levels that exceeds by so much the strongest expectation on one of them.
std::vector<double> excess(const RadioMap& map, double above_strongest_db, std::size_t level_index) {
  const std::uint32_t number = *map.find("aa0055");
  const double rssi_dbm = map.transmitters[number].spans.at(level_index).strongest_dbm + above_strongest_db;
  const HeardRow row{number, static_cast<float>(rssi_dbm), 1.0f};
  std::vector<double> levels(map.levels.size(), 0.0);
  RadioLikelihood(map).add_excess({&row, 1}, 0.0, levels);
  return levels;
}

TEST(RadioLikelihood, ARowSpeaksAgainstALevelThatNowhereExpectsItSoStrong) {
  const auto levels = excess(*learnt_map(), 12.0, 1);  // two standard deviations
  EXPECT_NEAR(levels[1] - levels[0], -2.0, 0.1);
}

TEST(RadioLikelihood, ARowThatBothLevelsExpectSomewhereDoesNotTellThemApart) {
  const auto levels = excess(*learnt_map(), -5.0, 1);
  EXPECT_DOUBLE_EQ(levels[0], levels[1]);
}

TEST(RadioLikelihood, OneImpossiblyStrongRowIsAnOutlierNotAProof) {
  const LikelihoodOptions options;
  const double outlier = options.outlier_density * options.sd_db * std::sqrt(2.0 * std::numbers::pi);
  EXPECT_NEAR(excess(*learnt_map(), 100.0, 0)[1], std::log(outlier), 1e-6);
}

TEST(RadioLikelihood, TheMeanOverALevelIsOfLikelihoodsNotOfTheirLogarithms) {
  const auto& map = *learnt_map();
  std::vector<float> field(map.cells.size(), -1e4f);
  field[map.levels[0].first_cell] = 3.0f;
  std::fill(field.begin() + map.levels[1].first_cell, field.end(), 2.0f);
  const auto means = RadioLikelihood(map).log_mean_by_level(field);
  EXPECT_NEAR(means[0], 3.0 - std::log(map.levels[0].cell_count), 1e-6);
  EXPECT_NEAR(means[1], 2.0, 1e-6);
}

TEST(RadioFilter, SaysWhenTheMapIsOfAnotherBuilding) {
  const Building elsewhere("bb00");
  RadioFilter filter(learnt_map());
  Walker walker(filter, elsewhere, 0, 30.0, 14.0);
  walker.stand(5);
  EXPECT_EQ(filter.estimate().validity, Validity::ForeignBuilding);
  EXPECT_EQ(filter.estimate().known_share, 0.0);
}

TEST(RadioFilter, SaysWhenTheWalkerHasLeftTheBuilding) {
  const Building building, elsewhere("bb00");
  RadioFilter filter(learnt_map());
  Walker(filter, building, 0, 30.0, 14.0).stand(10);
  ASSERT_TRUE(filter.estimate().is_valid());
  for (int t_ms = 60'000; t_ms < 200'000; t_ms += 2000) {
    for (const auto& mast : elsewhere.masts) {
      filter.signal(milliseconds(t_ms), {mast.id, Radio::WiFi, -60.0, milliseconds(t_ms)});
    }
    filter.advance(milliseconds(t_ms + 500));
  }
  EXPECT_FALSE(filter.estimate().is_valid());
}

TEST(RadioFilter, ForgottenByAllTransmittersItsDoubtGrowsUntilItIsSilent) {
  const Building building;
  RadioFilter filter(learnt_map());
  Walker(filter, building, 0, 30.0, 14.0).stand(10);
  const double before = filter.estimate().covariance.trace();
  for (int t_s = 60; t_s < 120; ++t_s) filter.advance(milliseconds(1000 * t_s));
  EXPECT_GT(filter.estimate().covariance.trace(), before);
  for (int t_s = 120; t_s < 3000; ++t_s) filter.advance(milliseconds(1000 * t_s));
  EXPECT_FALSE(filter.estimate().is_valid());
}

TEST(RadioFilter, ARowToldTwiceCountsOnce) {
  const auto answer = [](int times) {
    const Building building;
    RadioFilter filter(learnt_map());
    Random random(5);
    for (int i = 0; i < times; ++i) {
      Random same = random;
      building.sweep(0, 30.0, 14.0, same, [&](const std::string& id, double rssi_dbm) {
        filter.signal(milliseconds(1000), {id, Radio::WiFi, rssi_dbm, milliseconds(500)});
      });
    }
    filter.advance(milliseconds(3000));
    return filter.estimate();
  };
  EXPECT_EQ(answer(1).x_m, answer(3).x_m);
  EXPECT_EQ(answer(1).covariance, answer(3).covariance);
}

TEST(RadioFilter, ARowHeardTooLongAgoIsNoEvidence) {
  RadioFilter filter(learnt_map());
  for (const auto& mast : Building().masts) {
    filter.signal(milliseconds(60'000), {mast.id, Radio::WiFi, -60.0, milliseconds(30'000)});
  }
  filter.advance(milliseconds(61'000));
  EXPECT_EQ(filter.estimate().validity, Validity::NoEvidence);
}

TEST(RadioFilter, TheSameSeedGivesTheSameAnswer) {
  const auto answer = [](std::uint64_t seed) {
    const Building building;
    FilterOptions options;
    options.seed = seed;
    RadioFilter filter(learnt_map(), options);
    Walker(filter, building, 0, 10.0, 10.0).walk(10, 0.1);
    return filter.estimate().x_m;
  };
  EXPECT_EQ(answer(4), answer(4));
  EXPECT_NE(answer(4), answer(5));
}

TEST(RadioFilter, TheTruthLiesInTheRegionItClaims) {
  const Building building;
  int inside = 0, all = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    FilterOptions options;
    options.seed = seed;
    RadioFilter filter(learnt_map(), options);
    const double x_m = 5.0 + static_cast<double>(seed), y_m = 14.0;
    Walker(filter, building, 0, x_m, y_m, seed).stand(5);
    const Estimate at = filter.estimate();
    const Eigen::Vector2d error(at.x_m - x_m, at.y_m - y_m);
    inside += error.dot(at.covariance.inverse() * error) < 5.99;
    ++all;
  }
  EXPECT_GE(inside, 0.9 * all);
}

/// The component over the learnt map, with Wi-Fi heard in one place.
class RadioLocalisationComponent : public ::testing::Test {
 protected:
  RadioLocalisationComponent() {
    save(*learnt_map(), folder_.path / "hall.radiomap");
    bench_.set("map", (folder_.path / "hall.radiomap").string());
    bench_.start();
  }
  /// A second in which a sweep is heard, by a scanner whose clock is so far off.
  void hear(milliseconds off = {}) {
    building_.sweep(0, 30.0, 14.0, random_, [&](const std::string& id, double rssi_dbm) {
      sensors::RFSignalRSSI signal;
      signal.set_transmitter_id(id), signal.set_rf_type("WiFi"), signal.set_rss(static_cast<float>(rssi_dbm));
      signal.set_t(to_milliseconds(bench_.now()) + off.count());
      bench_.put<sensors::RFSignalRSSIService>("wifi", signal);
    });
    bench_.advance(milliseconds(1000));
  }
  void step(milliseconds off = {}) {
    localisation::CommStep step;
    step.set_is_valid(true), step.set_length(0.05);
    step.set_t_end(to_milliseconds(bench_.now()) + off.count());
    bench_.put<localisation::StepProvider>("steps", step);
  }
  localisation::CommLocation location() {
    const auto all = bench_.take<localisation::LocationProvider>("location");
    return all.empty() ? localisation::CommLocation() : *all.back();
  }

  tests::TemporaryDirectory folder_;
  Building building_;
  Random random_{5};
  fiona::testing::Bench<radio_localisation::RadioLocalisation> bench_{"radio"};
};

TEST_F(RadioLocalisationComponent, TheClockOfWhoListensIsNotItsOwn) {
  const milliseconds hour(3'600'000);
  bench_.advance(2 * hour);  // no step is of a time below zero
  for (const milliseconds off : {-hour, hour, -hour}) {
    for (int i = 0; i < 10; ++i) {
      step(off), step(off + milliseconds(1));
      hear(off);
    }
    const auto told = location();
    ASSERT_TRUE(told.is_valid()) << off.count();
    EXPECT_NEAR(told.position().x(), 30, 6.0);
    EXPECT_NEAR(told.position().y(), 14, 6.0);
  }
  EXPECT_EQ(bench_.probe<std::uint64_t>("old_rows").value_or(0), 0u);
}

TEST_F(RadioLocalisationComponent, WhatIsReadAtTheStartIsFixedThen) {
  for (const auto& change :
       {std::function<void()>([&] { bench_.set("map", "other.radiomap"); }), {[&] { bench_.set("particles", 300); }}}) {
    try {
      change();
      FAIL() << "no error";
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("are read when the instance starts"));
      EXPECT_THAT(error.what(), HasSubstr("load another instance with map="));
    }
  }
}

TEST_F(RadioLocalisationComponent, ABeaconThatListsRepeatIsHeardOnce) {
  sensors::CommiBeaconList list;
  auto& beacon = *list.add_beacon_list();
  beacon.set_address("aa:bb:cc:dd:ee:01"), beacon.set_rssi(-60);
  const auto tell = [&](int times, int between_ms) {
    for (int i = 0; i < times; ++i) {
      beacon.set_t(beacon.t() + between_ms);
      bench_.put<sensors::IbeaconlistProvider>("beacons", list);
      bench_.advance(milliseconds(300));
    }
    return bench_.probe<std::string>("validity");
  };
  EXPECT_EQ(tell(30, 0), "nothing heard yet");
  EXPECT_EQ(tell(30, 300), "another building");
}

TEST_F(RadioLocalisationComponent, WithoutStepsThePositionIsLostSooner) {
  const auto grown_m2 = [&](bool steps) {
    const auto end = dynamic_cast<RequiredPort&>(*bench_.hull().find_port("steps")).end_for("bench");
    end->set_connection(steps ? Connection::Connected : Connection::Unwired, "on the bench");
    for (int i = 0; i < 10; ++i) hear();
    const double before_m2 = location().position().confidence(0);
    for (int i = 0; i < 20; ++i) bench_.advance(milliseconds(1000));
    return location().position().confidence(0) - before_m2;
  };
  const double with_steps_m2 = grown_m2(true), without_m2 = grown_m2(false);
  EXPECT_GT(without_m2, 2.0 * with_steps_m2);
}

/// Fixes whose errors have the covariance factor * spread + floor^2, with spreads of 1 to 25 m^2.
std::vector<LeftOutFix> drawn_fixes(double factor, double floor_m, std::size_t other_walks, std::uint64_t seed) {
  Random random(seed);
  std::vector<LeftOutFix> fixes;
  for (int i = 0; i < 4000; ++i) {
    const double variance = 1.0 + 24.0 * random.uniform();
    const double sd = std::sqrt(factor * variance + floor_m * floor_m);
    fixes.push_back(
        {{sd * random.normal(), sd * random.normal()}, variance * Eigen::Matrix2d::Identity(), other_walks});
  }
  return fixes;
}

TEST(Accuracy, TheSizeOfTheErrorsIsFound) {
  for (const Accuracy truth : {Accuracy{4.0, 0.0}, Accuracy{0.5, 0.0}, Accuracy{1.0, 5.0}}) {
    const Accuracy found = fit_accuracy(drawn_fixes(truth.covariance_factor, truth.covariance_floor_m, 5, 1));
    const auto variance = [](const Accuracy& a) {
      return 13.0 * a.covariance_factor + a.covariance_floor_m * a.covariance_floor_m;
    };
    EXPECT_NEAR(variance(found) / variance(truth), 1.0, 0.12) << truth.covariance_factor;
  }
}

TEST(Accuracy, PlacesThatOnlyOneOtherWalkSurveyedAreNotJudgedWhereThereAreBetterOnes) {
  auto fixes = drawn_fixes(1.0, 0.0, 3, 1);
  const Accuracy alone = fit_accuracy(fixes);
  const auto wild = drawn_fixes(100.0, 0.0, 1, 2);
  fixes.insert(fixes.end(), wild.begin(), wild.end());
  EXPECT_EQ(fit_accuracy(fixes).covariance_factor, alone.covariance_factor);
  EXPECT_GT(fit_accuracy(wild).covariance_factor * 13.0, 50.0 * 13.0 * alone.covariance_factor);
}

TEST(Accuracy, TooFewFixesGiveTheCarefulDefault) {
  auto fixes = drawn_fixes(0.1, 0.0, 5, 1);
  fixes.resize(50);
  EXPECT_EQ(fit_accuracy(fixes).covariance_factor, Accuracy{}.covariance_factor);
  EXPECT_EQ(fit_accuracy({}).covariance_floor_m, Accuracy{}.covariance_floor_m);
}

/// A survey walk eastwards at 1 m/s, with a sweep every two seconds.
Journey survey_journey(const Building& building, int level, double y_m, std::uint64_t seed) {
  Random random(seed);
  Journey journey;
  for (const auto& mast : building.masts) journey.transmitters.push_back(mast.id);
  for (int t_s = 1; t_s <= 60; ++t_s) {
    const milliseconds time(1000 * t_s);
    journey.told.push_back({time, StepInput{time, 1.0, 0.15, 0.0, 0.1}});
    if (t_s % 2 != 0) continue;
    for (std::uint32_t i = 0; i < building.masts.size(); ++i) {
      const double rssi = building.rssi_dbm(building.masts[i], level, t_s, y_m) + 4.0 * random.normal();
      if (rssi > -85.0) journey.told.push_back({time, Journey::Row{i, Radio::WiFi, static_cast<float>(rssi), time}});
    }
  }
  journey.way_points = {{0, {0.0, y_m, level}}, {60'000, {60.0, y_m, level}}};
  journey.end = milliseconds(60'000);
  journey.has_steps = true;
  return journey;
}

TEST(Accuracy, OfABuildingIsMeasuredOnItsOwnSurveyWalks) {
  const Building building;
  RadioMapLearner learner;
  std::vector<SurveyedJourney> journeys;
  for (std::uint64_t walk = 0; walk < 24; ++walk) {
    const int level = static_cast<int>(walk % 2);
    const double y_m = 2.0 + static_cast<double>(walk);
    const std::uint32_t number = learner.begin_walk();
    const Journey journey = survey_journey(building, level, y_m, walk);
    for (const auto& told : journey.told) {
      const double x_m = static_cast<double>(told.time.count()) / 1000.0;
      learner.path(level, x_m, y_m);
      if (const auto* row = std::get_if<Journey::Row>(&told.what)) {
        learner.heard(journey.transmitters[row->transmitter], Radio::WiFi, level, x_m, y_m, row->rssi_dbm);
      } else if (static_cast<int>(x_m) % 2 == 0) {
        learner.sweep(Radio::WiFi, level, x_m, y_m);
      }
    }
    journeys.push_back({number, journey});
  }
  const auto fixes = left_out_fixes(learner, journeys);
  ASSERT_GT(fixes.size(), 1000u);
  auto map = learner.learn("hall");
  map.accuracy = fit_accuracy(fixes);
  EXPECT_LT(map.accuracy.covariance_factor * 2.0 + std::pow(map.accuracy.covariance_floor_m, 2), 10.0);

  const auto shared = std::make_shared<const RadioMap>(std::move(map));
  int inside = 0, all = 0;
  for (std::uint64_t walk = 0; walk < 12; ++walk) {
    const double y_m = 3.5 + 2.0 * static_cast<double>(walk);
    RadioFilter filter(shared);
    replay(survey_journey(building, 0, y_m, 100 + walk), filter, milliseconds(1000), [&](Time time) {
      const Estimate at = filter.estimate();
      if (!at.is_valid()) return;
      const Eigen::Vector2d error(at.x_m - static_cast<double>(time.count()) / 1000.0, at.y_m - y_m);
      inside += error.dot(at.covariance.inverse() * error) < 5.991;
      ++all;
    });
  }
  EXPECT_GT(all, 600);
  EXPECT_GE(inside, 0.88 * all);
}

}  // namespace
}  // namespace fiona::radio
