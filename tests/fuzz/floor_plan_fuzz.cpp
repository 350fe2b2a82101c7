// Floor plans as GeoJSON: any two texts give a floor or one fiona::Error, and its shapes are finite and can be drawn.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include <fiona/building/floor_folders.hpp>
#include <fiona/error.hpp>

namespace {

void check(const fiona::building::Plan& plan) {
  for (const auto& room : plan.rooms) {
    if (!std::isfinite(room.centre.x_m) || !std::isfinite(room.centre.y_m)) std::abort();
    for (const auto& corner : room.polygon.outer) {
      if (!std::isfinite(corner.x_m) || !std::isfinite(corner.y_m)) std::abort();
    }
  }
}

}  // namespace

// The first line: floor_info.json; the rest: geojson_map.json.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const std::size_t end = text.find('\n');
  if (end == std::string_view::npos) return 0;
  fiona::building::Plan plan;
  try {
    fiona::building::add_floor(plan, text.substr(0, end), text.substr(end + 1), "fuzz");
    check(plan);
  } catch (const fiona::Error&) {
  }
  return 0;
}
