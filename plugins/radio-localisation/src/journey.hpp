#pragma once

#include <functional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <fiona/walk/walk.hpp>

#include "radio_filter.hpp"

namespace fiona::radio {

/// What a filter would have been told on a recorded walk, with the steps already counted: a hundredth of the walk.
struct Journey {
  struct Row {
    std::uint32_t transmitter;  ///< index into transmitters
    Radio radio;
    float rssi_dbm;
    Time heard;
  };
  struct Told {
    Time time;
    std::variant<StepInput, Row> what;
  };
  std::string name;
  std::vector<std::string> transmitters;
  std::vector<Told> told;
  std::vector<std::pair<std::int64_t, walk::WayPoint>> way_points;
  Time begin{}, end{};     ///< of all rows, inertial ones too
  bool has_steps = false;  ///< the walk has inertial rows
};

Journey journey_of(const walk::Walk& walk);

/// Tells the filter the journey in the order of time, and calls show(time) at each multiple of `every` once all before
/// it was told: what a live navigator would show.
void replay(const Journey& journey, RadioFilter& filter, Time every, const std::function<void(Time)>& show);

}  // namespace fiona::radio
