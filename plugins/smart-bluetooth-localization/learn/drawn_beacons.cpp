#include "drawn_beacons.hpp"

#include <charconv>
#include <cmath>
#include <string>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr int kUsualPower_dbm = -59;

int power_of(const building::Landmark& landmark, const std::string& file) {
  const auto tag = landmark.tags.find("fiona:measured_power");
  if (tag == landmark.tags.end()) return kUsualPower_dbm;
  int power = 0;
  const char* end = tag->second.data() + tag->second.size();
  const auto read = std::from_chars(tag->second.data(), end, power);
  if (read.ec != std::errc{} || read.ptr != end || power < -127 || power > 20) {
    throw Error(ErrorCode::Usage, {.what = "the power of a beacon cannot be read",
                                   .where = file + ", " + building::text(landmark.id),
                                   .expected = "fiona:measured_power=DBM, a whole number from -127 to 20",
                                   .found = tag->second});
  }
  return power;
}

}  // namespace

BeaconMap drawn_in(const building::Building& building) {
  BeaconMap map;
  map.set_name(building.name());
  set_reference(map, building.reference());
  for (const building::Landmark& landmark : building.landmarks()) {
    const auto id = landmark.tags.find("fiona:beacon");
    if (id == landmark.tags.end()) continue;
    auto& beacon = *map.add_beacons();
    beacon.set_id(id->second);
    beacon.set_x(landmark.at.x_m);
    beacon.set_y(landmark.at.y_m);
    auto& on = *beacon.add_heard();
    on.set_level(static_cast<int>(std::floor(landmark.level)));
    on.set_power(power_of(landmark, building.name()));
  }
  if (map.beacons().empty()) {
    throw Error(ErrorCode::NotFound, {.what = "no beacon is drawn in " + building.name(),
                                      .where = building.name(),
                                      .expected = "nodes with fiona:beacon=UUID/MAJOR/MINOR and a level",
                                      .next = "draw them, or learn them from a survey: fiona-beaconmap learn"});
  }
  return map;
}

}  // namespace fiona::beacons
