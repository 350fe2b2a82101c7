#include "journey.hpp"

#include <fiona/walk/imu_merger.hpp>

#include "step_tracker.hpp"

namespace fiona::radio {

Journey journey_of(const walk::Walk& walk) {
  Journey journey{.name = walk.name,
                  .transmitters = walk.transmitters,
                  .told = {},
                  .way_points = walk::way_points_of(walk),
                  .has_steps = walk.has_inertial_rows()};
  if (walk.events.empty()) return journey;
  journey.begin = Time(walk.events.front().t_ms);
  journey.end = Time(walk.events.back().t_ms);
  walk::ImuMerger merger;
  steps::StepTracker tracker;
  for (const walk::Event& event : walk.events) {
    const Time time(event.t_ms);
    if (const auto* wifi = std::get_if<walk::WifiRow>(&event.data)) {
      journey.told.push_back(
          {time, Journey::Row{wifi->transmitter, Radio::WiFi, wifi->rssi_dbm, Time(wifi->heard_ms)}});
    } else if (const auto* beacon = std::get_if<walk::BeaconRow>(&event.data)) {
      journey.told.push_back({time, Journey::Row{beacon->transmitter, Radio::Bluetooth, beacon->rssi_dbm, time}});
    } else if (const auto imu = merger.feed(event)) {
      const auto step = tracker.feed({Time(imu->t_ms), Eigen::Vector3d(imu->acceleration_g),
                                      Eigen::Vector3d(imu->rate_dps), Eigen::Vector3d(imu->field_gauss)});
      if (!step) continue;
      journey.told.push_back({time, StepInput{step->time, step->length_m, step->length_sd_m, step->heading_rad,
                                              step->heading_sd_rad, step->compass_rad}});
    }
  }
  return journey;
}

void replay(const Journey& journey, RadioFilter& filter, Time every, const std::function<void(Time)>& show) {
  Time next = every * (journey.begin / every + 1);
  const auto show_until = [&](Time time) {
    for (; next < time; next += every) {
      filter.advance(next);
      show(next);
    }
  };
  for (const Journey::Told& told : journey.told) {
    show_until(told.time);
    if (const auto* step = std::get_if<StepInput>(&told.what)) {
      filter.step(*step);
    } else {
      const auto& row = std::get<Journey::Row>(told.what);
      filter.signal(told.time, {journey.transmitters[row.transmitter], row.radio, row.rssi_dbm, row.heard});
    }
  }
  show_until(journey.end + every);
}

}  // namespace fiona::radio
