#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "advertisement.hpp"
#include "bus.hpp"

namespace fiona::beacon_server {

/// One packet of one device, as BlueZ tells it.
struct Reading {
  std::string address;  ///< of the device, lower-case aa:bb:cc:dd:ee:ff
  std::optional<Identity> beacon;
  int rssi_dbm;
  std::chrono::system_clock::time_point heard;
};

enum class Radio : std::uint8_t {
  NoBluez,    ///< nobody on the bus is called org.bluez
  NoAdapter,  ///< BlueZ has no radio of that name
  Off,        ///< the radio is not powered
  Refused,    ///< BlueZ does not let us listen: see reason()
  Listening,
};

/// Where the system's bus is: DBUS_SYSTEM_BUS_ADDRESS, which a sandbox sets to where it is let through to BlueZ, or the
/// well-known address (D-Bus specification, "Well-known Message Bus Instances").
std::string system_bus();

/// Listens through BlueZ (doc/adapter-api.txt and doc/device-api.txt of BlueZ 5.66). It starts over by itself when
/// bluetoothd is restarted, the radio is switched off and on or plugged in, or discovery has ended. One thread.
///
/// BlueZ tells a device's properties, not packets: a change of RSSI, ManufacturerData or ServiceData is a packet, with
/// the RSSI that was told last. It leaves the RSSI out when that has not changed, and with DuplicateData tells the data
/// of each packet, changed or not.
class BluezScanner {
 public:
  static constexpr std::size_t kMostDevices = 4096;   ///< that are remembered; others are counted
  static constexpr std::size_t kMostReadings = 4096;  ///< between two calls of take()

  static constexpr std::chrono::seconds kLookAgain{2};

  /// Connects to the bus. Throws BusError if nobody is there. While it does not listen it looks again every
  /// `look_again`: for what has no signal, such as the end of a refusal.
  BluezScanner(const std::string& bus, std::string adapter, std::chrono::milliseconds look_again = kLookAgain);

  /// Waits for at most so long for what the bus says, and handles it. Throws BusError when the bus is gone.
  void run(std::chrono::milliseconds at_most);

  /// What was heard since the last call, oldest first.
  std::vector<Reading> take() { return std::exchange(readings_, {}); }

  Radio radio() const { return radio_; }
  const std::string& reason() const { return reason_; }      ///< one sentence, of any state but Listening
  const std::string& receiver() const { return receiver_; }  ///< address of the radio
  std::uint64_t malformed() const { return malformed_; }     ///< messages whose types are not BlueZ's
  std::uint64_t dropped() const { return dropped_; }         ///< devices and readings beyond the bounds

 private:
  struct Device {
    std::string address;
    std::optional<Identity> beacon;
    std::optional<int> rssi_dbm;
  };

  void watch();
  void start_over();
  void find_adapter();
  void listen();
  void set(Radio radio, std::string reason);
  void on_signal(const Message& message);
  void on_properties(const Message& message);
  void on_added(const Message& message);
  void on_removed(const Message& message);
  void on_owner(const Message& message);
  void on_adapter(const Properties& changed);
  void on_device(const std::string& path, const Properties& changed, bool is_packet);
  Message call(const std::string& path, const char* interface, const char* method);

  const std::string wanted_;
  const std::chrono::milliseconds every_;  ///< between two looks
  Bus bus_;
  std::string adapter_;  ///< object path; empty: none
  std::string receiver_;
  std::map<std::string, Device> devices_;  ///< by object path
  std::vector<Reading> readings_;
  Radio radio_ = Radio::NoBluez;
  std::string reason_;
  bool look_again_ = true;
  std::chrono::steady_clock::time_point next_look_{};
  std::uint64_t malformed_ = 0, dropped_ = 0;
};

}  // namespace fiona::beacon_server
