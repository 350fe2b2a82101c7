#include "step_heading.hpp"

#include <cmath>
#include <numbers>

#include "fiona/objects/imu.hpp"

namespace fiona::step_heading {
namespace {

/// A pause this long and the next step begins anew, not where the last one ended.
constexpr std::chrono::milliseconds kLongestStep{1500};

Eigen::Vector3d vector(const sensors::PhoneAxes::Vector& v) { return {v[0], v[1], v[2]}; }

}  // namespace

void StepHeading::rebuild() {
  steps::StepDetectorOptions detector;
  detector.weinberg_gain_m = params_->weinberg_gain();
  detector.least_swing_g = params_->least_swing();
  steps::HeadingFilterOptions heading;
  heading.declination_rad = params_->declination() * std::numbers::pi / 180.0;
  tracker_.emplace(detector, heading);
  last_step_.reset();
}

void StepHeading::on_imu(const Received<sensors::GetIMU>& imu) {
  const auto phone = sensors::to_phone_axes(*imu);
  if (!phone.acceleration_g || !phone.rotation_deg_s || !phone.magnetic_gauss) return;
  const std::chrono::milliseconds time(to_milliseconds(imu.origin));
  const auto step = tracker_->feed(
      {time, vector(*phone.acceleration_g), vector(*phone.rotation_deg_s), vector(*phone.magnetic_gauss)});
  if (!step) return steps_.still_valid();  // who stands still is not lost
  const bool follows = last_step_ && step->time - *last_step_ <= kLongestStep;
  localisation::CommStep message;
  message.set_t_begin(follows ? last_step_->count() : step->time.count());
  message.set_t_end(step->time.count());
  message.set_length(step->length_m);
  message.set_heading(std::remainder(step->heading_rad, 2 * std::numbers::pi));
  message.set_length_var(step->length_sd_m * step->length_sd_m);
  message.set_heading_var(step->heading_sd_rad * step->heading_sd_rad);
  message.set_is_valid(true);
  last_step_ = step->time;
  steps_.put(std::move(message), TimePoint(step->time));
}

}  // namespace fiona::step_heading
