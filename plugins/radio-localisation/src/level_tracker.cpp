#include "level_tracker.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::radio {

void LevelTracker::observe(double moved, std::span<const double> log_likelihood) {
  const double largest = *std::max_element(log_likelihood.begin(), log_likelihood.end());
  const double arrived = moved / static_cast<double>(probability_.size());
  double sum = 0.0;
  for (std::size_t i = 0; i < probability_.size(); ++i) {
    const double stayed = (1.0 - moved) * probability_[i];
    sum += probability_[i] = (stayed + arrived) * std::exp(log_likelihood[i] - largest);
  }
  for (double& probability : probability_) probability /= sum;
}

std::size_t LevelTracker::best() const {
  return static_cast<std::size_t>(std::max_element(probability_.begin(), probability_.end()) - probability_.begin());
}

}  // namespace fiona::radio
