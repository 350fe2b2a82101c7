#pragma once

#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>

#include "beacon_field.hpp"
#include "beacon_filter.hpp"
#include "beacon_map.hpp"
#include "floor_plan.hpp"

namespace fiona::beacons {

/// In the corners of a hall of 20 m.
inline constexpr const char* kFourBeacons =
    "name: 'hall'\n"
    "beacons { id: '02:00:00:00:00:01' x: 0 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: '02:00:00:00:00:02' x: 20 y: 0 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: '02:00:00:00:00:03' x: 0 y: 20 heard { level: 0 power: -59 } exponent: 2 }\n"
    "beacons { id: 'c0de/1/4' x: 20 y: 20 heard { level: 0 power: -59 } exponent: 2 }\n";

inline double rssi_dbm(double x, double y, int beacon) {
  const double dx = x - (beacon % 2 == 1 ? 20.0 : 0.0), dy = y - (beacon >= 2 ? 20.0 : 0.0);
  return -59 - 10 * std::log10(dx * dx + dy * dy + 1.0);
}

/// The hall with steel in its east, which turns compasses there to the left.
inline std::string with_steel(double from_x_m) {
  std::string text = kFourBeacons;
  for (int x = 0; x <= 20; ++x) {
    for (int y = 0; y <= 20; ++y)
      text += "compass { x: " + std::to_string(x) + " y: " + std::to_string(y) +
              " angle: " + (x < from_x_m ? "0.0" : "0.5") + " steps: 4 }\n";
  }
  return text;
}

/// A filter over the hall, for one who is heard there `offset_db` too strong.
struct Hall {
  explicit Hall(const FilterOptions& options = {}, navigation::CommLevelMap plan_map = {},
                const std::string& text = kFourBeacons)
      : map(parse(text, "hall")),
        field(std::make_shared<const BeaconField>(map)),
        filter(field, std::make_shared<const FloorPlan>(plan_map), map.accuracy(), map.radio().offset(), options) {}

  void readings(double x, double y, double offset_db = 0.0) {
    for (int beacon = 0; beacon < 4; ++beacon)
      filter.heard(static_cast<std::uint32_t>(beacon), rssi_dbm(x, y, beacon) + offset_db);
  }
  void hear(double x, double y, double offset_db = 0.0) {
    readings(x, y, offset_db);
    filter.advance(now += std::chrono::seconds(1));
  }

  BeaconMap map;
  std::shared_ptr<const BeaconField> field;
  BeaconFilter filter;
  Time now{0};
};

inline void add_wall(navigation::CommLevelMap& map, double x1, double y1, double x2, double y2, double level = 0) {
  auto& wall = *map.add_walls();
  wall.set_x1(x1), wall.set_y1(y1), wall.set_x2(x2), wall.set_y2(y2), wall.set_level(level);
}

}  // namespace fiona::beacons
