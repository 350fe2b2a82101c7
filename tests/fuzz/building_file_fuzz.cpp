// OSM files of buildings, XML or PBF: any bytes give a building or one fiona::Error, and a building can be used: walked
// through, drawn, and told over a port.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include <fiona/building/building.hpp>
#include <fiona/error.hpp>

#include "level_map.hpp"
#include "raster.hpp"

namespace {

using fiona::building::Building;
using fiona::building::Room;

void use(const Building& building) {
  for (const Room& room : building.rooms()) {
    if (!std::isfinite(room.centre.x_m) || !std::isfinite(room.centre.y_m)) std::abort();
    building.room_at(room.centre, room.level);
    if (!room.name.empty() && building.room(room.name).name != room.name && building.room(room.name).ref != room.name)
      std::abort();
    building.to_local(building.to_wgs84(room.centre));
    building.walls_crossed(room.centre, building.height_m(room.level) + 1.0, {}, 1.0);
  }
  if (building.rooms().empty()) return;
  for (const bool all : {true, false}) {
    const auto route = building.route(building.rooms().front(), building.rooms().back(), {all, all, all, all ? 9 : 0});
    if (route && !(route->cost_s >= 0.0)) std::abort();
  }
}

void serve(const Building& building) {
  using namespace fiona::map_server;
  fiona::navigation::CommLevelMap again;
  if (!again.ParseFromString(level_map_of(building, "fuzz", {}).SerializeAsString())) std::abort();
  const PixelFrame frame = frame_of(building.plan(), 1.0);
  const Window window{0, 0, std::min(frame.columns, 500), std::min(frame.rows, 500)};
  const auto cells = draw(building.plan(), frame, window, building.levels().front().level, 0);
  if (image_of(cells, window).empty() || grid_of(cells, window).size() != cells.size()) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const Building building = Building::parse({reinterpret_cast<const char*>(data), size}, "fuzz.osm");
    use(building);
    serve(building);
  } catch (const fiona::Error&) {
  }
  return 0;
}
