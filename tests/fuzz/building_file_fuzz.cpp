// OSM files of buildings: any bytes give a building or one fiona::Error, and a building can be used.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include <fiona/building/building.hpp>
#include <fiona/error.hpp>

namespace {

using fiona::building::Building;
using fiona::building::Room;

void use(const Building& building) {
  for (const Room& room : building.rooms()) {
    if (!std::isfinite(room.centre.x_m) || !std::isfinite(room.centre.y_m)) std::abort();
    building.room_at(room.centre, room.level);
    building.walls_crossed(room.centre, building.height_m(room.level) + 1.0, {}, 1.0);
  }
  if (building.rooms().empty()) return;
  const auto route = building.route(building.rooms().front(), building.rooms().back());
  if (route && !(route->cost_s >= 0.0)) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    use(Building::parse({reinterpret_cast<const char*>(data), size}, "fuzz.osm"));
  } catch (const fiona::Error&) {
  }
  return 0;
}
