#pragma once

#include <fiona/component.hpp>
#include <optional>

#include "acme/step_counter/params.pb.h"
#include "fiona/localisation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"

namespace acme {

/// Counts the steps of whoever carries an inertial unit: one each time that the acceleration rises above a threshold.
class StepCounter final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void on_imu(const fiona::Received<fiona::sensors::GetIMU>& imu);

  fiona::Params<step_counter::StepCounterParams> params_{*this};
  fiona::Requires<fiona::sensors::GetIMUService> imu_{*this, "imu", &StepCounter::on_imu};
  fiona::Provides<fiona::localisation::StepProvider> steps_{*this, "steps"};

  bool above_ = false;
  std::optional<fiona::TimePoint> last_step_;
};

}  // namespace acme
