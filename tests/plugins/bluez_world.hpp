#pragma once

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <sdbus-c++/sdbus-c++.h>

#include "advertisement.hpp"
#include "bus.hpp"

namespace fiona::beacon_server {

using namespace std::chrono_literals;

inline const Bytes kIbeacon{0x02, 0x15, 0x11, 0x11, 0x11, 0x11, 0x22, 0x22, 0x33, 0x33, 0x44, 0x44,
                            0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x00, 0x01, 0x01, 0x02, 0xC5};
inline const Bytes kEddystoneUid{0x00, 0xEE, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 0, 0};
inline constexpr const char* kAddress = "AA:BB:CC:DD:EE:01";

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

/// A bus of its own, and on it a bluetoothd of tests (bluez_5_66.py) that does as it is told.
class BluezTest : public ::testing::Test {
 protected:
  BluezTest()
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
  void adapter(bool powered = true, const std::string& name = "hci0",
               const std::string& address = "00:11:22:33:44:55") {
    mock("AddAdapter", name, address, powered);
  }
  void unplug(const std::string& name = "hci0") { mock("RemoveAdapter", name); }

  Child bus_;
  std::unique_ptr<sdbus::IConnection> control_;
  std::optional<Child> bluetoothd_;
};

}  // namespace fiona::beacon_server
