#include "step_heading.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "fiona/building/declination.hpp"
#include "fiona/objects/imu.hpp"

namespace fiona::step_heading {
namespace {

/// A pause this long and the next step begins anew, not where the last one ended.
constexpr std::chrono::milliseconds kLongestStep{1500};
constexpr std::chrono::milliseconds kOldestSample{500};
constexpr std::chrono::milliseconds kAlignsWithin{3000};
constexpr double kTiltSd_rad = 0.05;  // of gravity's direction in the hand of one who walks

Eigen::Vector3d vector(const sensors::PhoneAxes::Vector& v) { return {v[0], v[1], v[2]}; }

/// Into 0 to 2 pi, as orientations are given.
double wrapped(double angle_rad) {
  const double rest = std::remainder(angle_rad, 2 * std::numbers::pi);
  return rest < 0.0 ? rest + 2 * std::numbers::pi : rest;
}

/// The attitude turns phone axes to east, magnetic north, up; an orientation has device axes (x to the phone's top, y
/// to its left) and magnetic north, west, up.
localisation::CommOrientation orientation_of(const Eigen::Quaterniond& attitude, double heading_sd_rad) {
  const auto in_world = [&](const Eigen::Vector3d& phone) {
    const Eigen::Vector3d v = attitude * phone;
    return Eigen::Vector3d(v.y(), -v.x(), v.z());
  };
  const Eigen::Vector3d ahead = in_world(Eigen::Vector3d::UnitY());
  const Eigen::Vector3d left = in_world(-Eigen::Vector3d::UnitX());
  const Eigen::Vector3d up = in_world(Eigen::Vector3d::UnitZ());
  localisation::CommOrientation orientation;
  orientation.set_yaw(wrapped(std::atan2(ahead.y(), ahead.x())));
  orientation.set_pitch(wrapped(-std::asin(std::clamp(ahead.z(), -1.0, 1.0))));
  orientation.set_roll(wrapped(std::atan2(left.z(), up.z())));
  const double tilt = kTiltSd_rad * kTiltSd_rad;
  for (const double v : {heading_sd_rad * heading_sd_rad, 0.0, 0.0, 0.0, tilt, 0.0, 0.0, 0.0, tilt}) {
    orientation.add_confidence(v);
  }
  orientation.set_is_valid(true);
  return orientation;
}

}  // namespace

void StepHeading::rebuild() {
  steps::StepDetectorOptions detector;
  detector.weinberg_gain_m = params_->weinberg_gain();
  detector.least_swing_g = params_->least_swing();
  tracker_.emplace(detector, steps::HeadingFilterOptions());
  last_step_.reset();
  last_sample_.reset();
  unaligned_since_.reset();
}

double StepHeading::declination_rad() const {
  return declination_of_map_rad_.value_or(params_->declination() * std::numbers::pi / 180.0);
}

Async<> StepHeading::look_for_map() {
  declination_.set(declination_rad() * 180.0 / std::numbers::pi);
  if (map_.connection() != Connection::Connected) declination_of_map_rad_.reset();
  if (declination_of_map_rad_ || map_.connection() != Connection::Connected) co_return;
  const auto map = co_await map_.query({});
  if (!map || !(*map)->reference().has_reference_lat() || !(*map)->reference().has_reference_long()) co_return;
  const auto& place = (*map)->reference();
  declination_of_map_rad_ = building::declination_rad(place.reference_lat(), place.reference_long(),
                                                      std::chrono::milliseconds(to_milliseconds(now())));
}

void StepHeading::on_imu(const Received<sensors::GetIMU>& imu) {
  const auto phone = sensors::to_phone_axes(*imu);
  if (!phone.acceleration_g || !phone.rotation_deg_s || !phone.magnetic_gauss) return;
  const std::chrono::milliseconds time(to_milliseconds(imu.origin));
  last_sample_ = time;
  const auto step = tracker_->feed(
      {time, vector(*phone.acceleration_g), vector(*phone.rotation_deg_s), vector(*phone.magnetic_gauss)});
  if (!tracker_->heading().is_aligned()) return note_no_heading(time);
  unaligned_since_.reset();
  if (!step) return steps_.still_valid();  // who stands still is not lost
  const bool follows = last_step_ && step->time - *last_step_ <= kLongestStep;
  localisation::CommStep message;
  message.set_t_begin(follows ? last_step_->count() : step->time.count());
  message.set_t_end(step->time.count());
  message.set_length(step->length_m);
  message.set_heading(std::remainder(step->heading_rad - declination_rad(), 2 * std::numbers::pi));
  message.set_length_var(step->length_sd_m * step->length_sd_m);
  message.set_heading_var(step->heading_sd_rad * step->heading_sd_rad);
  if (step->risen_m) message.set_rise(*step->risen_m);
  message.set_is_valid(true);
  last_step_ = step->time;
  steps_.put(std::move(message), TimePoint(step->time));
}

/// No step can be told then, though somebody may walk. Says so once.
void StepHeading::note_no_heading(std::chrono::milliseconds time) {
  if (!unaligned_since_) unaligned_since_ = time;
  if (no_heading_told_ || time - *unaligned_since_ < kAlignsWithin) return;
  no_heading_told_ = true;
  log(LogLevel::Warning,
      "no steps can be told: what accelerometer and magnetometer measure is no gravity and no magnetic field of the "
      "earth");
}

/// While nothing is measured it is told to be not valid.
void StepHeading::produce_orientation() {
  const std::chrono::milliseconds time(to_milliseconds(now()));
  const bool known = last_sample_ && time - *last_sample_ <= kOldestSample && tracker_->heading().is_aligned();
  if (!known) return static_cast<void>(orientation_.put(localisation::CommOrientation()));
  orientation_.put(orientation_of(tracker_->heading().attitude(), tracker_->heading().heading_sd_rad()),
                   TimePoint(*last_sample_));
}

}  // namespace fiona::step_heading
