#include "surveyor.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "fiona/simulator/survey.hpp"
#include "level_map.hpp"
#include "step_tracker.hpp"
#include "survey_learner.hpp"
#include "survey_walks.hpp"

namespace fiona::walks {
namespace {

constexpr std::size_t kFoldsJudged = 4;  // of eight: twelve walks of a minute are enough for a covariance

std::uint32_t number_of(const std::string& id, radio::Journey& journey) {
  const auto known = std::find(journey.transmitters.begin(), journey.transmitters.end(), id);
  const auto number = static_cast<std::uint32_t>(known - journey.transmitters.begin());
  if (known == journey.transmitters.end()) journey.transmitters.push_back(id);
  return number;
}

}  // namespace

radio::Journey journey_of(const simulator::Trace& trace) {
  radio::Journey journey;
  journey.name = trace.id;
  journey.end = trace.duration;
  journey.has_steps = true;
  for (const simulator::Truth& at : trace.waypoints) {
    journey.way_points.emplace_back(at.t.count(), walk::WayPoint{at.x_m, at.y_m, static_cast<int>(trace.level)});
  }
  steps::StepTracker tracker;
  for (const simulator::ImuSample& imu : trace.imu) {
    const auto step =
        tracker.feed({imu.t, Eigen::Vector3d(imu.acceleration_g.data()), Eigen::Vector3d(imu.rotation_deg_s.data()),
                      Eigen::Vector3d(imu.magnetic_gauss.data())});
    if (!step) continue;
    journey.told.push_back({imu.t, radio::StepInput{step->time, step->length_m, step->length_sd_m, step->heading_rad,
                                                    step->heading_sd_rad, step->compass_rad}});
  }
  for (const simulator::BeaconReading& beacon : trace.beacons) {
    const std::uint32_t number = number_of(simulator::beacon_address(beacon), journey);
    journey.told.push_back({beacon.heard, radio::Journey::Row{number, radio::Radio::Bluetooth,
                                                              static_cast<float>(beacon.rssi_dbm), beacon.heard}});
  }
  std::stable_sort(journey.told.begin(), journey.told.end(),
                   [](const auto& one, const auto& other) { return one.time < other.time; });
  return journey;
}

std::vector<radio::Journey> survey_of(const building::Building& building, std::uint64_t seed) {
  simulator::SurveyOptions options;
  options.inertial_walks = std::numeric_limits<std::size_t>::max();
  options.radio = simulator::drawn_radio(seed);
  std::vector<radio::Journey> walks;
  for (const building::Level& level : building.levels()) {
    if (level.level != std::floor(level.level)) continue;
    for (const simulator::Trace& trace : simulator::survey_walk(building, level.level, seed, options))
      walks.push_back(journey_of(trace));
  }
  return walks;
}

beacons::BeaconMap surveyed(const building::Building& building, std::uint64_t seed) {
  const std::vector<radio::Journey> walks = survey_of(building, seed);
  std::vector<beacons::SurveySecond> seconds;
  for (std::size_t i = 0; i < walks.size(); ++i) {
    const auto more = beacons::seconds_of(walks[i], static_cast<std::uint32_t>(i));
    seconds.insert(seconds.end(), more.begin(), more.end());
  }
  beacons::BeaconMap map = beacons::learn(seconds, "survey");
  beacons::learn_compass(walks, map);
  const beacons::FloorPlan plan(map_server::level_map_of(building, "plan", {}));
  *map.mutable_accuracy() = beacons::accuracy_of(walks, plan, {}, kFoldsJudged);
  return map;
}

}  // namespace fiona::walks
