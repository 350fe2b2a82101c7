#include "heading_filter.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fiona::steps {
namespace {

using Eigen::Vector3d;

constexpr std::chrono::milliseconds kRealignGap{1000};
constexpr std::chrono::milliseconds kQuickAlignment{3000};  // higher gains while the first sample's shake is undone
constexpr double kQuickFactor = 6.0;
constexpr double kFieldMemory_s = 20.0;
constexpr double kTrustedSd_rad = 0.12;
constexpr double kWorstSd_rad = 0.6;
constexpr double kSdGrowth_rad_per_s = 0.01;  // a phone gyroscope's drift while the compass is not trusted
constexpr double kSdDecay_s = 8.0;
constexpr double kRadiansPerDegree = std::numbers::pi / 180.0;

}  // namespace

HeadingFilter::HeadingFilter(const HeadingFilterOptions& options) : options_(options) {}

void HeadingFilter::align(const ImuSample& sample) {
  aligned_ = false;
  const double force = sample.acceleration_g.norm();
  const Vector3d up = sample.acceleration_g / force;
  const Vector3d east = sample.field_gauss.cross(up);
  // In free fall, or with the field along gravity, nothing can be aligned; the next sample may do.
  if (!(force > 0.3) || !(east.norm() > 1e-3)) return;
  Eigen::Matrix3d world_from_phone;
  world_from_phone.row(0) = east.normalized();
  world_from_phone.row(1) = up.cross(east.normalized());
  world_from_phone.row(2) = up;
  attitude_ = Eigen::Quaterniond(world_from_phone);
  const Vector3d field = attitude_ * sample.field_gauss;
  mean_norm_gauss_ = field.norm();
  mean_dip_rad_ = std::atan2(-field.z(), std::hypot(field.x(), field.y()));
  heading_sd_rad_ = 2.0 * kTrustedSd_rad;
  compass_error_rad_ = 0.0;
  aligned_ = true;
  last_time_ = aligned_at_ = sample.time;
}

void HeadingFilter::feed(const ImuSample& sample) {
  if (!aligned_ || sample.time - last_time_ > kRealignGap) return align(sample);
  const double dt_s = std::chrono::duration<double>(sample.time - last_time_).count();
  if (dt_s <= 0.0) return;
  last_time_ = sample.time;

  const bool quick = sample.time - aligned_at_ < kQuickAlignment;
  const double factor = quick ? kQuickFactor : 1.0;
  const Vector3d tilt = gravity_correction(sample);
  const Vector3d turn = magnetic_correction(sample, dt_s);
  if (!quick) rate_bias_ -= options_.bias_gain_per_s2 * dt_s * (tilt + turn);

  const Vector3d rate = sample.rate_dps * kRadiansPerDegree - rate_bias_ +
                        factor * (options_.gravity_gain_per_s * tilt + options_.magnetic_gain_per_s * turn);
  const double angle = rate.norm() * dt_s;
  if (angle > 0.0) attitude_ = attitude_ * Eigen::Quaterniond(Eigen::AngleAxisd(angle, rate.normalized()));
  attitude_.normalize();
}

Vector3d HeadingFilter::gravity_correction(const ImuSample& sample) const {
  const double force = sample.acceleration_g.norm();
  if (std::abs(force - 1.0) > options_.gravity_gate_g) return Vector3d::Zero();
  const Vector3d up_expected = attitude_.conjugate() * Vector3d::UnitZ();
  return (sample.acceleration_g / force).cross(up_expected);
}

Vector3d HeadingFilter::magnetic_correction(const ImuSample& sample, double dt_s) {
  const Vector3d field = attitude_ * sample.field_gauss;
  // The horizontal field must point to magnetic north (y); its angle from there is undone about the vertical.
  compass_error_rad_ = std::atan2(field.x(), field.y());
  if (!field_is_plausible(field, dt_s)) {
    heading_sd_rad_ = std::min(kWorstSd_rad, heading_sd_rad_ + kSdGrowth_rad_per_s * dt_s);
    return Vector3d::Zero();
  }
  heading_sd_rad_ += (kTrustedSd_rad - heading_sd_rad_) * std::min(1.0, dt_s / kSdDecay_s);
  return attitude_.conjugate() * Vector3d(0.0, 0.0, compass_error_rad_);
}

bool HeadingFilter::field_is_plausible(const Vector3d& field, double dt_s) {
  const double norm = field.norm();
  if (!(norm > 1e-3)) return false;
  const double dip = std::atan2(-field.z(), std::hypot(field.x(), field.y()));
  const bool plausible = std::abs(norm - mean_norm_gauss_) <= options_.field_gate_part * mean_norm_gauss_ &&
                         std::abs(dip - mean_dip_rad_) <= options_.dip_gate_rad;
  const double share = std::min(1.0, dt_s / kFieldMemory_s);
  mean_norm_gauss_ += share * (norm - mean_norm_gauss_);
  mean_dip_rad_ += share * (dip - mean_dip_rad_);
  return plausible;
}

double HeadingFilter::heading_rad() const {
  const Vector3d top = attitude_ * Vector3d::UnitY();
  const Vector3d back = attitude_ * -Vector3d::UnitZ();
  // Held upright the top edge points to the ceiling and the back of the phone looks ahead: blend between 45 and 70
  // degrees of pitch.
  const double pitch = std::asin(std::clamp(top.z(), -1.0, 1.0));
  const double upright = std::clamp((pitch * 180.0 / std::numbers::pi - 45.0) / 25.0, 0.0, 1.0);
  const Vector3d ahead = (1.0 - upright) * top + upright * back;
  return std::atan2(ahead.y(), ahead.x());
}

}  // namespace fiona::steps
