#pragma once

#include <chrono>
#include <optional>

#include "imu_sample.hpp"

namespace fiona::steps {

struct StepDetectorOptions {
  double low_pass_hz = 3.0;     ///< keeps the step and its first harmonic
  double least_swing_g = 0.06;  ///< peak to valley; smaller is handling, not walking
  double lone_swing_g = 0.10;   ///< the same of the first step after a pause: a lift that starts is no step
  double swing_part = 0.4;      ///< of the recent steps' swing that the next one must reach
  std::chrono::milliseconds least_interval{280};
  std::chrono::milliseconds longest_interval{1500};  ///< a pause beyond this forgets the recent swing
  double weinberg_gain_m = 0.83;                     ///< metres per g^(1/4)
};

/// One detected step.
struct DetectedStep {
  std::chrono::milliseconds time;  ///< of the acceleration peak
  double length_m;
  double swing_g;  ///< peak to valley of the low-passed acceleration norm
};

/// Counts steps as peaks of the low-passed acceleration norm, with a threshold that follows the walker's own swing,
/// and estimates each step's length from that swing: L = K (a_max - a_min)^(1/4) (H. Weinberg, "Using the ADXL202 in
/// pedometer and personal navigation applications", Analog Devices AN-602, 2002).
///
/// A first step that is weaker than one that is believed alone is told with the second, as one of both lengths.
/// Causal: a step is reported when the signal has fallen from its peak by half of the threshold.
class StepDetector {
 public:
  explicit StepDetector(const StepDetectorOptions& options = {});

  /// Feeds one sample. Times that do not increase are ignored; a gap of more than a second starts anew.
  std::optional<DetectedStep> feed(const ImuSample& sample);

 private:
  void restart(double norm_g);
  double threshold_g(std::chrono::milliseconds now) const;
  std::optional<DetectedStep> take_step();

  StepDetectorOptions options_;
  bool started_ = false;
  std::chrono::milliseconds last_time_{};
  double stage_[2] = {};  // two first-order low passes in a row
  bool rising_ = true;
  double peak_g_ = 0.0;
  double valley_g_ = 0.0;
  double valley_before_peak_g_ = 0.0;
  std::chrono::milliseconds peak_time_{}, valley_time_{};
  std::optional<std::chrono::milliseconds> last_step_;
  double recent_swing_g_ = 0.0;
  double not_told_m_ = 0.0;  ///< length of a weak first step
};

}  // namespace fiona::steps
