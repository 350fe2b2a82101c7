#pragma once

#include <optional>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/step_heading/params.pb.h"
#include "step_tracker.hpp"

namespace fiona::step_heading {

/// Steps, with length and direction, from an inertial unit, and how it is turned.
class StepHeading final : public Component {
 public:
  using Component::Component;
  void on_start() override { rebuild(); }

 private:
  void on_imu(const Received<sensors::GetIMU>& imu);
  void note_no_heading(std::chrono::milliseconds time);
  void produce_orientation();
  Async<> look_for_map();
  double declination_rad() const;
  void rebuild();

  Params<StepHeadingParams> params_{*this, nullptr, &StepHeading::rebuild};
  Requires<sensors::GetIMUService> imu_{
      *this, "imu", &StepHeading::on_imu, {.doc = "of a device that a person carries"}};
  Requires<navigation::LevelMap> map_{
      *this,
      "levels",
      {.optional = true,
       .doc = "of the building: its place says where magnetic north is; without it the parameter declination does"}};
  Provides<localisation::StepProvider> steps_{*this, "steps", {.doc = "each step, about 0.1 s after the foot fell"}};
  Provides<localisation::OrientationProvider> orientation_{
      *this,
      "orientation",
      &StepHeading::produce_orientation,
      std::chrono::milliseconds(20),
      {.doc = "how the device is turned; not valid while nothing is measured"}};

  Probe<double> declination_{*this,
                             "magnetic_north",
                             {.unit = "deg", .doc = "the bearing of magnetic north in use, clockwise from true north"}};
  Task look_{*this, "look_for_map", std::chrono::milliseconds(1000), &StepHeading::look_for_map};

  std::optional<steps::StepTracker> tracker_;
  std::optional<double> declination_of_map_rad_;
  std::optional<std::chrono::milliseconds> last_step_, last_sample_;
  std::optional<std::chrono::milliseconds> unaligned_since_;
  bool no_heading_told_ = false;
};

}  // namespace fiona::step_heading
