// Points of attention as users' profiles have them: any text gives none, or one at a finite place that is read again as
// it is written.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "fiona/objects/landmark.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto point = fiona::hmi::parse_landmark({reinterpret_cast<const char*>(data), size});
  if (!point) return 0;
  if (!std::isfinite(point->x()) || !std::isfinite(point->y()) || !std::isfinite(point->level())) std::abort();
  const auto again = fiona::hmi::parse_landmark(fiona::hmi::landmark_text(*point));
  if (!again || again->x() != point->x() || again->level() != point->level() || again->name() != point->name())
    std::abort();
  return 0;
}
