#pragma once

#include <chrono>
#include <cmath>
#include <numbers>
#include <optional>

#include <Eigen/Geometry>

#include "imu_sample.hpp"

namespace fiona::steps {

struct HeadingFilterOptions {
  double gravity_gain_per_s = 0.5;    ///< pull of the accelerometer on the tilt
  double magnetic_gain_per_s = 0.15;  ///< pull of the magnetometer on the heading, when it can be trusted
  double bias_gain_per_s2 = 0.01;     ///< pull of both on the gyroscope's bias
  double gravity_gate_g = 0.35;       ///< |norm - 1| beyond which an acceleration says nothing about the tilt
  double field_gate_part = 0.25;      ///< deviation of the field's norm from its recent mean that is a disturbance
  double dip_gate_rad = 0.35;         ///< deviation of the field's dip from its recent mean, likewise
};

/// Attitude of the phone from gyroscope, accelerometer and magnetometer: the complementary filter of Mahony, Hamel,
/// Pflimlin, "Nonlinear complementary filters on the special orthogonal group" (IEEE TAC 53(5), 2008), with two
/// changes for buildings: the magnetometer turns the attitude about the vertical only, so that iron cannot tilt it,
/// and it is gated by the field's norm and dip against their recent means.
class HeadingFilter {
 public:
  explicit HeadingFilter(const HeadingFilterOptions& options = {});

  /// Feeds one sample. Times that do not increase are ignored; after a gap of more than a second it is not aligned
  /// until a sample aligns it anew.
  void feed(const ImuSample& sample);

  bool is_aligned() const { return aligned_; }

  /// Direction in which the phone points, radians counter-clockwise from magnetic east. The phone's top edge counts, or
  /// its back when the phone is held upright. Only when is_aligned().
  double heading_rad() const;

  /// Standard deviation of heading_rad() that the magnetic surroundings justify.
  double heading_sd_rad() const { return heading_sd_rad_; }

  /// Where heading_rad() would be if the magnetometer alone turned the attitude about the vertical. Only when
  /// is_aligned().
  double compass_rad() const { return std::remainder(heading_rad() + compass_error_rad_, 2.0 * std::numbers::pi); }

  /// Rotates phone axes to east, magnetic north, up.
  const Eigen::Quaterniond& attitude() const { return attitude_; }

 private:
  void align(const ImuSample& sample);
  Eigen::Vector3d gravity_correction(const ImuSample& sample) const;
  Eigen::Vector3d magnetic_correction(const ImuSample& sample, double dt_s);
  bool field_is_plausible(const Eigen::Vector3d& field_world, double dt_s);

  HeadingFilterOptions options_;
  bool aligned_ = false;
  std::chrono::milliseconds last_time_{};
  std::chrono::milliseconds aligned_at_{};
  Eigen::Quaterniond attitude_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d rate_bias_ = Eigen::Vector3d::Zero();
  double compass_error_rad_ = 0.0;  ///< of the last sample
  double mean_norm_gauss_ = 0.0;
  double mean_dip_rad_ = 0.0;
  double heading_sd_rad_ = 0.0;
};

}  // namespace fiona::steps
