#include "step_counter.hpp"

#include <cmath>
#include <fiona/plugin.hpp>
#include <numbers>

namespace acme {

void StepCounter::on_imu(const fiona::Received<fiona::sensors::GetIMU>& imu) {
  if (!imu->has_out_x_ac() || !imu->has_out_y_ac() || !imu->has_out_z_ac()) return;
  const double norm_g = std::hypot(imu->out_x_ac(), imu->out_y_ac(), imu->out_z_ac());
  const bool rises = norm_g > params_->threshold() && !above_;
  above_ = norm_g > params_->threshold();
  if (!rises) return;
  const std::chrono::duration<double> shortest(params_->shortest_step());
  if (last_step_ && imu.origin - *last_step_ < shortest) return;

  fiona::localisation::CommStep step;
  step.set_t_begin(fiona::to_milliseconds(last_step_.value_or(imu.origin)));
  step.set_t_end(fiona::to_milliseconds(imu.origin));
  step.set_length(params_->stride());
  // Any direction: the variance of an angle of which nothing is known.
  step.set_heading_var(std::numbers::pi * std::numbers::pi / 3);
  step.set_is_valid(true);
  last_step_ = imu.origin;
  steps_.put(std::move(step), imu.origin);
}

}  // namespace acme

FIONA_PLUGIN(plugin) { plugin.add<acme::StepCounter>("step-counter", "Counts steps by a threshold"); }
