#include "step_tracker.hpp"

#include <cmath>

namespace fiona::steps {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLongestMean{1200};  // longer than a stride of a slow walker: an older heading is stale
constexpr double kLengthSdPart = 0.15;      // spread of Weinberg's length from step to step

}  // namespace

StepTracker::StepTracker(const StepDetectorOptions& steps, const HeadingFilterOptions& heading)
    : detector_(steps), heading_(heading) {}

std::optional<Step> StepTracker::feed(const ImuSample& sample) {
  const auto detected = detector_.feed(sample);
  heading_.feed(sample);
  ride_.feed(sample);
  if (!heading_.is_aligned()) return std::nullopt;
  if (!sum_since_ || sample.time - *sum_since_ > kLongestMean) {
    east_sum_ = north_sum_ = compass_east_sum_ = compass_north_sum_ = 0.0;
    sum_since_ = sample.time;
  }
  const double heading_rad = heading_.heading_rad();
  east_sum_ += std::cos(heading_rad);
  north_sum_ += std::sin(heading_rad);
  compass_east_sum_ += std::cos(heading_.compass_rad());
  compass_north_sum_ += std::sin(heading_.compass_rad());
  if (!detected) return std::nullopt;

  const Step step{detected->time,
                  detected->length_m,
                  kLengthSdPart * detected->length_m,
                  std::atan2(north_sum_, east_sum_),
                  heading_.heading_sd_rad(),
                  std::atan2(compass_north_sum_, compass_east_sum_),
                  ride_.step(detected->time)};
  sum_since_.reset();
  return step;
}

}  // namespace fiona::steps
