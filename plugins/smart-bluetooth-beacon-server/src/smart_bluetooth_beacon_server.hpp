#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "bluez_scanner.hpp"
#include "fiona/component.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/smart_bluetooth_beacon_server/params.pb.h"
#include "heard_beacons.hpp"

namespace fiona::smart_bluetooth_beacon_server {

/// Tells which Bluetooth devices and beacons a real radio hears.
class SmartBluetoothBeaconServer final : public Component {
 public:
  using Component::Component;

  void on_start() override { take_reference(); }

 private:
  struct Told {
    std::vector<beacon_server::Reading> readings;
    beacon_server::Radio radio = beacon_server::Radio::NoBluez;
    std::string reason, receiver;
    std::uint64_t malformed = 0, dropped = 0;
  };

  void listen(const OwnThread& own);
  void on_told(const Told& told);
  void on_reading(const beacon_server::Reading& reading);
  void take_reference();
  void measure(const beacon_server::Reading& reading);
  void tell_fit();
  void put_list();

  Params<SmartBluetoothBeaconServerParams> params_{*this, nullptr, &SmartBluetoothBeaconServer::take_reference};
  Provides<sensors::IbeaconlistProvider> beacons_{*this, "beacons"};
  Provides<sensors::RFSignalRSSIService> signals_{*this, "signals"};
  Probe<std::string> radio_{*this, "radio", {.doc = "whether the radio listens, or why not"}};
  Probe<double> distance_factor_{
      *this,
      "distance_factor",
      {.doc = "68 % of the true distances lie between a distance divided by it and times it, 95 % within its square"}};
  Probe<std::string> fitted_{*this, "fitted", {.doc = "the path loss that suits what was heard of the reference"}};
  Probe<std::uint64_t> malformed_{*this, "malformed", {.doc = "messages of BlueZ that were none"}};
  Probe<std::uint64_t> dropped_{*this, "dropped", {.doc = "devices and readings beyond what is kept"}};
  Task listen_{*this, "listen", free_running, &SmartBluetoothBeaconServer::listen};
  Task list_{*this, "list", std::chrono::milliseconds(300), &SmartBluetoothBeaconServer::put_list};

  beacon_server::HeardBeacons heard_;
  std::vector<std::pair<double, double>> measured_;  ///< of the reference: metres, dB below its measured power
  std::string reference_, receiver_, said_;
  bool listening_ = false;
};

}  // namespace fiona::smart_bluetooth_beacon_server
