#pragma once

#include <chrono>
#include <optional>

#include "imu_sample.hpp"

namespace fiona::steps {

struct RideDetectorOptions {
  double onset_g = 0.025;         ///< beyond it a lift speeds up or slows down; smaller is the hand
  double least_change_mps = 0.3;  ///< of speed, by one such pulse
  double most_change_mps = 4.0;
  std::chrono::milliseconds calm{1000};           ///< after the last step, until a person stands
  std::chrono::milliseconds longest_pulse{4000};  ///< what lasts longer is no lift
  std::chrono::milliseconds longest_ride{180'000};
};

/// How far a lift has carried one who stands in it. It speeds up and slows down at about 0.8 m/s^2 (R. D. Peters,
/// "Ideal lift kinematics", Elevator Technology 6, 1995): two pulses of the acceleration's norm, of opposite signs.
/// Each pulse is the speed in between, and what lies between their middles is the time. Nothing is integrated over the
/// whole ride, so that the accelerometer's bias adds nothing.
class RideDetector {
 public:
  explicit RideDetector(const RideDetectorOptions& options = {}) : options_(options) {}

  /// Feeds one sample. Times that do not increase are ignored; a gap of more than a second starts anew.
  void feed(const ImuSample& sample);

  /// The person made a step at a time, and stood before. Answers how much higher they have been carried since the step
  /// before, in metres; nothing if they did not stand for long enough to tell.
  std::optional<double> step(std::chrono::milliseconds time);

 private:
  struct Pulse {
    double change_mps = 0.0;    ///< upwards
    double middle_s_mps = 0.0;  ///< integral of time and change
    std::chrono::milliseconds begun{};
    std::chrono::milliseconds middle() const;
  };
  void stand_from(std::chrono::milliseconds time);
  void end_pulse();

  RideDetectorOptions options_;
  std::optional<std::chrono::milliseconds> last_time_;
  std::chrono::milliseconds stands_from_{};
  double smooth_g_ = 1.0;
  double weight_g_ = 1.0;  ///< the norm while nothing speeds up
  double weighed_s_ = 0.0;
  std::optional<Pulse> pulse_, departure_;
  double risen_m_ = 0.0;
};

}  // namespace fiona::steps
