#include "step_detector.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

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
  recent_swing_g_ = 0.0;
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

  const double fall = kFallPart * threshold_g(sample.time);
  if (rising_) {
    if (value > peak_g_) peak_g_ = value, peak_time_ = sample.time;
    if (value < valley_g_ && peak_g_ - valley_g_ < fall) valley_g_ = peak_g_ = value;
    if (peak_g_ - value < fall) return std::nullopt;
    rising_ = false;
    valley_before_peak_g_ = valley_g_;
    valley_g_ = value;
    const bool high = peak_g_ - valley_before_peak_g_ >= threshold_g(sample.time);
    const bool apart = !last_step_ || peak_time_ - *last_step_ >= options_.least_interval;
    if (high && apart) return take_step();
    return std::nullopt;
  }
  valley_g_ = std::min(valley_g_, value);
  if (value - valley_g_ >= fall) {
    rising_ = true;
    peak_g_ = value;
    peak_time_ = sample.time;
  }
  return std::nullopt;
}

DetectedStep StepDetector::take_step() {
  const double swing_g = peak_g_ - valley_before_peak_g_;
  const bool walking = last_step_ && peak_time_ - *last_step_ <= options_.longest_interval;
  recent_swing_g_ = walking ? (1.0 - kSwingMemory) * recent_swing_g_ + kSwingMemory * swing_g : swing_g;
  last_step_ = peak_time_;
  return {peak_time_, options_.weinberg_gain_m * std::pow(swing_g, 0.25), swing_g};
}

}  // namespace fiona::steps
