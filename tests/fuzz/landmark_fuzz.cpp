// Points of attention as users' profiles have them: any text gives none, or one at a finite place.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "landmarks.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto point = fiona::guidance::parse_landmark({reinterpret_cast<const char*>(data), size});
  if (!point) return 0;
  const auto& place = point->place;
  if (!std::isfinite(place.at.x_m) || !std::isfinite(place.at.y_m) || !std::isfinite(place.level)) std::abort();
  return point->name.size() > size ? (std::abort(), 0) : 0;
}
