#pragma once

#include <chrono>
#include <deque>
#include <map>
#include <string>
#include <utility>

#include "bluez_scanner.hpp"
#include "fiona/sensors.fiona.hpp"
#include "path_loss.hpp"

namespace fiona::beacon_server {

/// Makes of single readings which beacons are near.
class HeardBeacons {
 public:
  using Time = std::chrono::system_clock::time_point;

  /// Readings of devices that are no beacons are left out.
  void hear(const Reading& reading);
  void clear() { heard_.clear(); }
  /// Those that were heard within `window` of `now`, strongest first, with the means of what was heard; the others are
  /// forgotten.
  sensors::CommiBeaconList list(Time now, std::chrono::milliseconds window, const PathLoss& loss);

 private:
  struct Heard {
    Identity identity;
    std::deque<std::pair<Time, int>> readings;  ///< in dBm
  };
  static sensors::CommiBeacon told(const std::string& address, const Heard& heard, const PathLoss& loss);

  std::map<std::string, Heard> heard_;  ///< by address
};

}  // namespace fiona::beacon_server
