// Listening through BlueZ, against a bluetoothd of tests on a bus of its own.
#include <gtest/gtest.h>
#include <malloc.h>

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "bluez_scanner.hpp"
#include "bluez_world.hpp"

namespace fiona::beacon_server {
namespace {

/// So that nothing is seen by looking again: it must have been told.
constexpr std::chrono::milliseconds kNeverAgain = 1h;

class BluezScannerTest : public BluezTest {
 protected:
  /// Runs the scanner until it is so, or ten seconds are over; keeps what was heard.
  bool until(BluezScanner& scanner, const std::function<bool()>& so) {
    const auto end = std::chrono::steady_clock::now() + 10s;
    while (std::chrono::steady_clock::now() < end) {
      scanner.run(20ms);
      for (auto& reading : scanner.take()) heard_.push_back(std::move(reading));
      if (so()) return true;
    }
    return false;
  }
  bool until_listening(BluezScanner& scanner) {
    return until(scanner, [&] { return scanner.radio() == Radio::Listening; });
  }
  bool until_heard(BluezScanner& scanner, std::size_t count) {
    return until(scanner, [&] { return heard_.size() >= count; });
  }

  std::vector<Reading> heard_;
};

TEST_F(BluezScannerTest, ABeaconsFirstPacketIsHeardWithItsIdentityAndStrength) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  EXPECT_EQ(scanner.receiver(), "00:11:22:33:44:55");
  packet(-60, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 1));
  EXPECT_EQ(heard_[0].address, "aa:bb:cc:dd:ee:01");
  EXPECT_EQ(heard_[0].rssi_dbm, -60);
  const Identity expected{"11111111-2222-3333-4444-555555555555", 1, 258, -59};
  EXPECT_EQ(heard_[0].beacon, expected);
}

TEST_F(BluezScannerTest, APacketOfEqualStrengthAndDataIsOneMore) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "hci0", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  for (int i = 0; i < 5; ++i) packet(-60, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 5));
  EXPECT_EQ(heard_.size(), 5u);
  EXPECT_EQ(heard_.back().rssi_dbm, -60) << "BlueZ does not tell again an RSSI that has not changed";
}

TEST_F(BluezScannerTest, ItAsksForEachPacketOfLowEnergyDevices) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  bool discovers = false, duplicates = false;
  auto reply = sdbus::createProxy(*control_, "org.bluez", "/");
  reply->callMethod("Discovers")
      .onInterface("org.bluez.Mock")
      .withArguments(std::string("hci0"))
      .storeResultsTo(discovers, duplicates);
  EXPECT_TRUE(discovers);
  EXPECT_TRUE(duplicates);
}

TEST_F(BluezScannerTest, AnEddystoneIsToldByItsServiceData) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  mock("Packet", std::string("hci0"), std::string(kAddress), std::int16_t{-70}, std::map<std::uint16_t, Bytes>{},
       std::map<std::string, Bytes>{{kEddystone, kEddystoneUid}});
  ASSERT_TRUE(until_heard(scanner, 1));
  ASSERT_TRUE(heard_[0].beacon);
  EXPECT_EQ(heard_[0].beacon->uuid, "01020304-0506-0708-090a-0b0c0d0e0f10");
  EXPECT_EQ(heard_[0].beacon->measured_power_dbm, -18 - 41);
}

TEST_F(BluezScannerTest, ARadioThatIsSwitchedOffAndOnIsListenedToAgain) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  mock("Power", std::string("hci0"), false);
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::Off; }));
  EXPECT_EQ(scanner.reason(), "the radio is switched off");
  scanner.run(0ms);  // looks at what it has been told so far, before it is told more
  mock("Power", std::string("hci0"), true);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  EXPECT_TRUE(until_heard(scanner, 1));
}

TEST_F(BluezScannerTest, DiscoveryThatBluezEndedIsBegunAgain) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  mock("EndDiscovery", std::string("hci0"));
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() != Radio::Listening; }));
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  EXPECT_TRUE(until_heard(scanner, 1));
}

TEST_F(BluezScannerTest, ABluetoothdThatIsRestartedIsListenedToAgain) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  stop_bluetoothd();
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoBluez; }));
  EXPECT_EQ(scanner.reason(), "bluetoothd does not run");
  start_bluetoothd();
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoAdapter; })) << scanner.reason();
  adapter();
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  EXPECT_TRUE(until_heard(scanner, 1));
}

