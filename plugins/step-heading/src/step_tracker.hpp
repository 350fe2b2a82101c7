#pragma once

#include <chrono>
#include <optional>

#include "heading_filter.hpp"
#include "ride_detector.hpp"
#include "step_detector.hpp"

namespace fiona::steps {

/// One step of the walker: what dead reckoning adds.
struct Step {
  std::chrono::milliseconds time;
  double length_m;
  double length_sd_m;
  double heading_rad;  ///< counter-clockwise from true east: east += length cos, north += length sin
  double heading_sd_rad;
  double compass_rad;             ///< the same by the magnetometer alone, without the gyroscope
  std::optional<double> risen_m;  ///< in a lift since the step before; nothing while one walks
};

/// Steps with length and direction from the phone's own inertial sensors: StepDetector and HeadingFilter side by
/// side. The direction is the mean heading since the last step, which removes the sway of the hand.
class StepTracker {
 public:
  explicit StepTracker(const StepDetectorOptions& steps = {}, const HeadingFilterOptions& heading = {});

  /// Feeds one sample. A step comes back about 0.1 s after its acceleration peak.
  std::optional<Step> feed(const ImuSample& sample);

  const HeadingFilter& heading() const { return heading_; }

 private:
  StepDetector detector_;
  HeadingFilter heading_;
  RideDetector ride_;
  double east_sum_ = 0.0;
  double north_sum_ = 0.0;
  double compass_east_sum_ = 0.0;
  double compass_north_sum_ = 0.0;
  std::optional<std::chrono::milliseconds> sum_since_;
};

}  // namespace fiona::steps
