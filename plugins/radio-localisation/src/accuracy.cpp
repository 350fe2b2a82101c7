#include "accuracy.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <set>

#include <Eigen/LU>

namespace fiona::radio {
namespace {

constexpr double kChiSquare95 = 5.991;
constexpr double kLargestFloor_m = 8.0;
constexpr double kFloorStep_m = 0.25;
/// With less, particles in two places would claim to be sure of the middle between them.
constexpr double kLeastFactor = 0.25;
constexpr double kLargestFactor = 1000.0;
constexpr std::size_t kLeastFixes = 200;
constexpr std::size_t kSeveralWalks = 3;

Eigen::Matrix2d claimed(const LeftOutFix& fix, const Accuracy& accuracy) {
  return accuracy.covariance_factor * fix.spread_m2 +
         accuracy.covariance_floor_m * accuracy.covariance_floor_m * Eigen::Matrix2d::Identity();
}

double share_inside(std::span<const LeftOutFix> fixes, const Accuracy& accuracy) {
  std::size_t inside = 0;
  for (const LeftOutFix& fix : fixes) {
    inside += fix.error_m.dot(claimed(fix, accuracy).inverse() * fix.error_m) <= kChiSquare95;
  }
  return static_cast<double>(inside) / static_cast<double>(fixes.size());
}

double mean_log_area(std::span<const LeftOutFix> fixes, const Accuracy& accuracy) {
  double sum = 0.0;
  for (const LeftOutFix& fix : fixes) sum += std::log(claimed(fix, accuracy).determinant());
  return sum / static_cast<double>(fixes.size());
}

std::vector<LeftOutFix> fixes_to_judge(std::span<const LeftOutFix> fixes) {
  for (std::size_t least = kSeveralWalks;; --least) {
    std::vector<LeftOutFix> judged;
    std::copy_if(fixes.begin(), fixes.end(), std::back_inserter(judged),
                 [&](const LeftOutFix& fix) { return fix.other_walks >= least; });
    if (judged.size() >= kLeastFixes || least == 0) return judged;
  }
}

/// The share inside grows with the factor: bisection on its logarithm, to half a per cent.
Accuracy with_floor(std::span<const LeftOutFix> fixes, double floor_m, double inside) {
  double low = std::log(kLeastFactor), high = std::log(kLargestFactor);
  while (high - low > 0.005) {
    const double middle = 0.5 * (low + high);
    (share_inside(fixes, {std::exp(middle), floor_m}) >= inside ? high : low) = middle;
  }
  return {std::exp(high), floor_m};
}

std::vector<const SurveyedJourney*> chosen(std::span<const SurveyedJourney> journeys, std::size_t most) {
  const bool steps = std::any_of(journeys.begin(), journeys.end(), [](const auto& j) { return j.journey.has_steps; });
  std::vector<const SurveyedJourney*> candidates, result;
  for (const SurveyedJourney& journey : journeys) {
    if (journey.journey.has_steps == steps) candidates.push_back(&journey);
  }
  const std::size_t count = std::min(most, candidates.size());
  for (std::size_t i = 0; i < count; ++i) result.push_back(candidates[i * candidates.size() / count]);
  return result;
}

void replay_left_out(const RadioMapLearner& learner, const SurveyedJourney& surveyed,
                     const std::shared_ptr<const RadioMap>& map, const AccuracyOptions& options,
                     std::vector<LeftOutFix>& fixes) {
  const Journey& journey = surveyed.journey;
  RadioFilter filter(map);
  filter.expect_steps(journey.has_steps);
  replay(journey, filter, options.every, [&](Time time) {
    if (time.count() < journey.way_points.front().first || time.count() > journey.way_points.back().first) return;
    const auto truth = walk::position_at(journey.way_points, time.count());
    const Estimate at = filter.estimate();
    if (!truth || !at.is_valid()) return;
    const auto others =
        learner.other_walks_near(surveyed.walk, truth->level, truth->x_m, truth->y_m, options.same_place_m);
    if (others == 0) return;
    // A mean over n walks errs by 1 / n of a single walk's variance; the final map has one walk more here.
    const auto walks = static_cast<double>(others);
    const double gain = std::sqrt((1.0 + 1.0 / (walks + 1.0)) / (1.0 + 1.0 / walks));
    fixes.push_back({gain * Eigen::Vector2d(at.x_m - truth->x_m, at.y_m - truth->y_m), at.covariance, others});
  });
}

}  // namespace

Accuracy fit_accuracy(std::span<const LeftOutFix> all_fixes, double inside) {
  const auto fixes = fixes_to_judge(all_fixes);
  if (fixes.size() < kLeastFixes) return {};
  Accuracy best = with_floor(fixes, 0.0, inside);
  for (double floor_m = kFloorStep_m; floor_m <= kLargestFloor_m; floor_m += kFloorStep_m) {
    const Accuracy next = with_floor(fixes, floor_m, inside);
    if (mean_log_area(fixes, next) < mean_log_area(fixes, best)) best = next;
  }
  return best;
}

std::vector<LeftOutFix> left_out_fixes(const RadioMapLearner& learner, std::span<const SurveyedJourney> journeys,
                                       const AccuracyOptions& options) {
  std::vector<LeftOutFix> fixes;
  const auto replayed = chosen(journeys, options.most_journeys);
  if (replayed.size() < 2) return fixes;
  const double largest_fold = std::max(1.0, options.left_out_share * static_cast<double>(learner.walks()));
  const auto wanted = static_cast<std::size_t>(std::ceil(static_cast<double>(replayed.size()) / largest_fold));
  const std::size_t folds = std::clamp<std::size_t>(wanted, 2, std::min(options.most_folds, replayed.size()));
  for (std::size_t fold = 0; fold < folds; ++fold) {
    std::set<std::uint32_t> left_out;
    for (std::size_t i = fold; i < replayed.size(); i += folds) left_out.insert(replayed[i]->walk);
    RadioMap map = learner.learn("left out", left_out);
    map.accuracy = {1.0, 0.0};
    const auto shared = std::make_shared<const RadioMap>(std::move(map));
    for (std::size_t i = fold; i < replayed.size(); i += folds) {
      replay_left_out(learner, *replayed[i], shared, options, fixes);
    }
  }
  return fixes;
}

}  // namespace fiona::radio
