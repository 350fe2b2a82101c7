#pragma once

#include <optional>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
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
  void produce_orientation();
  void rebuild();

  Params<StepHeadingParams> params_{*this, nullptr, &StepHeading::rebuild};
  Requires<sensors::GetIMUService> imu_{
      *this, "imu", &StepHeading::on_imu, {.doc = "of a device that a person carries"}};
  Provides<localisation::StepProvider> steps_{*this, "steps", {.doc = "each step, about 0.1 s after the foot fell"}};
  Provides<localisation::OrientationProvider> orientation_{
      *this,
      "orientation",
      &StepHeading::produce_orientation,
      std::chrono::milliseconds(20),
      {.doc = "how the device is turned; not valid while nothing is measured"}};

  std::optional<steps::StepTracker> tracker_;
  std::optional<std::chrono::milliseconds> last_step_, last_sample_;
};

}  // namespace fiona::step_heading
