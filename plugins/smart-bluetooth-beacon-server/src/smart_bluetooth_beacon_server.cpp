#include "smart_bluetooth_beacon_server.hpp"

#include <algorithm>
#include <cmath>

#include "path_loss.hpp"

namespace fiona::smart_bluetooth_beacon_server {
namespace {

using beacon_server::Radio;

constexpr std::chrono::milliseconds kWait{50};
constexpr std::chrono::seconds kBeforeNextTry{2};
constexpr int kMostBeacons = 1024;          // of the contract
constexpr std::size_t kMostReadings = 256;  // of one beacon in a window

std::int64_t wall_ms(std::chrono::system_clock::time_point time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

/// [the task's thread] Called again as soon as it returns: once for each connection to the bus.
void SmartBluetoothBeaconServer::listen(const OwnThread& own) {
  const auto parameters = params_.snapshot();
  const std::string bus = parameters->bus().empty() ? beacon_server::system_bus() : parameters->bus();
  Told told;
  try {
    beacon_server::BluezScanner scanner(bus, parameters->adapter());
    while (!own.stop_requested()) {
      scanner.run(kWait);
      Told now{scanner.take(),     scanner.radio(),     scanner.reason(),
               scanner.receiver(), scanner.malformed(), scanner.dropped()};
      const auto next = params_.snapshot();
      if (next->bus() != parameters->bus() || next->adapter() != parameters->adapter()) return;
      const bool same = now.readings.empty() && now.radio == told.radio && now.reason == told.reason;
      told = std::move(now);
      if (!same && !own.post([this, told] { on_told(told); })) return;
      told.readings.clear();
    }
    return;
  } catch (const beacon_server::BusError& error) {
    told = {{}, Radio::NoBluez, "no bus at " + bus + ": " + error.what(), {}, told.malformed, told.dropped};
  }
  own.post([this, told] { on_told(told); });
  own.wait_for(kBeforeNextTry);
}

void SmartBluetoothBeaconServer::on_told(const Told& told) {
  receiver_ = told.receiver;
  listening_ = told.radio == Radio::Listening;
  malformed_.set(told.malformed);
  dropped_.set(told.dropped);
  const std::string says = listening_ ? "listening" : told.reason;
  radio_.set(says);
  if (says != said_) log(listening_ ? LogLevel::Info : LogLevel::Warning, said_ = says);
  if (!listening_) heard_.clear();
  for (const auto& reading : told.readings) on_reading(reading);
}

void SmartBluetoothBeaconServer::on_reading(const beacon_server::Reading& reading) {
  const std::int64_t t_ms = wall_ms(reading.heard);
  sensors::RFSignalRSSI signal;
  signal.set_transmitter_id(reading.address);
  signal.set_receiver_id(receiver_);
  signal.set_rf_type("BT");
  signal.set_rss(static_cast<float>(reading.rssi_dbm));
  signal.set_t(t_ms);
  signals_.put(std::move(signal));
  if (!reading.beacon) return;
  Heard& heard = heard_[reading.address];
  heard.identity = *reading.beacon;
  heard.readings.emplace_back(t_ms, reading.rssi_dbm);
  if (heard.readings.size() > kMostReadings) heard.readings.pop_front();
}

/// While the radio does not listen nothing is said: an empty list would mean that no beacon is near.
void SmartBluetoothBeaconServer::put_list() {
  if (!listening_) return;
  beacons_.put(list(wall_ms(std::chrono::system_clock::now())));
  signals_.still_valid();
}

sensors::CommiBeaconList SmartBluetoothBeaconServer::list(std::int64_t now_ms) {
  const beacon_server::PathLoss loss{params_->path_loss_exponent(), params_->path_loss_spread()};
  std::vector<sensors::CommiBeacon> beacons;
  for (auto it = heard_.begin(); it != heard_.end();) {
    auto& [address, heard] = *it;
    std::erase_if(heard.readings, [&](const auto& reading) { return now_ms - reading.first > params_->window(); });
    if (heard.readings.empty()) {
      it = heard_.erase(it);
      continue;
    }
    double sum = 0.0;
    for (const auto& [t_ms, rssi] : heard.readings) sum += rssi;
    const double mean = sum / static_cast<double>(heard.readings.size());
    const auto distance = beacon_server::distance_of(heard.identity.measured_power_dbm, mean, loss);
    distance_factor_.set(distance.factor);
    auto& beacon = beacons.emplace_back();
    beacon.set_uuid(heard.identity.uuid);
    beacon.set_major(heard.identity.major);
    beacon.set_minor(heard.identity.minor);
    beacon.set_measured_power(std::max(-128, heard.identity.measured_power_dbm));
    beacon.set_rssi(static_cast<int>(std::lround(mean)));
    beacon.set_distance(static_cast<float>(distance.metres));
    beacon.set_t(heard.readings.back().first);
    beacon.set_address(address);
    ++it;
  }
  std::stable_sort(beacons.begin(), beacons.end(), [](const auto& a, const auto& b) { return a.rssi() > b.rssi(); });
  sensors::CommiBeaconList result;
  for (auto& beacon : beacons) {
    if (result.beacon_list_size() < kMostBeacons) *result.add_beacon_list() = std::move(beacon);
  }
  return result;
}

}  // namespace fiona::smart_bluetooth_beacon_server
