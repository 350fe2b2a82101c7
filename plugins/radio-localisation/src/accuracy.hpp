#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "journey.hpp"
#include "radio_map_learner.hpp"

namespace fiona::radio {

/// How one fix erred on a survey walk that its map had not learnt.
struct LeftOutFix {
  Eigen::Vector2d error_m;
  Eigen::Matrix2d spread_m2;    ///< covariance of the particles, as they are
  std::size_t other_walks = 0;  ///< that surveyed the place and that the map had learnt
};

/// How many of the left-out fixes are to be inside: the middle of what is asked of a 95 % region, 90 to 98 %.
constexpr double kInside = 0.94;

/// The smallest covariance factor * spread + floor^2 that keeps the share `inside` of the fixes within their own 95 %
/// region (chi-square of two degrees of freedom, 5.991); smallest by the mean logarithm of the region's area. A
/// quantile, not a variance: errors indoors have heavier tails than a Gaussian, and the region is what users act on.
/// Judged are places that several other walks surveyed, if there are enough: where only one or two did, a map without
/// the walk is another kind of map, of one phone. With too few fixes to judge, the accuracy is the careful default.
Accuracy fit_accuracy(std::span<const LeftOutFix> fixes, double inside = kInside);

/// A survey walk with its number in the learner.
struct SurveyedJourney {
  std::uint32_t walk;
  Journey journey;
};

struct AccuracyOptions {
  std::size_t most_journeys = 60;
  double left_out_share =
      0.1;  ///< of all walks, at most, in one fold: the map should hardly be thinner than the final one
  std::size_t most_folds = 10;
  Time every{1000};           ///< between the fixes that are judged
  double same_place_m = 5.0;  ///< walks so near to a place surveyed it
};

/// Replays survey walks, those with inertial rows if there are any, against maps that were learnt without them, and
/// compares with where the surveyor was. The errors are those expected with the final map, which knows one walk more.
std::vector<LeftOutFix> left_out_fixes(const RadioMapLearner& learner, std::span<const SurveyedJourney> journeys,
                                       const AccuracyOptions& options = {});

}  // namespace fiona::radio
