#pragma once

#include <array>
#include <chrono>
#include <cstdint>

#include "fiona/simulator/random.hpp"
#include "fiona/simulator/walker.hpp"

namespace fiona::simulator {

/// What a phone measures that is held in front of the body: y where the person walks, x to the right, z up
/// out of the screen.
struct ImuSample {
  milliseconds t{0};
  std::array<double, 3> acceleration_g{};  ///< with gravity: (0, 0, 1) lying still on a table
  std::array<double, 3> rotation_deg_s{};  ///< right-handed: positive z is a turn to the left
  std::array<double, 3> magnetic_gauss{};
  /// Vector part of the unit quaternion that turns phone axes into east, magnetic north, up: what a phone's
  /// own fusion tells (Android's rotation vector). Iron in the building turns it, less than the bare
  /// magnetometer.
  std::array<double, 3> rotation_vector{};
};

struct ImuOptions {
  double field_gauss = 0.487;    ///< defaults: Ulm, World Magnetic Model 2025
  double dip_deg = 64.3;         ///< below the horizon, to the north
  double declination_deg = 4.0;  ///< of magnetic from true north, clockwise
  double anomaly_gauss = 0.04;   ///< standard deviation of what steel in the building adds, constant in place
  double anomaly_size_m = 3.0;
  double pitch_deg = 8.0;  ///< the top edge of the phone is held above the bottom edge
  double roll_deg = -2.0;
  double step_bounce_g = 0.32;  ///< vertical, at full walking speed
  double acceleration_noise_g = 0.012;
  double rotation_noise_deg_s = 0.25;
  double magnetic_noise_gauss = 0.004;
  double acceleration_bias_g = 0.008;  ///< standard deviation of a bias drawn once
  double rotation_bias_deg_s = 0.3;
  double magnetic_bias_gauss = 0.01;
};

/// Accelerometer, gyroscope and magnetometer of the walking person's phone. Gait: bounce with three harmonics
/// of the step rate, push and braking along y, sway to the sides at half the rate, each step a little
/// different.
class ImuModel {
 public:
  static constexpr milliseconds kPeriod{20};  ///< 50 Hz

  /// The anomalies are those of the seed; bias and noise also depend on `run`: another phone in the same
  /// building.
  explicit ImuModel(std::uint64_t seed, ImuOptions options = {}, std::uint64_t run = 0);

  /// The sample at the time of `truth`; call it once each period, ascending in time. Acceleration and rate of
  /// turn are differences to the call before.
  ImuSample sample(const Truth& truth);

 private:
  using Vector = std::array<double, 3>;

  struct Gait {
    Vector acceleration_g;
    Vector rotation_deg_s;
  };

  Gait gait(const Truth& truth);
  Vector to_phone(const Vector& level_frame) const;
  Vector earth_field(const Truth& truth) const;
  Vector rotation_vector(const Truth& truth) const;
  Vector noisy(const Vector& value, const Vector& bias, double noise);

  ImuOptions options_;
  std::array<SpatialField, 3> anomaly_;
  Random random_;
  Vector acceleration_bias_{};
  Vector rotation_bias_{};
  Vector magnetic_bias_{};
  Truth before_{};
  bool has_before_ = false;
  double strength_ = 1.0;  ///< of the current step
  std::int64_t step_number_ = -1;
};

}  // namespace fiona::simulator
