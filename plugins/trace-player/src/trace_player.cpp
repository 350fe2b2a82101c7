#include "trace_player.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>

#include "fiona/objects/imu.hpp"
#include "fiona/walk/dataset.hpp"

namespace fiona::trace_player {
namespace {

constexpr const char* kReceiver = "recording";

/// Log-distance model with the exponent of free space: what a receiver that knows no walls says.
float distance_m(double measured_power_dbm, double rssi_dbm) {
  return static_cast<float>(std::pow(10.0, (measured_power_dbm - rssi_dbm) / 20.0));
}

/// Recordings write addresses in several ways; what has not twelve digits is an invented name and stays.
std::string device_address(const std::string& recorded) {
  std::string address;
  for (const char c : recorded) {
    if (c == ':' || c == '-') continue;
    if (address.size() == 17 || !std::isxdigit(static_cast<unsigned char>(c))) return recorded;
    if (address.size() % 3 == 2) address += ':';
    address += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  return address.size() == 17 ? address : recorded;
}

}  // namespace

void TracePlayer::on_start() {
  if (params_->dataset().empty()) {
    throw Error(ErrorCode::Usage, {.what = "no recording is named",
                                   .where = name(),
                                   .next = "load trace-player as " + name() + " dataset=FOLDER trace=NAME"});
  }
  const auto dataset = walk::Dataset::open(params_->dataset());
  std::string trace = params_->trace();
  if (trace.empty()) {
    const auto names = dataset.walk_names();
    if (names.empty()) {
      throw Error(ErrorCode::NotFound, {.what = "the recording has no test walk",
                                        .where = params_->dataset(),
                                        .next = "load trace-player as " + name() + " dataset=" + params_->dataset() +
                                                " trace=NAME, with the name of a survey walk"});
    }
    trace = names.front();
  }
  walk_ = dataset.walk(trace);
  for (std::string& id : walk_.transmitters) id = device_address(id);
  started_ = true;
}

void TracePlayer::check(const TracePlayerParams& draft) const {
  if (!started_ || (draft.dataset() == params_->dataset() && draft.trace() == params_->trace())) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the walk is read when the instance starts",
                                      .where = name(),
                                      .next = "load another instance with dataset=" + draft.dataset() +
                                              (draft.trace().empty() ? "" : " trace=" + draft.trace()) + ", and swap"});
}

TimePoint TracePlayer::time_of(std::int64_t t_ms) const { return begun_ + std::chrono::milliseconds(t_ms); }

void TracePlayer::on_mode(std::string_view mode) {
  if (mode != "active") return;
  // Neutral pauses: what remains keeps its distance in time.
  const std::int64_t resumed_ms = next_ < walk_.events.size() && next_ > 0 ? walk_.events[next_].t_ms : 0;
  begun_ = now() - std::chrono::milliseconds(resumed_ms);
  next_event_.at(now());
}

void TracePlayer::play_next() {
  while (next_ < walk_.events.size() && time_of(walk_.events[next_].t_ms) <= now()) play(walk_.events[next_++]);
  put_beacons();
  if (next_ < walk_.events.size()) return next_event_.at(time_of(walk_.events[next_].t_ms));
  log(LogLevel::Info, "end of walk " + walk_.name);
  if (params_->at_end() == END_RUN) end_run(0, "end of walk " + walk_.name);
}

void TracePlayer::play(const walk::Event& event) {
  if (const auto* row = std::get_if<walk::WifiRow>(&event.data)) return play_wifi(*row);
  if (const auto* row = std::get_if<walk::BeaconRow>(&event.data)) return collect_beacon(*row, time_of(event.t_ms));
  play_imu(event);
}

void TracePlayer::play_imu(const walk::Event& event) {
  const auto merged = merger_.feed(event);
  if (!merged) return;
  const auto vector = [](const double(&v)[3]) { return sensors::PhoneAxes::Vector{v[0], v[1], v[2]}; };
  auto imu = imu_.make();
  sensors::set_from_phone_axes({.acceleration_g = vector(merged->acceleration_g),
                                .rotation_deg_s = vector(merged->rate_dps),
                                .magnetic_gauss = vector(merged->field_gauss)},
                               *imu);
  imu_.put(std::move(imu), std::max(TimePoint{}, time_of(merged->t_ms)));
}

void TracePlayer::play_wifi(const walk::WifiRow& row) {
  const TimePoint heard = std::max(TimePoint{}, time_of(row.heard_ms));
  auto signal = wifi_.make();
  signal->set_transmitter_id(walk_.transmitters[row.transmitter]);
  signal->set_receiver_id(kReceiver);
  signal->set_rf_type("WiFi");
  signal->set_rss(row.rssi_dbm);
  signal->set_t(to_milliseconds(heard));
  wifi_.put(std::move(signal), heard);
}

void TracePlayer::collect_beacon(const walk::BeaconRow& row, TimePoint heard) {
  const walk::BeaconIdentity& identity = walk_.beacons[row.beacon];
  auto& beacon = *heard_.add_beacon_list();
  beacon.set_uuid(identity.uuid);
  beacon.set_major(identity.major);
  beacon.set_minor(identity.minor);
  beacon.set_address(walk_.transmitters[row.transmitter]);
  beacon.set_rssi(static_cast<int>(std::lround(row.rssi_dbm)));
  if (identity.measured_power_dbm) {
    beacon.set_measured_power(*identity.measured_power_dbm);
    beacon.set_distance(distance_m(*identity.measured_power_dbm, row.rssi_dbm));
  }
  beacon.set_t(std::max<std::int64_t>(0, to_milliseconds(heard)));
}

void TracePlayer::put_beacons() {
  if (heard_.beacon_list().empty()) return;
  std::stable_sort(heard_.mutable_beacon_list()->begin(), heard_.mutable_beacon_list()->end(),
                   [](const auto& a, const auto& b) { return a.rssi() > b.rssi(); });
  // Where it is as old as its newest reading, the ages of all of them are what the recording says.
  std::int64_t newest_ms = 0;
  for (const auto& beacon : heard_.beacon_list()) newest_ms = std::max(newest_ms, std::int64_t{beacon.t()});
  beacons_.put(std::exchange(heard_, {}), TimePoint(std::chrono::milliseconds(newest_ms)));
}

}  // namespace fiona::trace_player
