#include "centroid_localisation.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include <fiona/error.hpp>
#include <fiona/testing/bench.hpp>

namespace {

using namespace std::chrono_literals;
using Bench = fiona::testing::Bench<acme::centroid_localisation::CentroidLocalisation>;
using fiona::localisation::CommLocation;

/// Two beacons on the ground, one above them.
std::string file_of_three() {
  const std::string file = ::testing::TempDir() + "three.beacons";
  std::ofstream(file)
      << "name: 'hall'\n"
         "beacons { id: 'aa/1/1' x: 0 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
         "beacons { id: 'aa/1/2' x: 10 y: 0 heard { level: 0 power: -59 } heard { level: 1 power: -75 } }\n"
         "beacons { id: 'aa/1/3' x: 5 y: 8 heard { level: 1 power: -59 } }\n";
  return file;
}

void hear(Bench& bench, std::initializer_list<std::pair<unsigned, int>> readings) {
  fiona::sensors::CommiBeaconList list;
  for (const auto& [minor, rssi_dbm] : readings) {
    auto& beacon = *list.add_beacon_list();
    beacon.set_uuid("aa");
    beacon.set_major(1);
    beacon.set_minor(minor);
    beacon.set_rssi(rssi_dbm);
  }
  bench.put<fiona::sensors::IbeaconlistProvider>("beacons", std::move(list));
}

CommLocation last(Bench& bench) {
  bench.advance(400ms);
  return *bench.take<fiona::localisation::LocationProvider>("location").back();
}

TEST(CentroidLocalisation, IsBetweenWhatIsHeardAndNearerToTheStronger) {
  Bench bench;
  bench.set("beacons", file_of_three());
  bench.start();
  hear(bench, {{1, -65}, {2, -65}});
  EXPECT_NEAR(last(bench).position().x(), 5.0, 1e-6);
  hear(bench, {{1, -65}, {2, -75}});
  const CommLocation location = last(bench);
  ASSERT_TRUE(location.is_valid());
  EXPECT_LT(location.position().x(), 4.0);
  EXPECT_EQ(location.position().z(), 0.0);
  EXPECT_GE(location.position().confidence(0), 9.0);
}

TEST(CentroidLocalisation, IsOnTheLevelWhoseBeaconsAreHeardBest) {
  Bench bench;
  bench.set("beacons", file_of_three());
  bench.start();
  hear(bench, {{1, -85}, {2, -85}, {3, -62}});
  EXPECT_EQ(last(bench).position().z(), 1.0);
}

TEST(CentroidLocalisation, IsNotValidWhereNothingWasHeardForTheWindow) {
  Bench bench;
  bench.set("beacons", file_of_three());
  bench.start();
  EXPECT_FALSE(last(bench).is_valid());
  hear(bench, {{1, -65}, {7, -40}});
  EXPECT_TRUE(last(bench).is_valid());
  EXPECT_EQ(bench.probe<std::uint64_t>("heard"), 1U) << "the other one is not in the file";
  bench.advance(2s);
  EXPECT_FALSE(last(bench).is_valid());
}

TEST(CentroidLocalisation, AnAddressIsTheSameHoweverTheFileWritesIt) {
  for (const char* id : {"02:00:5e:10:00:01", "02005E100001"}) {
    const std::string file = ::testing::TempDir() + "address.beacons";
    std::ofstream(file) << "beacons { id: '" << id << "' x: 3 y: 4 heard { level: 0 power: -59 } }\n";
    Bench bench;
    bench.set("beacons", file);
    bench.start();
    fiona::sensors::CommiBeaconList list;
    auto& beacon = *list.add_beacon_list();
    beacon.set_address("02:00:5e:10:00:01");
    beacon.set_rssi(-65);
    bench.put<fiona::sensors::IbeaconlistProvider>("beacons", std::move(list));
    EXPECT_TRUE(last(bench).is_valid()) << id;
  }
}

TEST(CentroidLocalisation, AFileThatIsNoneIsNamedWithLineAndColumn) {
  const std::string file = ::testing::TempDir() + "broken.beacons";
  std::ofstream(file) << "beacons {\n  id: 7\n}\n";
  Bench bench;
  bench.set("beacons", file);
  try {
    bench.start();
    FAIL() << "it was read";
  } catch (const fiona::Error& error) {
    EXPECT_EQ(error.text().where, file);
    EXPECT_EQ(error.text().found.substr(0, 4), "2:7:");
  }
}

}  // namespace
