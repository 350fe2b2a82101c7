#pragma once

#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace fiona::walk {

/// Rows of a recorded walk in the units of the recording. Phone axes: x right, y up the screen, z out of the screen.

/// Specific force, gravity included, m/s^2.
struct Accelerometer {
  float x, y, z;
};
/// Angular rate, rad/s.
struct Gyroscope {
  float x, y, z;
};
/// Magnetic field, microtesla.
struct Magnetometer {
  float x, y, z;
};
/// Android's fused attitude without its scalar part; for comparison only, the live system does not use it.
struct RotationVector {
  float x, y, z;
};
/// One row of a Wi-Fi scan result. `heard_ms` is when the phone really heard it: scan results repeat old rows.
struct WifiRow {
  std::uint32_t transmitter;  ///< index into Walk::transmitters (the BSSID)
  float rssi_dbm;
  std::int32_t frequency_mhz;
  std::int64_t heard_ms;  ///< equals the event's time where the recording does not say
};
/// What an iBeacon says of itself. Several transmitters may say the same.
struct BeaconIdentity {
  std::string uuid;                            ///< lower-case
  std::uint32_t major = 0, minor = 0;          ///< 0 to 65535
  std::optional<int> measured_power_dbm = {};  ///< RSSI at 1 m, where the recording says it

  auto operator<=>(const BeaconIdentity&) const = default;
};
/// One iBeacon advertisement.
struct BeaconRow {
  std::uint32_t transmitter;  ///< index into Walk::transmitters (the MAC address)
  std::uint32_t beacon;       ///< index into Walk::beacons
  float rssi_dbm;
};
/// Air pressure, hPa.
struct Pressure {
  float hectopascal;
};
/// The surveyor stood here: metres in the building's frame, x east, y north; level as OSM counts (ground 0).
struct WayPoint {
  double x_m, y_m;
  int level;
};

using EventData =
    std::variant<Accelerometer, Gyroscope, Magnetometer, RotationVector, WifiRow, BeaconRow, Pressure, WayPoint>;

struct Event {
  std::int64_t t_ms;  ///< since the walk's start; for a Wi-Fi row: when the scan result was delivered
  EventData data;
};

/// One recorded walk. Events are sorted by time; rows of equal time keep the order of the file.
struct Walk {
  std::string name;
  std::optional<std::int64_t> start_ms;   ///< Unix time of t = 0, where the recording says it
  std::optional<int> level;               ///< of survey walks that stay on one level
  std::vector<std::string> transmitters;  ///< identifiers that the rows refer to
  std::vector<BeaconIdentity> beacons;    ///< identities that the beacon rows refer to
  std::vector<Event> events;

  bool has_inertial_rows() const;
};

/// Where the surveyor was at `t_ms`: straight and even between way-points, clamped at both ends. Empty without
/// way-points, or when the time lies between way-points of different levels (on the stairs nobody knows).
std::optional<WayPoint> position_at(const std::vector<std::pair<std::int64_t, WayPoint>>& way_points,
                                    std::int64_t t_ms);

/// The way-points of a walk with their times, in order; repeated rows are kept once.
std::vector<std::pair<std::int64_t, WayPoint>> way_points_of(const Walk& walk);

}  // namespace fiona::walk
