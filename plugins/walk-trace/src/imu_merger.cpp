#include <fiona/walk/imu_merger.hpp>

#include <numbers>

#include <fiona/units.hpp>

namespace fiona::walk {
namespace {

constexpr double kGaussPerMicrotesla = 0.01;
constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

}  // namespace

std::optional<MergedImu> ImuMerger::feed(const Event& event) {
  if (const auto* rate = std::get_if<Gyroscope>(&event.data)) {
    rate_sum_[0] += rate->x, rate_sum_[1] += rate->y, rate_sum_[2] += rate->z;
    ++rate_count_;
    rate_seen_ = true;
  } else if (const auto* field = std::get_if<Magnetometer>(&event.data)) {
    field_ = *field;
  }
  const auto* force = std::get_if<Accelerometer>(&event.data);
  if (force == nullptr || !rate_seen_ || !field_) return std::nullopt;

  MergedImu sample{
      event.t_ms,
      {force->x / kStandardGravity_mps2, force->y / kStandardGravity_mps2, force->z / kStandardGravity_mps2},
      {},
      {field_->x * kGaussPerMicrotesla, field_->y * kGaussPerMicrotesla, field_->z * kGaussPerMicrotesla}};
  for (int axis = 0; axis < 3; ++axis) {
    if (rate_count_ > 0) last_rate_[axis] = rate_sum_[axis] / rate_count_;
    sample.rate_dps[axis] = last_rate_[axis] * kDegreesPerRadian;
    rate_sum_[axis] = 0.0;
  }
  rate_count_ = 0;
  return sample;
}

}  // namespace fiona::walk
