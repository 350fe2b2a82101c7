#include "ride_detector.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace fiona::steps {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLongestGap{1000};
constexpr double kStandardGravity_mps2 = 9.80665;
constexpr double kSmooth_s = 0.1;
constexpr double kWeighing_s = 3.0;       // mean of the weight
constexpr double kLeastWeighing_s = 0.5;  // before which it is not known
constexpr double kEnds = 0.6;             // of the onset, below which a pulse is over
constexpr double kAlike = 0.5;            // of the speed at departure, that is lost at least on arrival

double seconds(milliseconds time) { return std::chrono::duration<double>(time).count(); }

}  // namespace

milliseconds RideDetector::Pulse::middle() const {
  return begun + milliseconds(std::llround(1000.0 * middle_s_mps / change_mps));
}

void RideDetector::stand_from(milliseconds time) {
  stands_from_ = time;
  weighed_s_ = risen_m_ = 0.0;
  pulse_.reset();
  departure_.reset();
}

void RideDetector::feed(const ImuSample& sample) {
  const double norm_g = sample.acceleration_g.norm();
  const auto before = std::exchange(last_time_, std::max(sample.time, last_time_.value_or(sample.time)));
  if (!before || sample.time - *before > kLongestGap) {
    smooth_g_ = norm_g;
    return stand_from(sample.time);
  }
  const double dt_s = seconds(sample.time - *before);
  if (dt_s <= 0.0) return;
  smooth_g_ += (norm_g - smooth_g_) * -std::expm1(-dt_s / kSmooth_s);
  if (sample.time - stands_from_ < options_.calm) return;
  const double off_g = smooth_g_ - weight_g_;
  const bool knows_weight = weighed_s_ >= kLeastWeighing_s;
  if (pulse_) {
    const double change_mps = (norm_g - weight_g_) * kStandardGravity_mps2 * dt_s;
    pulse_->change_mps += change_mps;
    pulse_->middle_s_mps += change_mps * seconds(sample.time - pulse_->begun);
    if (sample.time - pulse_->begun > options_.longest_pulse) {  // the phone is held otherwise, and weighs otherwise
      pulse_.reset();
      weighed_s_ = 0.0;
      return;
    }
    const bool turned = off_g * pulse_->change_mps < 0.0;
    if (turned || std::abs(off_g) < kEnds * options_.onset_g) end_pulse();
  } else if (knows_weight && std::abs(off_g) > options_.onset_g) {
    pulse_ = Pulse{0.0, 0.0, sample.time};
  } else {
    weighed_s_ = std::min(kWeighing_s, weighed_s_ + dt_s);
    weight_g_ += (norm_g - weight_g_) * dt_s / weighed_s_;
  }
}

void RideDetector::end_pulse() {
  const Pulse pulse = *std::exchange(pulse_, std::nullopt);
  const double change_mps = std::abs(pulse.change_mps);
  if (change_mps < options_.least_change_mps || change_mps > options_.most_change_mps) return;
  if (departure_) {
    const double speed_mps = std::abs(departure_->change_mps);
    const milliseconds took = pulse.middle() - departure_->middle();
    const bool arrives = departure_->change_mps * pulse.change_mps < 0.0 && took <= options_.longest_ride &&
                         std::min(speed_mps, change_mps) >= kAlike * std::max(speed_mps, change_mps);
    if (arrives) {
      risen_m_ += std::copysign(0.5 * (speed_mps + change_mps) * seconds(took), departure_->change_mps);
      departure_.reset();
      return;
    }
  }
  departure_ = pulse;
}

std::optional<double> RideDetector::step(milliseconds time) {
  if (pulse_) end_pulse();  // one may set out before the lift has come to rest
  const bool stood = last_time_ && weighed_s_ >= kLeastWeighing_s;
  const double risen_m = risen_m_;
  stand_from(time);
  return stood ? std::optional(risen_m) : std::nullopt;
}

}  // namespace fiona::steps
