#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "bluez_scanner.hpp"
#include "fiona/component.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/smart_bluetooth_beacon_server/params.pb.h"

namespace fiona::smart_bluetooth_beacon_server {

/// Tells which Bluetooth devices and beacons a real radio hears.
class SmartBluetoothBeaconServer final : public Component {
 public:
  using Component::Component;

 private:
  struct Told {
    std::vector<beacon_server::Reading> readings;
    beacon_server::Radio radio = beacon_server::Radio::NoBluez;
    std::string reason, receiver;
    std::uint64_t malformed = 0, dropped = 0;
  };
  struct Heard {
    beacon_server::Identity identity;
    std::deque<std::pair<std::int64_t, int>> readings;  ///< wall clock in ms, dBm
  };

  void listen(const OwnThread& own);
  void on_told(const Told& told);
  void on_reading(const beacon_server::Reading& reading);
  void put_list();
  sensors::CommiBeaconList list(std::int64_t now_ms);

  Params<SmartBluetoothBeaconServerParams> params_{*this};
  Provides<sensors::IbeaconlistProvider> beacons_{*this, "beacons"};
  Provides<sensors::RFSignalRSSIService> signals_{*this, "signals"};
  Probe<std::string> radio_{*this, "radio", {.doc = "whether the radio listens, or why not"}};
  Probe<double> distance_factor_{
      *this,
      "distance_factor",
      {.doc = "68 % of the true distances lie between a distance divided by it and times it"}};
  Probe<std::uint64_t> malformed_{*this, "malformed", {.doc = "messages of BlueZ that were none"}};
  Probe<std::uint64_t> dropped_{*this, "dropped", {.doc = "devices and readings beyond what is kept"}};
  Task listen_{*this, "listen", free_running, &SmartBluetoothBeaconServer::listen};
  Task list_{*this, "list", std::chrono::milliseconds(300), &SmartBluetoothBeaconServer::put_list};

  std::map<std::string, Heard> heard_;  ///< beacons by address
  std::string receiver_, said_;
  bool listening_ = false;
};

}  // namespace fiona::smart_bluetooth_beacon_server
