#include "step_detector.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace fiona::steps {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kGap{1000};
constexpr double kSwingMemory = 0.3;  // weight of the newest step in the recent swing
constexpr double kFallPart = 0.5;     // of the threshold: how far a peak must have fallen to be one

}  // namespace

StepDetector::StepDetector(const StepDetectorOptions& options) : options_(options) {}

void StepDetector::restart(double norm_g) {
  stage_[0] = stage_[1] = peak_g_ = valley_g_ = valley_before_peak_g_ = norm_g;
  rising_ = true;
  last_step_.reset();
  recent_swing_g_ = not_told_m_ = 0.0;
  started_ = true;
}

double StepDetector::threshold_g(milliseconds now) const {
  const bool walking = last_step_ && now - *last_step_ <= options_.longest_interval;
  return std::max(options_.least_swing_g, walking ? options_.swing_part * recent_swing_g_ : 0.0);
}

std::optional<DetectedStep> StepDetector::feed(const ImuSample& sample) {
  const double norm_g = sample.acceleration_g.norm();
  if (!started_ || sample.time - last_time_ > kGap) {
    restart(norm_g);
    last_time_ = sample.time;
    return std::nullopt;
  }
  const double dt_s = std::chrono::duration<double>(sample.time - last_time_).count();
  if (dt_s <= 0.0) return std::nullopt;
  last_time_ = sample.time;

  const double keep = std::exp(-2.0 * std::numbers::pi * options_.low_pass_hz * dt_s);
  stage_[0] = keep * stage_[0] + (1.0 - keep) * norm_g;
  stage_[1] = keep * stage_[1] + (1.0 - keep) * stage_[0];
  const double value = stage_[1];

  // Of who stands, nothing is a swing from the last step's valley.
  if (rising_ && sample.time - valley_time_ > options_.longest_interval) {
    valley_g_ = peak_g_ = value;
    valley_time_ = sample.time;
  }
  const double fall = kFallPart * threshold_g(sample.time);
  if (rising_) {
    if (value > peak_g_) peak_g_ = value, peak_time_ = sample.time;
    if (value < valley_g_ && peak_g_ - valley_g_ < fall) {
      valley_g_ = peak_g_ = value;
      valley_time_ = sample.time;
    }
    if (peak_g_ - value < fall) return std::nullopt;
    rising_ = false;
    valley_before_peak_g_ = valley_g_;
    valley_g_ = value;
    valley_time_ = sample.time;
    const bool high = peak_g_ - valley_before_peak_g_ >= threshold_g(sample.time);
    const bool apart = !last_step_ || peak_time_ - *last_step_ >= options_.least_interval;
    if (high && apart) return take_step();
    return std::nullopt;
  }
  if (value < valley_g_) valley_g_ = value, valley_time_ = sample.time;
  if (value - valley_g_ >= fall) {
    rising_ = true;
    peak_g_ = value;
    peak_time_ = sample.time;
  }
  return std::nullopt;
}

std::optional<DetectedStep> StepDetector::take_step() {
  const double swing_g = peak_g_ - valley_before_peak_g_;
  const bool walking = last_step_ && peak_time_ - *last_step_ <= options_.longest_interval;
  recent_swing_g_ = walking ? (1.0 - kSwingMemory) * recent_swing_g_ + kSwingMemory * swing_g : swing_g;
  last_step_ = peak_time_;
  const double length_m = options_.weinberg_gain_m * std::pow(swing_g, 0.25);
  const double before_m = std::exchange(not_told_m_, 0.0);
  if (walking) return DetectedStep{peak_time_, before_m + length_m, swing_g};
  if (swing_g >= options_.lone_swing_g) return DetectedStep{peak_time_, length_m, swing_g};
  not_told_m_ = length_m;
  return std::nullopt;
}

}  // namespace fiona::steps
