#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>

#include "radio_filter.hpp"
#include "radio_map_file.hpp"
#include "radio_map_learner.hpp"

namespace fiona::radio {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using std::chrono::milliseconds;

/// A building of two levels, 60 m x 30 m, with a transmitter every 10 m on each.
struct Building {
  struct Mast {
    std::string id;
    double x_m, y_m;
    int level;
  };
  std::vector<Mast> masts;

  explicit Building(const std::string& prefix = "aa00") {
    for (int level = 0; level < 2; ++level) {
      for (int x = 5; x < 60; x += 10) {
        for (int y = 5; y < 30; y += 10) {
          masts.push_back({prefix + std::to_string(1000 * level + 10 * x + y), double(x), double(y), level});
        }
      }
    }
  }

  /// Log-distance path loss, a ceiling of 18 dB, and nothing below -85 dBm.
  static double rssi_dbm(const Mast& mast, int level, double x_m, double y_m) {
    const double distance_m = std::hypot(mast.x_m - x_m, mast.y_m - y_m, 2.0);
    return -38.0 - 30.0 * std::log10(distance_m) - 18.0 * std::abs(mast.level - level);
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

class Folder {
 public:
  Folder() {
    std::string pattern = (fs::temp_directory_path() / "radio-map-XXXXXX").string();
    path = mkdtemp(pattern.data());
  }
  ~Folder() { fs::remove_all(path); }
  fs::path path;
};

std::string bytes_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// The error that loading these bytes gives.
Error error_of(const std::string& bytes) {
  const Folder folder;
  std::ofstream(folder.path / "hall.radiomap", std::ios::binary) << bytes;
  try {
    load(folder.path / "hall.radiomap");
  } catch (const Error& error) {
    return error;
  }
  return Error(ErrorCode::Usage, "no error");
}

std::string saved_map() {
  const Folder folder;
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

TEST(RadioMap, NothingHeardIsNoMap) {
  try {
    RadioMapLearner().learn("empty");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("no radio map can be learnt"));
  }
}

TEST(RadioMapFile, AMapComesBackAsItWasSaved) {
  const Folder folder;
  RadioMap map = *learnt_map();
  map.reference = Reference{49.4611419, 11.1109429};
  save(map, folder.path / "a");
  const RadioMap back = load(folder.path / "a");
  save(back, folder.path / "b");
  EXPECT_EQ(bytes_of(folder.path / "a"), bytes_of(folder.path / "b"));
  EXPECT_EQ(back.name, "hall");
  EXPECT_DOUBLE_EQ(back.reference->longitude_deg, 11.1109429);
  EXPECT_EQ(back.transmitters.size(), map.transmitters.size());
  EXPECT_EQ(back.cell_at(1, 20.0, 10.0), map.cell_at(1, 20.0, 10.0));
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
  EXPECT_EQ(error.text().expected, "version 1");
  EXPECT_EQ(error.text().found, "version 9");
}

TEST(RadioMapFile, AnotherKindOfFileIsTold) {
  EXPECT_THAT(error_of("#!/bin/sh\necho this is not a radio map at all\n").what(), HasSubstr("another kind of file"));
}

TEST(RadioMapFile, AMissingFileIsNotFound) {
  const Folder folder;
  try {
    load(folder.path / "none");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_THAT(error.text().next, HasSubstr("fiona-radiomap learn"));
  }
}

TEST(RadioMapFile, AFolderThatDoesNotExistIsToldBeforeAnythingIsLost) {
  const Folder folder;
  EXPECT_THROW(save(*learnt_map(), folder.path / "none" / "hall"), Error);
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

}  // namespace
}  // namespace fiona::radio
