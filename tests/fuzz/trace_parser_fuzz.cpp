// The text of recorded walks: any bytes give a walk or one fiona::Error, and a walk can be used.
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include <fiona/error.hpp>
#include <fiona/walk/imu_merger.hpp>

#include "survey.hpp"
#include "trace_parser.hpp"

namespace {

constexpr std::size_t kMostEvents = 1000;

void use(const fiona::walk::Walk& walk) {
  fiona::walk::ImuMerger merger;
  for (const auto& event : walk.events) {
    merger.feed(event);
    if (const auto* row = std::get_if<fiona::walk::BeaconRow>(&event.data)) {
      static_cast<void>(walk.beacons.at(row->beacon));
      static_cast<void>(walk.transmitters.at(row->transmitter));
    }
  }
  const auto points = fiona::walk::way_points_of(walk);
  for (const auto& [t_ms, point] : points) fiona::walk::position_at(points, t_ms + 1);
  const bool long_walk = !points.empty() && points.back().first - points.front().first > 100'000;
  if (long_walk) return;  // correct, but slow: a point every quarter of a second
  fiona::radio::RadioMapLearner learner;
  fiona::radio::add_survey_walk(learner, walk);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  // The first bit: a walk of a floor's folder, or one whose way-points say their level.
  const bool of_floor = size > 0 && (data[0] & 1) != 0;
  if (size > 0) text.remove_prefix(1);
  try {
    fiona::walk::TraceParser parser("fuzz", of_floor ? std::optional<int>(0) : std::nullopt, kMostEvents);
    while (!text.empty()) {
      const auto end = text.find('\n');
      parser.line(text.substr(0, end));
      text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    }
    use(parser.finish());
  } catch (const fiona::Error&) {
  }
  return 0;
}
