// Which beacons are near, made of single readings.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "heard_beacons.hpp"

namespace fiona::beacon_server {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;

constexpr PathLoss kLoss{2.0, 4.0};
constexpr const char* kOne = "aa:bb:cc:dd:ee:01";
constexpr const char* kOther = "aa:bb:cc:dd:ee:02";

class HeardBeaconsTest : public ::testing::Test {
 protected:
  using Time = HeardBeacons::Time;

  void hear(int rssi_dbm, Time at, const std::string& address = kOne) {
    heard_.hear({address, Identity{"11111111-2222-3333-4444-555555555555", 1, 258, -59}, rssi_dbm, at});
  }
  std::vector<sensors::CommiBeacon> list(Time now) {
    const auto told = heard_.list(now, 1s, kLoss);
    return {told.beacon_list().begin(), told.beacon_list().end()};
  }
  std::vector<std::string> addresses(Time now) {
    std::vector<std::string> all;
    for (const auto& beacon : list(now)) all.push_back(beacon.address());
    return all;
  }

  HeardBeacons heard_;
  const Time begin_{1'700'000'000s};
};

TEST_F(HeardBeaconsTest, NothingHeardIsAnEmptyList) { EXPECT_TRUE(list(begin_).empty()); }

TEST_F(HeardBeaconsTest, ABeaconIsToldWithWhatItSaysOfItself) {
  hear(-70, begin_ + 123ms);
  const auto told = list(begin_ + 200ms);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0].uuid(), "11111111-2222-3333-4444-555555555555");
  EXPECT_EQ(told[0].major(), 1u);
  EXPECT_EQ(told[0].minor(), 258u);
  EXPECT_EQ(told[0].measured_power(), -59);
  EXPECT_EQ(told[0].address(), kOne);
  EXPECT_EQ(told[0].t(), 1'700'000'000'123);
}

TEST_F(HeardBeaconsTest, StrengthAndDistanceAreOfTheMeanOfTheWindow) {
  for (const int rssi : {-70, -74, -75, -77}) hear(rssi, begin_);
  const auto told = list(begin_ + 100ms);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0].rssi(), -74);
  EXPECT_FLOAT_EQ(told[0].distance(), static_cast<float>(distance_m(-59, -74, kLoss)));
}

TEST_F(HeardBeaconsTest, ADistanceIsOfTheMeanBeforeItIsRounded) {
  hear(-59, begin_);
  hear(-60, begin_);
  EXPECT_FLOAT_EQ(list(begin_).at(0).distance(), static_cast<float>(distance_m(-59, -59.5, kLoss)));
}

TEST_F(HeardBeaconsTest, AReadingOlderThanTheWindowCountsNoMore) {
  hear(-50, begin_);
  hear(-80, begin_ + 900ms);
  EXPECT_EQ(list(begin_ + 1000ms).at(0).rssi(), -65);
  EXPECT_EQ(list(begin_ + 1001ms).at(0).rssi(), -80);
}

TEST_F(HeardBeaconsTest, WhoWasSilentForTheWindowIsOutOfRange) {
  hear(-50, begin_);
  hear(-60, begin_ + 500ms, kOther);
  EXPECT_THAT(addresses(begin_ + 1000ms), ElementsAre(kOne, kOther));
  EXPECT_THAT(addresses(begin_ + 1200ms), ElementsAre(kOther));
  EXPECT_TRUE(addresses(begin_ + 1501ms).empty());
}

TEST_F(HeardBeaconsTest, TheStrongestIsTheFirst) {
  hear(-80, begin_, "aa:bb:cc:dd:ee:03");
  hear(-40, begin_, "aa:bb:cc:dd:ee:04");
  hear(-60, begin_, "aa:bb:cc:dd:ee:02");
  hear(-60, begin_, "aa:bb:cc:dd:ee:01");
  EXPECT_THAT(addresses(begin_),
              ElementsAre("aa:bb:cc:dd:ee:04", "aa:bb:cc:dd:ee:01", "aa:bb:cc:dd:ee:02", "aa:bb:cc:dd:ee:03"));
}

TEST_F(HeardBeaconsTest, OfMoreThanAListHoldsTheStrongestAreTold) {
  for (int i = 0; i < 1100; ++i) hear(i < 100 ? -90 : -50, begin_, "beacon " + std::to_string(i));
  const auto told = list(begin_);
  ASSERT_EQ(told.size(), 1024u);
  EXPECT_EQ(told[999].rssi(), -50);
  EXPECT_EQ(told[1000].rssi(), -90);
}

TEST_F(HeardBeaconsTest, AClockThatIsSetBackLeavesNobodyBehind) {
  hear(-50, begin_);
  EXPECT_TRUE(list(begin_ - 1h).empty());
}

TEST_F(HeardBeaconsTest, ADeviceThatIsNoBeaconIsNotInTheList) {
  heard_.hear({kOne, std::nullopt, -50, begin_});
  EXPECT_TRUE(list(begin_).empty());
}

}  // namespace
}  // namespace fiona::beacon_server
