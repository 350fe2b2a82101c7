#include "fiona/simulator/radio_model.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

#include <fiona/error.hpp>

namespace fiona::simulator {
namespace {

constexpr double kPhoneHeight_m = 1.2;
/// Beacons are heard on one of three channels, each with its own fading: advertised about every 200 ms.
constexpr double kBeaconPeriod_ms = 200.0;

[[noreturn]] void refuse(const building::Building& building, const building::Landmark& landmark, const std::string& key,
                         const std::string& expected) {
  throw Error(ErrorCode::Failed, {.what = "a transmitter of " + building.name() + " cannot be read",
                                  .where = text(landmark.id),
                                  .expected = expected,
                                  .found = key + "=" + landmark.tags.at(key),
                                  .next = "correct the tag in the building file"});
}

int number(const building::Building& building, const building::Landmark& landmark, const std::string& key, int fallback,
           int low, int high) {
  const auto tag = landmark.tags.find(key);
  if (tag == landmark.tags.end()) return fallback;
  int value = 0;
  const char* const end = tag->second.data() + tag->second.size();
  const auto read = std::from_chars(tag->second.data(), end, value);
  if (read.ec != std::errc{} || read.ptr != end || value < low || value > high) {
    refuse(building, landmark, key, "a whole number from " + std::to_string(low) + " to " + std::to_string(high));
  }
  return value;
}

bool take_number(std::string_view& text, char before, int& value) {
  if (text.empty() || text.front() != before) return false;
  const auto read = std::from_chars(text.data() + 1, text.data() + text.size(), value);
  if (read.ec != std::errc{} || value < 0 || value > 65535) return false;
  text.remove_prefix(static_cast<std::size_t>(read.ptr - text.data()));
  return true;
}

}  // namespace

RadioOptions drawn_radio(std::uint64_t seed) {
  Random random(seed, hash("radio-world"));
  RadioOptions options;
  options.path_loss_exponent = random.uniform(1.8, 2.6);
  options.most_wall_loss_db = random.uniform(35.0, 50.0);
  options.floor_loss_db = random.uniform(14.0, 22.0);
  options.shadowing_db = random.uniform(3.0, 6.0);
  options.shadowing_size_m = random.uniform(1.5, 5.0);
  options.wifi_noise_db = random.uniform(1.5, 3.0);
  options.beacon_noise_db = random.uniform(2.5, 5.0);
  options.miss_share = random.uniform(0.03, 0.15);
  return options;
}

double beacon_distance_m(int measured_power_dbm, int rssi_dbm) {
  return std::pow(10.0, (measured_power_dbm - rssi_dbm) / 20.0);
}

RadioModel::RadioModel(const building::Building& building, std::uint64_t seed, RadioOptions options, std::uint64_t run)
    : building_(building), options_(options), seed_(seed), random_(seed, hash("radio") + run) {
  for (const building::Landmark& landmark : building.landmarks()) add(landmark);
  next_scan_ = options_.scan_period;
  next_batch_ = options_.batch_period;
}

void RadioModel::add(const building::Landmark& landmark) {
  const auto wifi = landmark.tags.find("fiona:wifi");
  const auto beacon = landmark.tags.find("fiona:beacon");
  if (wifi == landmark.tags.end() && beacon == landmark.tags.end()) return;
  const bool is_wifi = wifi != landmark.tags.end();
  const std::string& name = is_wifi ? wifi->second : beacon->second;
  // The shadows of a transmitter do not change when others are added to the building.
  Random shadows{seed_, hash(name.c_str())};
  Transmitter made{.name = name, .wifi = is_wifi, .shadowing = SpatialField{shadows, options_.shadowing_size_m}};
  made.at = landmark.at;
  made.level = landmark.level;
  made.height_m = building_.height_m(landmark.level) + landmark.height_m;
  if (is_wifi) {
    made.frequency_mhz = number(building_, landmark, "fiona:frequency_mhz", 2412, 2400, 7200);
    made.power_1m_dbm = number(building_, landmark, "fiona:power_1m", -40, -100, 0);
  } else {
    made.power_1m_dbm = number(building_, landmark, "fiona:measured_power", -59, -127, 0);
    std::string_view rest = name;
    made.uuid = rest.substr(0, std::min(rest.find('/'), rest.size()));
    rest.remove_prefix(made.uuid.size());
    if (made.uuid.size() != 36 || !take_number(rest, '/', made.major) || !take_number(rest, '/', made.minor) ||
        !rest.empty()) {
      refuse(building_, landmark, "fiona:beacon", "UUID/MAJOR/MINOR, the numbers from 0 to 65535");
    }
  }
  const double span_ms = is_wifi ? static_cast<double>(options_.scan_sweep.count()) : kBeaconPeriod_ms;
  made.next = milliseconds(static_cast<std::int64_t>(random_.uniform(0.0, span_ms)));
  if (is_wifi) made.next += options_.scan_period - options_.scan_sweep;
  transmitters_.push_back(std::move(made));
}

double RadioModel::mean_rssi_dbm(std::size_t transmitter, const Truth& truth) const {
  const Transmitter& from = transmitters_[transmitter];
  const building::Point here{truth.x_m, truth.y_m};
  const double phone_m = truth.height_m + kPhoneHeight_m;
  const double plane_m = distance_m(from.at, here);
  const double distance = std::max(0.3, std::hypot(plane_m, from.height_m - phone_m));
  const double walls = building_.walls_crossed(from.at, from.height_m, here, phone_m).attenuation_db;
  const double floors = std::abs(std::floor(truth.level + 0.25) - std::floor(from.level));
  const double floor_loss =
      floors > 0.0 ? options_.floor_loss_db * std::pow(floors, (floors + 2.0) / (floors + 1.0) - 0.46) : 0.0;
  const double shadow = options_.shadowing_db * from.shadowing.at(truth.x_m, truth.y_m, truth.height_m);
  return from.power_1m_dbm - 10.0 * options_.path_loss_exponent * std::log10(distance) -
         std::min(walls, options_.most_wall_loss_db) - floor_loss + shadow;
}

std::optional<int> RadioModel::receive(std::size_t transmitter, const Truth& truth, double noise_db,
                                       double sensitivity_dbm) {
  const double rssi = mean_rssi_dbm(transmitter, truth) + noise_db * random_.normal();
  const bool missed = random_.uniform() < options_.miss_share;
  if (missed || rssi < sensitivity_dbm) return std::nullopt;
  return static_cast<int>(std::lround(std::min(rssi, -10.0)));
}

void RadioModel::hear(const Truth& truth) {
  for (std::size_t i = 0; i < transmitters_.size(); ++i) {
    Transmitter& from = transmitters_[i];
    while (from.next <= truth.t) {
      const milliseconds at = from.next;
      if (from.wifi) {
        from.next += options_.scan_period;
        if (const auto rssi = receive(i, truth, options_.wifi_noise_db, options_.wifi_sensitivity_dbm)) {
          from.last = WifiReading{from.name, *rssi, from.frequency_mhz, at};
        }
        continue;
      }
      from.next += milliseconds(static_cast<std::int64_t>(kBeaconPeriod_ms + random_.uniform(0.0, 10.0)));
      const auto rssi = receive(i, truth, options_.beacon_noise_db, options_.beacon_sensitivity_dbm);
      if (!rssi) continue;
      const int power = static_cast<int>(from.power_1m_dbm);
      heard_beacons_.push_back({at, from.uuid, from.major, from.minor, power, *rssi, beacon_distance_m(power, *rssi)});
    }
  }
}

WifiScan RadioModel::scan(milliseconds t) {
  WifiScan made{t, {}};
  for (Transmitter& from : transmitters_) {
    if (!from.last) continue;
    const milliseconds age = t - from.last->heard;
    if (age > options_.stale_age) {
      from.last.reset();
    } else if (age <= options_.scan_sweep || random_.uniform() < options_.stale_share) {
      made.readings.push_back(*from.last);
    }
  }
  std::stable_sort(made.readings.begin(), made.readings.end(),
                   [](const WifiReading& a, const WifiReading& b) { return a.rssi_dbm > b.rssi_dbm; });
  return made;
}

RadioOutput RadioModel::advance(const Truth& truth) {
  RadioOutput output;
  hear(truth);
  for (; next_scan_ <= truth.t; next_scan_ += options_.scan_period) output.scans.push_back(scan(next_scan_));
  for (; next_batch_ <= truth.t; next_batch_ += options_.batch_period) {
    BeaconBatch batch{next_batch_, {}};
    const auto later = std::stable_partition(heard_beacons_.begin(), heard_beacons_.end(),
                                             [&](const BeaconReading& r) { return r.heard <= next_batch_; });
    batch.readings.assign(heard_beacons_.begin(), later);
    heard_beacons_.erase(heard_beacons_.begin(), later);
    std::stable_sort(batch.readings.begin(), batch.readings.end(),
                     [](const BeaconReading& a, const BeaconReading& b) { return a.heard < b.heard; });
    output.batches.push_back(std::move(batch));
  }
  return output;
}

std::string beacon_address(const BeaconReading& beacon) {
  const std::string name = beacon.uuid + "/" + std::to_string(beacon.major) + "/" + std::to_string(beacon.minor);
  const std::uint64_t bits = hash(name.c_str());
  std::string address;
  for (int shift = 40; shift >= 0; shift -= 8) {
    char octet[4];
    std::snprintf(octet, sizeof octet, shift > 0 ? "%02x:" : "%02x", static_cast<unsigned>(bits >> shift & 0xffu));
    address += octet;
  }
  return address;
}

}  // namespace fiona::simulator
