// What beacons advertise, byte by byte.
#include <gtest/gtest.h>

#include <vector>

#include "advertisement.hpp"

namespace fiona::beacon_server {
namespace {

using Bytes = std::vector<std::uint8_t>;

Bytes ibeacon() {
  return {0x02, 0x15, 0xE2, 0xC5, 0x6D, 0xB5, 0xDF, 0xFB, 0x48, 0xD2, 0xB0, 0x60,
          0xD0, 0xF5, 0xA7, 0x10, 0x96, 0xE0, 0x12, 0x34, 0xFF, 0xFE, 0xC5};
}
Bytes eddystone() { return {0x00, 0xEE, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16}; }

TEST(Advertisement, AnIbeaconSaysUuidMajorMinorAndPower) {
  const Identity expected{"e2c56db5-dffb-48d2-b060-d0f5a71096e0", 0x1234, 0xFFFE, -59};
  EXPECT_EQ(parse_ibeacon(ibeacon()), expected);
}

TEST(Advertisement, EveryCutOrLongerIbeaconIsNone) {
  const Bytes whole = ibeacon();
  for (std::size_t length = 0; length < whole.size(); ++length) {
    EXPECT_FALSE(parse_ibeacon(std::span(whole).first(length))) << length;
  }
  Bytes longer = whole;
  longer.push_back(0);
  EXPECT_FALSE(parse_ibeacon(longer));
}

TEST(Advertisement, WhatElseAppleSendsIsNoIbeacon) {
  Bytes other = ibeacon();
  other[0] = 0x10;
  EXPECT_FALSE(parse_ibeacon(other));
}

TEST(Advertisement, AnEddystoneMayLackItsReservedBytes) {
  Bytes frame = eddystone();
  const Identity expected{"01020304-0506-0708-090a-0b0c0d0e0f10", 0, 0, -18 - 41};
  EXPECT_EQ(parse_eddystone_uid(frame), expected);
  frame.insert(frame.end(), {0, 0});
  EXPECT_EQ(parse_eddystone_uid(frame), expected);
}

TEST(Advertisement, OtherEddystoneFramesAreNone) {
  for (const std::uint8_t type : {0x10, 0x20, 0x30}) {
    Bytes frame = eddystone();
    frame[0] = type;
    EXPECT_FALSE(parse_eddystone_uid(frame)) << int{type};
  }
}

TEST(Advertisement, ABeaconIsFoundAmongOtherStructures) {
  Bytes packet{0x02, 0x01, 0x06, 0x1A, 0xFF, 0x4C, 0x00};
  const Bytes data = ibeacon();
  packet.insert(packet.end(), data.begin(), data.end());
  EXPECT_EQ(parse_advertising_data(packet), parse_ibeacon(data));
}

TEST(Advertisement, AStructureThatOverrunsThePacketIsNone) {
  Bytes packet{0x1B, 0xFF, 0x4C, 0x00};
  const Bytes data = ibeacon();
  packet.insert(packet.end(), data.begin(), data.end());
  EXPECT_FALSE(parse_advertising_data(packet));
}

}  // namespace
}  // namespace fiona::beacon_server
