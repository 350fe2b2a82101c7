// Listening through BlueZ, against a bluetoothd of tests on a bus of its own.
#include <gtest/gtest.h>
#include <malloc.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

#include <sdbus-c++/sdbus-c++.h>

#include "bluez_scanner.hpp"

namespace fiona::beacon_server {
namespace {

using namespace std::chrono_literals;

const Bytes kIbeacon{0x02, 0x15, 0x11, 0x11, 0x11, 0x11, 0x22, 0x22, 0x33, 0x33, 0x44, 0x44,
                     0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x00, 0x01, 0x01, 0x02, 0xC5};
const Bytes kEddystoneUid{0x00, 0xEE, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 0, 0};
constexpr const char* kAddress = "AA:BB:CC:DD:EE:01";

/// A child process that ends with its owner; `output` is what it says first on its standard output, one line.
class Child {
 public:
  Child(std::vector<std::string> line, bool says_something, const std::string& bus = {}) {
    int pipe[2];
    if (::pipe(pipe) != 0) throw std::runtime_error("no pipe");
    pid_ = ::fork();
    if (pid_ == 0) {
      ::dup2(pipe[1], 1);
      ::close(pipe[0]);
      if (!bus.empty()) ::setenv("DBUS_SESSION_BUS_ADDRESS", bus.c_str(), 1);
      ::unsetenv("LD_PRELOAD");
      std::vector<char*> words;
      for (std::string& word : line) words.push_back(word.data());
      words.push_back(nullptr);
      ::execvp(words[0], words.data());
      ::_exit(127);
    }
    ::close(pipe[1]);
    for (char c; says_something && ::read(pipe[0], &c, 1) == 1 && c != '\n';) output += c;
    if (says_something) ::close(pipe[0]);
  }
  ~Child() {
    ::kill(pid_, SIGTERM);
    ::waitpid(pid_, nullptr, 0);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  std::string output;

 private:
  pid_t pid_;
};

class BluezScannerTest : public ::testing::Test {
 protected:
  BluezScannerTest()
      : bus_({"dbus-daemon", "--session", "--nofork", "--nopidfile", "--print-address=1"}, true),
        control_(sdbus::createSessionBusConnectionWithAddress(bus_.output)) {}

  void start_bluetoothd() {
    bluetoothd_.emplace(std::vector<std::string>{"/usr/bin/python3", "-m", "dbusmock", "--session", "-l", "/dev/null",
                                                 "--template", FIONA_BLUEZ_MOCK},
                        false, bus_.output);
    const auto bus = sdbus::createProxy(*control_, "org.freedesktop.DBus", "/org/freedesktop/DBus");
    for (int i = 0; i < 1000; ++i) {
      bool there = false;
      bus->callMethod("NameHasOwner")
          .onInterface("org.freedesktop.DBus")
          .withArguments("org.bluez")
          .storeResultsTo(there);
      if (there) return;
      ::usleep(20'000);
    }
    FAIL() << "python3-dbusmock did not start";
  }
  void stop_bluetoothd() { bluetoothd_.reset(); }

  template <class... Arguments>
  void mock(const char* method, const Arguments&... arguments) {
    sdbus::createProxy(*control_, "org.bluez", "/")
        ->callMethod(method)
        .onInterface("org.bluez.Mock")
        .withTimeout(10s)
        .withArguments(arguments...);
  }
  void packet(std::int16_t rssi, const Bytes& ibeacon, const std::string& address = kAddress) {
    mock("Packet", std::string("hci0"), address, rssi, std::map<std::uint16_t, Bytes>{{kApple, ibeacon}},
         std::map<std::string, Bytes>{});
  }
  void adapter(bool powered = true) {
    mock("AddAdapter", std::string("hci0"), std::string("00:11:22:33:44:55"), powered);
  }

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

  Child bus_;
  std::unique_ptr<sdbus::IConnection> control_;
  std::optional<Child> bluetoothd_;
  std::vector<Reading> heard_;
};

TEST_F(BluezScannerTest, ABeaconsFirstPacketIsHeardWithItsIdentityAndStrength) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "");
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
  BluezScanner scanner(bus_.output, "hci0");
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  for (int i = 0; i < 5; ++i) packet(-60, kIbeacon);
  ASSERT_TRUE(until_heard(scanner, 5));
  EXPECT_EQ(heard_.size(), 5u);
  EXPECT_EQ(heard_.back().rssi_dbm, -60) << "BlueZ does not tell again an RSSI that has not changed";
}

TEST_F(BluezScannerTest, ItAsksForEachPacketOfLowEnergyDevices) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "");
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
  BluezScanner scanner(bus_.output, "");
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
  BluezScanner scanner(bus_.output, "");
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  mock("Power", std::string("hci0"), false);
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::Off; }));
  EXPECT_EQ(scanner.reason(), "the radio is switched off");
  mock("Power", std::string("hci0"), true);
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  EXPECT_TRUE(until_heard(scanner, 1));
}

TEST_F(BluezScannerTest, DiscoveryThatBluezEndedIsBegunAgain) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "");
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
  BluezScanner scanner(bus_.output, "");
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  stop_bluetoothd();
  ASSERT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoBluez; }));
  EXPECT_EQ(scanner.reason(), "bluetoothd does not run");
  start_bluetoothd();
  adapter();
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, kIbeacon);
  EXPECT_TRUE(until_heard(scanner, 1));
}

TEST_F(BluezScannerTest, WithoutBluetoothdItWaitsAndSaysSo) {
  BluezScanner scanner(bus_.output, "");
  EXPECT_TRUE(until(scanner, [&] { return scanner.reason() == "bluetoothd does not run"; })) << scanner.reason();
}

TEST_F(BluezScannerTest, ARadioThatIsNotThereIsNamed) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "hci7");
  EXPECT_TRUE(until(scanner, [&] { return scanner.radio() == Radio::NoAdapter; }));
  EXPECT_EQ(scanner.reason(), "there is no radio hci7");
}

TEST_F(BluezScannerTest, PropertiesOfOtherTypesAreCountedAndCostNothingElse) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "");
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
  BluezScanner scanner(bus_.output, "");
  ASSERT_TRUE(until_listening(scanner)) << scanner.reason();
  packet(-50, {0x02, 0x15, 0x11});
  ASSERT_TRUE(until_heard(scanner, 1));
  EXPECT_FALSE(heard_[0].beacon);
}

TEST_F(BluezScannerTest, AForgottenDeviceIsHeardAnewByItsNextPacket) {
  start_bluetoothd();
  adapter();
  BluezScanner scanner(bus_.output, "");
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
