#include "fiona/simulator/imu_model.hpp"

#include <cmath>
#include <numbers>

#include <Eigen/Geometry>
#include <fiona/units.hpp>

namespace fiona::simulator {
namespace {

constexpr double kTurn = 2.0 * std::numbers::pi;

double radians(double degrees) { return degrees * std::numbers::pi / 180.0; }
double degrees(double rad) { return rad * 180.0 / std::numbers::pi; }

std::array<SpatialField, 3> fields(std::uint64_t seed, double size_m) {
  Random random{seed, hash("magnetic anomalies")};
  return {SpatialField{random, size_m}, SpatialField{random, size_m}, SpatialField{random, size_m}};
}

}  // namespace

ImuModel::ImuModel(std::uint64_t seed, ImuOptions options, std::uint64_t run)
    : options_(options), anomaly_(fields(seed, options.anomaly_size_m)), random_(seed, hash("imu") + run) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    acceleration_bias_[axis] = options_.acceleration_bias_g * random_.normal();
    rotation_bias_[axis] = options_.rotation_bias_deg_s * random_.normal();
    magnetic_bias_[axis] = options_.magnetic_bias_gauss * random_.normal();
  }
}

ImuModel::Gait ImuModel::gait(const Truth& truth) {
  if (truth.cadence_hz <= 0.0) return {};
  const auto step = static_cast<std::int64_t>(truth.steps);
  if (step != step_number_) {
    step_number_ = step;
    strength_ = 1.0 + 0.1 * random_.normal();
  }
  // Bounce grows with the rate of the steps: a foot that is set down slowly hits softly.
  const double share = truth.cadence_hz / 1.8;
  const double size = strength_ * options_.step_bounce_g * share * share;
  const double phase = kTurn * truth.steps;
  const double stride = phase / 2.0;
  // Sizes as in walks with the phone in the hand (indoor20_site1): 2 to 4 m/s^2 and 0.5 rad/s deviation while
  // walking.
  Gait gait{};
  gait.acceleration_g[0] = 0.25 * size * std::sin(stride) + 0.08 * size * std::sin(3.0 * stride);
  gait.acceleration_g[1] = 0.45 * size * std::sin(phase + 0.6) + 0.12 * size * std::sin(2.0 * phase);
  gait.acceleration_g[2] =
      size * (std::cos(phase - 1.2) + 0.30 * std::cos(2.0 * phase - 0.4) + 0.10 * std::cos(3.0 * phase + 0.9));
  gait.rotation_deg_s[0] = 90.0 * size * std::sin(phase + 0.3);
  gait.rotation_deg_s[1] = 45.0 * size * std::sin(stride + 0.5);
  gait.rotation_deg_s[2] = 40.0 * size * std::cos(stride);
  return gait;
}

/// From the frame of the body (x right, y ahead, z up) into the tilted phone.
ImuModel::Vector ImuModel::to_phone(const Vector& v) const {
  const double pitch = radians(options_.pitch_deg), roll = radians(options_.roll_deg);
  const double y = v[1] * std::cos(pitch) + v[2] * std::sin(pitch);
  const double z = -v[1] * std::sin(pitch) + v[2] * std::cos(pitch);
  return {v[0] * std::cos(roll) - z * std::sin(roll), y, v[0] * std::sin(roll) + z * std::cos(roll)};
}

/// In the frame of the body.
ImuModel::Vector ImuModel::earth_field(const Truth& truth) const {
  const double dip = radians(options_.dip_deg);
  const double from_magnetic_north = truth.heading_rad - radians(options_.declination_deg);
  const double level = options_.field_gauss * std::cos(dip);
  const auto anomaly = [&](std::size_t axis) {
    return options_.anomaly_gauss * anomaly_[axis].at(truth.x_m, truth.y_m, truth.height_m);
  };
  const double east = anomaly(0), north = anomaly(1);
  const double up = anomaly(2) - options_.field_gauss * std::sin(dip);
  const double sine = std::sin(truth.heading_rad), cosine = std::cos(truth.heading_rad);
  return {-level * std::sin(from_magnetic_north) + east * cosine - north * sine,
          level * std::cos(from_magnetic_north) + east * sine + north * cosine, up};
}

ImuModel::Vector ImuModel::rotation_vector(const Truth& truth) const {
  constexpr double kTrustInMagnetometer = 0.3;
  const double level = options_.field_gauss * std::cos(radians(options_.dip_deg));
  const double east = options_.anomaly_gauss * anomaly_[0].at(truth.x_m, truth.y_m, truth.height_m);
  const double error_rad = kTrustInMagnetometer * std::atan2(east, level);
  const double heading = truth.heading_rad - radians(options_.declination_deg) - error_rad;
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  Eigen::Quaterniond turn = AngleAxisd(-heading, Vector3d::UnitZ()) *
                            AngleAxisd(radians(options_.pitch_deg), Vector3d::UnitX()) *
                            AngleAxisd(radians(options_.roll_deg), Vector3d::UnitY());
  if (turn.w() < 0.0) turn.coeffs() = -turn.coeffs();
  return {turn.x(), turn.y(), turn.z()};
}

ImuModel::Vector ImuModel::noisy(const Vector& value, const Vector& bias, double noise) {
  Vector read{};
  for (std::size_t axis = 0; axis < 3; ++axis) read[axis] = value[axis] + bias[axis] + noise * random_.normal();
  return read;
}

ImuSample ImuModel::sample(const Truth& truth) {
  const double seconds = has_before_ ? static_cast<double>((truth.t - before_.t).count()) / 1000.0 : 0.0;
  double right_g = 0.0, ahead_g = 0.0, up_g = 0.0, left_turn_deg_s = 0.0;
  if (seconds > 0.0) {
    const double scale = 1.0 / (seconds * kStandardGravity_mps2);
    const double slip = truth.speed_mps - before_.speed_mps;
    const double turn_rad = std::remainder(truth.heading_rad - before_.heading_rad, kTurn);
    ahead_g = slip * scale;
    right_g = truth.speed_mps * turn_rad * scale;  // towards the middle of the bend
    up_g = (truth.velocity_up_mps - before_.velocity_up_mps) * scale;
    left_turn_deg_s = -degrees(turn_rad) / seconds;
  }
  // Steps of a stair are climbed by the gait, not by a jump of the mean velocity at its first tread.
  if (truth.cadence_hz > 0.0) up_g = 0.0;
  const Gait now = gait(truth);
  before_ = truth;
  has_before_ = true;
  const Vector acceleration = {right_g + now.acceleration_g[0], ahead_g + now.acceleration_g[1],
                               1.0 + up_g + now.acceleration_g[2]};
  const Vector rotation = {now.rotation_deg_s[0], now.rotation_deg_s[1], left_turn_deg_s + now.rotation_deg_s[2]};
  return {truth.t, noisy(to_phone(acceleration), acceleration_bias_, options_.acceleration_noise_g),
          noisy(to_phone(rotation), rotation_bias_, options_.rotation_noise_deg_s),
          noisy(to_phone(earth_field(truth)), magnetic_bias_, options_.magnetic_noise_gauss), rotation_vector(truth)};
}

}  // namespace fiona::simulator
