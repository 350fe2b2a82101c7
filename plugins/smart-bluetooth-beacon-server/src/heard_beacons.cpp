#include "heard_beacons.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace fiona::beacon_server {
namespace {

constexpr int kMostBeacons = 1024;          // of the contract
constexpr std::size_t kMostReadings = 256;  // of one beacon in a window

}  // namespace

void HeardBeacons::hear(const Reading& reading) {
  if (!reading.beacon) return;
  Heard& heard = heard_[reading.address];
  heard.identity = *reading.beacon;
  heard.readings.emplace_back(reading.heard, reading.rssi_dbm);
  if (heard.readings.size() > kMostReadings) heard.readings.pop_front();
}

sensors::CommiBeaconList HeardBeacons::list(Time now, std::chrono::milliseconds window, const PathLoss& loss) {
  std::vector<sensors::CommiBeacon> beacons;
  for (auto it = heard_.begin(); it != heard_.end();) {
    auto& [address, heard] = *it;
    // A clock that was set back leaves readings of the future, which would never grow old.
    std::erase_if(heard.readings, [&](const auto& one) { return std::chrono::abs(now - one.first) > window; });
    if (heard.readings.empty()) {
      it = heard_.erase(it);
      continue;
    }
    beacons.push_back(told(address, heard, loss));
    ++it;
  }
  std::stable_sort(beacons.begin(), beacons.end(), [](const auto& a, const auto& b) { return a.rssi() > b.rssi(); });
  sensors::CommiBeaconList result;
  for (auto& beacon : beacons) {
    if (result.beacon_list_size() < kMostBeacons) *result.add_beacon_list() = std::move(beacon);
  }
  return result;
}

sensors::CommiBeacon HeardBeacons::told(const std::string& address, const Heard& heard, const PathLoss& loss) {
  double sum = 0.0;
  for (const auto& [time, rssi] : heard.readings) sum += rssi;
  const double mean = sum / static_cast<double>(heard.readings.size());
  const auto last = heard.readings.back().first.time_since_epoch();
  sensors::CommiBeacon beacon;
  beacon.set_uuid(heard.identity.uuid);
  beacon.set_major(heard.identity.major);
  beacon.set_minor(heard.identity.minor);
  beacon.set_measured_power(std::max(-128, heard.identity.measured_power_dbm));
  beacon.set_rssi(static_cast<int>(std::lround(mean)));
  beacon.set_distance(static_cast<float>(distance_m(heard.identity.measured_power_dbm, mean, loss)));
  beacon.set_t(std::chrono::duration_cast<std::chrono::milliseconds>(last).count());
  beacon.set_address(address);
  return beacon;
}

}  // namespace fiona::beacon_server
