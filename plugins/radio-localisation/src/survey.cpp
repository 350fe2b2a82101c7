#include "survey.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

namespace fiona::radio {
namespace {

using WayPoints = std::vector<std::pair<std::int64_t, walk::WayPoint>>;

constexpr std::int64_t kPathStep_ms = 250;
constexpr std::int64_t kMargin_ms = 1500;   // the surveyor stands at the first and last way-point about so long
constexpr std::int64_t kStampLag_ms = 600;  // as FilterOptions::stamp_lag
constexpr std::int64_t kBeaconSweep_ms = 1000;

std::optional<walk::WayPoint> surveyed_position(const WayPoints& points, std::int64_t t_ms) {
  if (t_ms < points.front().first - kMargin_ms || t_ms > points.back().first + kMargin_ms) return std::nullopt;
  return walk::position_at(points, t_ms);
}

void add_path(RadioMapLearner& learner, const WayPoints& points) {
  for (std::int64_t t_ms = points.front().first; t_ms <= points.back().first; t_ms += kPathStep_ms) {
    if (const auto at = walk::position_at(points, t_ms)) learner.path(at->level, at->x_m, at->y_m);
  }
}

void add_wifi(RadioMapLearner& learner, const walk::Walk& walk, const WayPoints& points) {
  std::set<std::pair<std::uint32_t, std::int64_t>> known;
  std::set<std::int64_t> sweeps;
  for (const walk::Event& event : walk.events) {
    const auto* row = std::get_if<walk::WifiRow>(&event.data);
    if (row == nullptr || !known.emplace(row->transmitter, row->heard_ms).second) continue;
    sweeps.insert(event.t_ms);
    if (const auto at = surveyed_position(points, std::min(event.t_ms, row->heard_ms + kStampLag_ms))) {
      learner.heard(walk.transmitters[row->transmitter], Radio::WiFi, at->level, at->x_m, at->y_m, row->rssi_dbm);
    }
  }
  for (const std::int64_t t_ms : sweeps) {
    // A sweep over all channels ends shortly before its result is delivered.
    const auto at = surveyed_position(points, t_ms - 1000);
    if (at) learner.sweep(Radio::WiFi, at->level, at->x_m, at->y_m);
  }
}

/// Beacons send several times a second: their mean over a second is one row.
void add_beacons(RadioMapLearner& learner, const walk::Walk& walk, const WayPoints& points) {
  std::map<std::pair<std::int64_t, std::uint32_t>, std::pair<double, int>> seconds;
  for (const walk::Event& event : walk.events) {
    const auto* row = std::get_if<walk::BeaconRow>(&event.data);
    if (row == nullptr) continue;
    auto& [sum, count] = seconds[{event.t_ms / kBeaconSweep_ms, row->transmitter}];
    sum += row->rssi_dbm;
    ++count;
  }
  if (seconds.empty()) return;
  for (const auto& [key, rssi] : seconds) {
    const auto at = surveyed_position(points, key.first * kBeaconSweep_ms + kBeaconSweep_ms / 2);
    if (!at) continue;
    learner.heard(walk.transmitters[key.second], Radio::Bluetooth, at->level, at->x_m, at->y_m,
                  rssi.first / rssi.second);
  }
  for (std::int64_t t_ms = points.front().first; t_ms <= points.back().first; t_ms += kBeaconSweep_ms) {
    if (const auto at = walk::position_at(points, t_ms)) learner.sweep(Radio::Bluetooth, at->level, at->x_m, at->y_m);
  }
}

}  // namespace

std::optional<std::uint32_t> add_survey_walk(RadioMapLearner& learner, const walk::Walk& walk) {
  const WayPoints points = walk::way_points_of(walk);
  if (points.empty()) return std::nullopt;
  const std::uint32_t number = learner.begin_walk();
  add_path(learner, points);
  add_wifi(learner, walk, points);
  add_beacons(learner, walk, points);
  return number;
}

}  // namespace fiona::radio
