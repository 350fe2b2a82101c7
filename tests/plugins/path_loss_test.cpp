// How far away beacons are, and how sure that is.
#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "fiona/params.hpp"
#include "fiona/smart_bluetooth_beacon_server/params.pb.h"
#include "path_loss.hpp"

namespace fiona::beacon_server {
namespace {

using Pairs = std::vector<std::pair<double, double>>;

PathLoss shipped(double gain_db = 0.0) {
  smart_bluetooth_beacon_server::SmartBluetoothBeaconServerParams defaults;
  set_declared_defaults(defaults);
  return {defaults.path_loss_exponent(), defaults.path_loss_spread(), gain_db};
}

/// Of the true distances, the share that lies within the factor, taken `times` times, of what is said.
double share_within(const Pairs& truths, const PathLoss& loss, int times) {
  const double most = std::pow(distance_factor(loss), times);
  int within = 0;
  for (const auto& [metres, loss_db] : truths) {
    const double said_m = distance_m(0.0, -loss_db, loss);
    if (metres <= said_m * most && metres >= said_m / most) ++within;
  }
  return within / static_cast<double>(truths.size());
}

TEST(PathLoss, AtItsMeasuredPowerABeaconIsOneMetreAway) {
  EXPECT_DOUBLE_EQ(distance_m(-59, -59, {2.0, 4.0}), 1.0);
  EXPECT_DOUBLE_EQ(distance_m(-59, -79, {2.0, 4.0}), 10.0);
}

TEST(PathLoss, WhatAReceiverHearsBeyondTheMeasuredPowerIsTakenOff) {
  EXPECT_DOUBLE_EQ(distance_m(-59, -65, {2.0, 4.0, 14.0}), 10.0);
}

TEST(PathLoss, TheSpreadIsAFactorToBothSides) { EXPECT_NEAR(distance_factor({2.0, 6.0}), std::pow(10.0, 0.3), 1e-12); }

TEST(PathLoss, TheTruthIsWithinTheFactorAsOftenAsItSays) {
  std::mt19937 random(7);
  std::normal_distribution<double> fading(0.0, shipped().spread_db);
  std::uniform_real_distribution<double> decades(0.0, 1.5);
  Pairs truths;
  for (int i = 0; i < 100'000; ++i) {
    const double x = decades(random);
    truths.emplace_back(std::pow(10.0, x), 10.0 * shipped().exponent * x + fading(random));
  }
  EXPECT_NEAR(share_within(truths, shipped(), 1), 0.683, 0.005);
  EXPECT_NEAR(share_within(truths, shipped(), 2), 0.954, 0.005);
}

TEST(PathLoss, AFitFindsExponentSpreadAndGain) {
  Pairs pairs;
  for (int i = 1; i <= 200; ++i)
    pairs.emplace_back(0.2 * i, 27.0 * std::log10(0.2 * i) - 5.0 + (i % 2 == 0 ? 4.0 : -4.0));
  const auto loss = fit(pairs);
  ASSERT_TRUE(loss);
  EXPECT_NEAR(loss->exponent, 2.7, 0.1);
  EXPECT_NEAR(loss->spread_db, 4.0, 0.1);
  EXPECT_NEAR(loss->gain_db, 5.0, 0.5);
}

TEST(PathLoss, ReadingsAtOneDistanceCannotBeFitted) { EXPECT_FALSE(fit(Pairs(5, {3.7, 20.0}))); }

TEST(PathLoss, LessThanThreeReadingsCannotBeFitted) { EXPECT_FALSE(fit(Pairs{{1.0, 0.0}, {10.0, 20.0}})); }

TEST(PathLoss, ADistanceThatIsNoneCannotBeFitted) {
  for (const double metres : {0.0, -1.0, std::nan("")}) {
    EXPECT_FALSE(fit(Pairs{{1.0, 0.0}, {10.0, 20.0}, {metres, 20.0}})) << metres;
  }
}

// ---- a library -----------------------------------------------------------------------------------------------

using Row = std::map<std::string, std::string>;

/// Of a file with commas, compressed or not.
std::vector<Row> rows_of(const std::filesystem::path& file) {
  std::string text;
  const gzFile packed = ::gzopen(file.c_str(), "rb");
  char block[4096];
  for (int size; packed && (size = ::gzread(packed, block, sizeof block)) > 0;) text.append(block, size);
  ::gzclose(packed);
  std::istringstream lines(text);
  std::string line, cell;
  std::vector<std::string> names;
  std::vector<Row> rows;
  while (std::getline(lines, line)) {
    std::istringstream cells(line);
    if (names.empty()) {
      while (std::getline(cells, cell, ',')) names.push_back(cell);
      continue;
    }
    rows.emplace_back();
    for (std::size_t i = 0; std::getline(cells, cell, ','); ++i) rows.back()[names.at(i)] = cell;
  }
  return rows;
}

/// uji_ble_library: three phones among the shelves of a library (Mendoza-Silva et al., doi 10.3390/data4010012). What
/// its beacons say of their power is not told: it goes into the gain of each phone. Nor is how high they hang: a metre
/// above or below the phone, as beacon maps have it, which leaves less spread than any other height.
class ALibrary : public ::testing::Test {
 protected:
  static constexpr double kAbove_m = 1.0;

