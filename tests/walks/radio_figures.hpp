#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "journey.hpp"

namespace fiona::walks {

/// What recorded walks say of a radio world, by beacons whose places nobody needs to know. Readings are in dB; what is
/// said of pairs of readings is the root of half of their mean squared difference, which is the standard deviation if
/// they have nothing to do with each other.
struct RadioFigures {
  static constexpr std::array<double, 5> kLags_s{0.2, 0.5, 1.0, 2.0, 5.0};
  using ByLag = std::array<double, kLags_s.size()>;

  std::size_t readings = 0;
  double second_db = 0.0;         ///< about the mean of what a second heard of a beacon, while walking
  ByLag standing_db{};            ///< of two readings so long after one another, where one stands
  ByLag walking_db{};             ///< the same while walking
  double revisit_db = 0.0;        ///< of two within 1 m of each other, on one walk, 10 s or more between them
  double other_walk_db = 0.0;     ///< the same on two walks, less by what one of these read more than the other
  double walks_db = 0.0;          ///< of walks' means: how differently receivers read
  double path_loss_db = 0.0;      ///< about the path loss that fits a beacon best, while walking
  ByLag correlation{};            ///< of what is left of that, so long after one another
  double missed = 0.0;            ///< of the advertisements between two that were heard within 3 s
  double missed_of_strong = 0.0;  ///< the same where those two are above -80 dBm
};

/// Bluetooth readings alone. A receiver stands where it gets on by less than 0.1 m a second.
RadioFigures figures_of(const std::vector<radio::Journey>& walks);

}  // namespace fiona::walks
