// fiona-beacon-filter-bench: what a cycle of smart-bluetooth-localization costs at 5 Hz, with 2,000 particles, walls
// and a survey: 99th percentile of the cycles that use a second of readings, two steps and five outputs a second.
// Beside it, measured in turns, the bare likelihood of as many particles, which no filter over such a map does without.
// Exit code 1 if the goal is short.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "beacon_filter.hpp"
#include "fiona/building/building.hpp"
#include "level_map.hpp"
#include "timing.hpp"

namespace {

namespace beacons = fiona::beacons;
using beacons::Time;
using fiona::bench::milliseconds_of;
using fiona::bench::percentile;

constexpr double kMost_ms = 30;
constexpr std::size_t kParticles = 2000;
constexpr int kSeconds = 300;
constexpr double kRound_m = 10.0;  // radius of the walk

beacons::BeaconMap map_of(const fiona::building::Building& building) {
  beacons::BeaconMap map;
  for (const auto& landmark : building.landmarks()) {
    const auto id = landmark.tags.find("fiona:beacon");
    if (id == landmark.tags.end()) continue;
    auto& beacon = *map.add_beacons();
    beacon.set_id(id->second);
    beacon.set_x(landmark.at.x_m);
    beacon.set_y(landmark.at.y_m);
    auto& on = *beacon.add_heard();
    on.set_level(static_cast<int>(landmark.level));
    on.set_power(-59);
  }
  *map.mutable_radio() = beacons::usual_radio();
  *map.mutable_accuracy() = beacons::careful_accuracy();
  return map;
}

}  // namespace

int main() {
  const auto building = fiona::building::Building::read(FIONA_INSTITUTE_FILE);
  const auto plan =
      std::make_shared<const beacons::FloorPlan>(fiona::map_server::level_map_of(building, "institute", {}));
  const auto map = map_of(building);
  const auto field = std::make_shared<const beacons::BeaconField>(map, plan->extents());
  beacons::FilterOptions options;
  options.particles = kParticles;
  beacons::BeaconFilter filter(field, plan, map.accuracy(), map.radio().offset(), options);
  std::vector<double> cycles_ms, bare_ms;
  const double step_rad = 1.3 / kRound_m;
  for (int second = 0; second < kSeconds; ++second) {
    const double angle = step_rad * second, x = 30 + kRound_m * std::cos(angle), y = 20 + kRound_m * std::sin(angle);
    std::vector<beacons::Heard> heard;
    for (std::uint32_t beacon = 0; beacon < field->beacons(); ++beacon) {
      const auto expected = field->at(0, x, y)[beacon];
      if (expected.mean_dbm > -95) heard.push_back({beacon, expected.mean_dbm});
    }
    for (const auto& one : heard) filter.heard(one.beacon, one.rssi_dbm);
    for (int output = 1; output <= 5; ++output) {
      const double took_ms = milliseconds_of([&] {
        if (output % 2 == 1) filter.step({0.65, 0.1, angle + M_PI / 2, 0.1});
        filter.advance(Time(1000 * second + 200 * output));
        filter.estimate();
      });
      cycles_ms.push_back(took_ms);
    }
    double sum = 0.0;
    bare_ms.push_back(milliseconds_of([&] {
      for (std::size_t i = 0; i < kParticles; ++i) {
        const double off = static_cast<double>(i % 40);
        sum += field->log_likelihood(field->at(0, x + off, y), heard, 0.0, options.silence);
      }
    }));
    if (!std::isfinite(sum)) return 1;
  }
  const double p99 = percentile(cycles_ms, 0.99), bare = percentile(bare_ms, 0.5);
  const bool ok = p99 <= kMost_ms;
  std::printf(
      "beacon filter, %zu particles, %zu beacons, walls: p99 of a cycle  %.2f ms  <= %.0f  %s   (%.1fx the bare "
      "likelihood's %.2f ms; median %.2f ms, longest %.2f ms)\n",
      kParticles, field->beacons(), p99, kMost_ms, ok ? "ok" : "short", p99 / bare, bare, percentile(cycles_ms, 0.5),
      cycles_ms.back());
  return ok ? 0 : 1;
}
