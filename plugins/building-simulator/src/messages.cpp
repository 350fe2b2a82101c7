#include "messages.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <tuple>
#include <vector>

#include "fiona/objects/imu.hpp"

namespace fiona::simulator {
namespace {

constexpr double kTurn_rad = 2.0 * std::numbers::pi;
constexpr int kCovarianceElements = 9;

double radians_of(double degrees) { return degrees * std::numbers::pi / 180.0; }

/// Into 0 to 2 pi, as orientations are given.
double wrapped(double angle_rad) {
  const double rest = std::fmod(angle_rad, kTurn_rad);
  return rest < 0.0 ? rest + kTurn_rad : rest;
}

struct Heard {
  BeaconReading last{};
  int count = 0;
  int sum_dbm = 0;
};

}  // namespace

sensors::GetIMU imu_message(const ImuSample& sample) {
  return sensors::from_phone_axes({.acceleration_g = sample.acceleration_g,
                                   .rotation_deg_s = sample.rotation_deg_s,
                                   .magnetic_gauss = sample.magnetic_gauss});
}

sensors::RFSignalRSSI wifi_message(const WifiReading& reading, const std::string& receiver, TimePoint begun) {
  sensors::RFSignalRSSI message;
  message.set_transmitter_id(reading.bssid);
  message.set_receiver_id(receiver);
  message.set_rf_type("WiFi");
  message.set_rss(static_cast<float>(reading.rssi_dbm));
  message.set_t(to_milliseconds(begun + reading.heard));
  return message;
}

sensors::CommiBeaconList beacon_list(const BeaconBatch& batch, TimePoint begun) {
  std::map<std::tuple<std::string, int, int>, Heard> beacons;
  for (const BeaconReading& reading : batch.readings) {
    Heard& heard = beacons[{reading.uuid, reading.major, reading.minor}];
    heard.last = reading;
    heard.sum_dbm += reading.rssi_dbm;
    ++heard.count;
  }
  std::vector<BeaconReading> rows;
  for (auto& [id, heard] : beacons) {
    heard.last.rssi_dbm = static_cast<int>(std::lround(static_cast<double>(heard.sum_dbm) / heard.count));
    rows.push_back(heard.last);
  }
  std::stable_sort(rows.begin(), rows.end(),
                   [](const BeaconReading& a, const BeaconReading& b) { return a.rssi_dbm > b.rssi_dbm; });
  sensors::CommiBeaconList list;
  for (const BeaconReading& row : rows) {
    auto& beacon = *list.add_beacon_list();
    beacon.set_uuid(row.uuid);
    beacon.set_major(static_cast<std::uint32_t>(row.major));
    beacon.set_minor(static_cast<std::uint32_t>(row.minor));
    beacon.set_address(beacon_address(row));
    beacon.set_measured_power(row.measured_power_dbm);
    beacon.set_rssi(row.rssi_dbm);
    beacon.set_distance(static_cast<float>(beacon_distance_m(row.measured_power_dbm, row.rssi_dbm)));
    beacon.set_t(to_milliseconds(begun + row.heard));
  }
  return list;
}

localisation::CommLocation truth_message(const Truth& truth, const ImuOptions& phone) {
  localisation::CommLocation location;
  auto& position = *location.mutable_position();
  position.set_x(truth.x_m);
  position.set_y(truth.y_m);
  position.set_z(truth.level);
  position.set_is_valid(true);
  auto& orientation = *location.mutable_orientation();
  // Headings go clockwise from true north, yaw counter-clockwise from magnetic north.
  orientation.set_yaw(wrapped(radians_of(phone.declination_deg) - truth.heading_rad));
  // The phone's x axis is the device's y axis turned round: a raised top edge is a negative pitch.
  orientation.set_pitch(wrapped(-radians_of(phone.pitch_deg)));
  orientation.set_roll(wrapped(radians_of(phone.roll_deg)));
  orientation.set_is_valid(true);
  for (int i = 0; i < kCovarianceElements; ++i) {
    position.add_confidence(0.0);
    orientation.add_confidence(0.0);
  }
  location.set_is_valid(true);
  return location;
}

}  // namespace fiona::simulator
