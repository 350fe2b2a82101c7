#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace fiona::radio {

/// Which level the receiver is on: a hidden Markov model whose states are the levels (its forward algorithm, see
/// Rabiner, "A tutorial on hidden Markov models", doi 10.1109/5.18626). Apart from the particles, because a few metres
/// that the survey left out cost all particles of the right level, and with them the memory of what had spoken for it.
class LevelTracker {
 public:
  explicit LevelTracker(std::size_t levels) : probability_(levels, 1.0 / static_cast<double>(levels)) {}

  /// New evidence, one log-likelihood per level; with the probability `moved` the receiver went to any level meanwhile.
  void observe(double moved, std::span<const double> log_likelihood);

  std::size_t best() const;                                             ///< index of the most probable level
  std::span<const double> probability() const { return probability_; }  ///< per level; their sum is 1

 private:
  std::vector<double> probability_;
};

}  // namespace fiona::radio