  void SetUp() override {
    const char* data = std::getenv("FIONA_DATA");
    folder_ = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "uji_ble_library";
    if (!std::filesystem::exists(folder_)) GTEST_SKIP() << "no readings at " << folder_ << ": set FIONA_DATA";
    beacons_ = rows_of(folder_ / "dep.csv");
  }

  /// By phone.
  std::map<char, Pairs> survey() const {
    std::map<char, Pairs> phones;
    for (const Row& row : rows_of(folder_ / "train.csv.gz")) add(row, row, phones);
    return phones;
  }
  /// In places where the survey was not.
  std::map<char, Pairs> elsewhere() const {
    std::map<std::string, Row> places;
    for (const Row& row : rows_of(folder_ / "truth.csv")) places[row.at("id")] = row;
    std::map<char, Pairs> phones;
    for (const Row& row : rows_of(folder_ / "queries.csv.gz")) add(row, places.at(row.at("id")), phones);
    return phones;
  }

 private:
  void add(const Row& row, const Row& place, std::map<char, Pairs>& phones) const {
    for (std::size_t i = 0; i < beacons_.size(); ++i) {
      const auto heard = row.find("b" + std::to_string(i + 1));
      if (heard == row.end() || heard->second.empty()) continue;
      const auto off = [&](const char* axis) { return std::stod(place.at(axis)) - std::stod(beacons_[i].at(axis)); };
      phones[row.at("ids_code").at(0)].emplace_back(std::hypot(off("x"), off("y"), kAbove_m),
                                                    -std::stod(heard->second));
    }
  }

  std::filesystem::path folder_;
  std::vector<Row> beacons_;
};

TEST_F(ALibrary, GivesTheDefaultsThatAreShipped) {
  const auto phones = survey();
  ASSERT_EQ(phones.size(), 3u);
  double exponent = 0.0, spread_db = 0.0;
  for (const auto& [phone, pairs] : phones) {
    const auto loss = fit(pairs);
    ASSERT_TRUE(loss) << phone;
    exponent += loss->exponent / 3.0;
    spread_db += loss->spread_db / 3.0;
  }
  EXPECT_NEAR(shipped().exponent, exponent, 0.05);
  EXPECT_NEAR(shipped().spread_db, spread_db, 0.05);
}

TEST_F(ALibrary, HasTheTruthWithinTheFactorAsOftenAsItSays) {
  const auto phones = survey();
  double once = 0.0, twice = 0.0;
  for (const auto& [phone, pairs] : elsewhere()) {
    // Gain and exponent go together: with an exponent that is given, the gain is what the mean leaves.
    double gain_db = 0.0;
    for (const auto& [metres, loss_db] : phones.at(phone))
      gain_db +=
          (10.0 * shipped().exponent * std::log10(metres) - loss_db) / static_cast<double>(phones.at(phone).size());
    once += share_within(pairs, shipped(gain_db), 1) / 3.0;
    twice += share_within(pairs, shipped(gain_db), 2) / 3.0;
  }
  EXPECT_NEAR(once, 0.68, 0.03);
  EXPECT_NEAR(twice, 0.95, 0.02);
}

}  // namespace
}  // namespace fiona::beacon_server