TEST_F(BluezScannerTest, ARadioThatIsUnpluggedIsMissedAndListenedToAgainAsSoonAsItIsBack) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-60, kIbeacon);
  unplug();
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoAdapter; })) << scanner.reason();
  EXPECT_EQ(scanner.reason(), "there is no Bluetooth radio");
  heard_.clear();
  adapter();
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 1));
  EXPECT_EQ(heard_[0].rssi_dbm, -50);
}

TEST_F(BluezScannerTest, AnotherRadioTakesThePlaceOfOneThatIsUnplugged) {
  start_bluetoothd();
  adapter();
  adapter(true, "hci1", "00:11:22:33:44:66");
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  unplug("hci0");
  ASSERT_TRUE(until(scanner, [&] { return scanner.receiver() == "00:11:22:33:44:66"; }));
  EXPECT_EQ(scanner.radio(), Radio::Listening) << scanner.reason();
}

TEST_F(BluezScannerTest, AnotherRadioIsNotListenedToInThePlaceOfTheNamedOne) {
  start_bluetoothd();
  adapter();
  adapter(true, "hci1", "00:11:22:33:44:66");
  BluezScanner scanner(bus_.output, "hci0", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  unplug("hci1");
  unplug("hci0");
  adapter(true, "hci1", "00:11:22:33:44:66");
  ASSERT_TRUE(until(scanner, [&] { return scanner.reason() == "there is no radio hci0"; })) << scanner.reason();
  adapter();
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  EXPECT_EQ(scanner.receiver(), "00:11:22:33:44:55");
}

/// A refusal ends without a signal.
TEST_F(BluezScannerTest, WhatHasNoSignalIsSeenByLookingAgain) {
  start_bluetoothd();
  adapter();
  mock("Refuse", true);
  BluezScanner scanner(bus_.output, "", 10ms);
  ASSERT_TRUE(until(scanner, [&] { return scanner.reason() == "BlueZ refused: Not permitted"; })) << scanner.reason();
  mock("Refuse", false);
  EXPECT_TRUE(until_listening(scanner)) << scanner.reason();
}

TEST_F(BluezScannerTest, WithoutBluetoothdItWaitsAndSaysSo) {
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  EXPECT_TRUE(until(scanner, [&] { return scanner.reason() == "bluetoothd does not run"; })) << scanner.reason();
}

TEST_F(BluezScannerTest, ARadioThatIsNotThereIsNamed) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "hci7", kNeverAgain);
  EXPECT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoAdapter; }));
  EXPECT_EQ(scanner.reason(), "there is no radio hci7");
}

TEST_F(BluezScannerTest, PropertiesOfOtherTypesAreCountedAndCostNothingElse) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  mock("Nonsense", std::string("hci0"), std::string(kAddress));
  packet(-51, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 2));
  EXPECT_EQ(scanner.malformed(), 2u);
  EXPECT_EQ(heard_.back().rssi_dbm, -51);
}

TEST_F(BluezScannerTest, APayloadThatIsNoBeaconIsADeviceAllTheSame) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, {0x02, 0x15, 0x11});
  ASSERT_TRUE(until_heard(scanner, 1));
  EXPECT_FALSE(heard_[0].beacon);
}

TEST_F(BluezScannerTest, AForgottenDeviceIsHeardAnewByItsNextPacket) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "", kNeverAgain);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  mock("Forget", std::string("hci0"), std::string(kAddress));
  packet(-55, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 2));
  EXPECT_EQ(heard_.back().rssi_dbm, -55);
  EXPECT_TRUE(heard_.back().beacon);
}

TEST(BluezScanner, WithoutABusItRefusesAndSaysWhy) {
  for (const char* bus : {"unix:path=/nowhere/bus", "unix:path=/nowhere/bus,guid=00", "unix:abstract=fiona-nowhere"}) {
    try {
      BluezScanner scanner(bus, "");
      ADD_FAILURE() << bus;
    } catch (const BusError& error) {
      EXPECT_TRUE(error.name() == DBUS_ERROR_NO_SERVER || error.name() == DBUS_ERROR_FILE_NOT_FOUND) << error.name();
      EXPECT_STRNE(error.what(), "");
    }
  }
}

TEST(BluezScanner, ABusThatIsNotThereCostsNoMemoryHoweverOftenItIsTried) {
  const auto tried = [](int times) {
    for (int i = 0; i < times; ++i) EXPECT_THROW(BluezScanner("unix:path=/nowhere/bus", ""), BusError);
    return ::mallinfo2().uordblks;
  };
  const auto before = tried(100);
  EXPECT_LT(tried(1000), before + 100'000);
}

}  // namespace
}  // namespace fiona::beacon_server
