#pragma once

#include <optional>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/step_heading/params.pb.h"
#include "step_tracker.hpp"

namespace fiona::step_heading {

/// Steps, with length and direction, from an inertial unit.
class StepHeading final : public Component {
 public:
  using Component::Component;
  void on_start() override { rebuild(); }

 private:
  void on_imu(const Received<sensors::GetIMU>& imu);
  void rebuild();

  Params<StepHeadingParams> params_{*this, nullptr, &StepHeading::rebuild};
  Requires<sensors::GetIMUService> imu_{
      *this, "imu", &StepHeading::on_imu, {.doc = "of a device that a person carries"}};
  Provides<localisation::StepProvider> steps_{*this, "steps", {.doc = "each step, about 0.1 s after the foot fell"}};

  std::optional<steps::StepTracker> tracker_;
  std::optional<std::chrono::milliseconds> last_step_;
};

}  // namespace fiona::step_heading
