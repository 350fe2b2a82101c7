#include "smart_bluetooth_beacon_server.hpp"

#include <algorithm>
#include <iomanip>
#include <sstream>

namespace fiona::smart_bluetooth_beacon_server {
namespace {

using beacon_server::Radio;

constexpr std::chrono::milliseconds kWait{50};
constexpr std::chrono::seconds kBeforeNextTry{2};
constexpr std::size_t kMostMeasured = 10'000;  // many minutes, after which a fit changes no more

/// As one would type it behind `set`.
std::string text_of(const beacon_server::PathLoss& loss) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(2) << "path_loss_exponent=" << loss.exponent << std::setprecision(1)
       << " path_loss_spread=" << loss.spread_db << " receiver_gain=" << loss.gain_db;
  return text.str();
}

/// How long ago the newest of a list was heard.
std::chrono::milliseconds age_of(const sensors::CommiBeaconList& list, std::chrono::system_clock::time_point now) {
  const std::int64_t now_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now.time_since_epoch()).count();
  std::int64_t newest_ms = 0;
  for (const auto& beacon : list.beacon_list()) newest_ms = std::max(newest_ms, std::int64_t{beacon.t()});
  return std::chrono::milliseconds(list.beacon_list().empty() ? 0 : std::max<std::int64_t>(0, now_ms - newest_ms));
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
  const auto since_1970 = reading.heard.time_since_epoch();
  sensors::RFSignalRSSI signal;
  signal.set_transmitter_id(reading.address);
  signal.set_receiver_id(receiver_);
  signal.set_rf_type("BT");
  signal.set_rss(static_cast<float>(reading.rssi_dbm));
  signal.set_t(std::chrono::duration_cast<std::chrono::milliseconds>(since_1970).count());
  signals_.put(std::move(signal));
  heard_.hear(reading);
  measure(reading);
}

/// What was heard of another reference says nothing of this one.
void SmartBluetoothBeaconServer::take_reference() {
  if (params_->reference() == reference_) return;
  reference_ = params_->reference();
  measured_.clear();
}

void SmartBluetoothBeaconServer::measure(const beacon_server::Reading& reading) {
  const double distance_m = params_->reference_distance();
  if (!reading.beacon || reading.address != reference_ || !(distance_m > 0.0)) return;
  if (measured_.size() < kMostMeasured)
    measured_.emplace_back(distance_m, reading.beacon->measured_power_dbm - reading.rssi_dbm);
}

void SmartBluetoothBeaconServer::tell_fit() {
  if (reference_.empty()) return;
  const auto loss = beacon_server::fit(measured_);
  fitted_.set(std::to_string(measured_.size()) +
              " readings: " + (loss ? text_of(*loss) : "not enough, or all at one distance"));
}

/// While the radio does not listen nothing is said: an empty list would mean that no beacon is near.
void SmartBluetoothBeaconServer::put_list() {
  const beacon_server::PathLoss loss{params_->path_loss_exponent(), params_->path_loss_spread(),
                                     params_->receiver_gain()};
  distance_factor_.set(beacon_server::distance_factor(loss));
  tell_fit();
  if (!listening_) return;
  const std::chrono::milliseconds window(params_->window());
  const auto list_now = std::chrono::system_clock::now();
  auto list = heard_.list(list_now, window, loss);
  // The same is told for the whole window: who walks must not take it for what is heard where they are now.
  const TimePoint heard = now() - age_of(list, list_now);
  beacons_.put(std::move(list), heard);
  signals_.still_valid();
}

}  // namespace fiona::smart_bluetooth_beacon_server
