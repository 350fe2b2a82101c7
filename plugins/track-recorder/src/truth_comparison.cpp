#include "truth_comparison.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::recorder {
namespace {

bool same_level(const std::optional<double>& a, const std::optional<double>& b) {
  if (!a || !b) return !a && !b;
  return whole_level(*a) == whole_level(*b);
}

void add_bounded(std::deque<Fix>& fixes, const Fix& fix) {
  fixes.push_back(fix);
  if (fixes.size() > TruthComparison::kMostWaiting) fixes.pop_front();
}

}  // namespace

int whole_level(double z) { return static_cast<int>(std::floor(z + 0.5)); }

void TruthComparison::add_estimate(const Fix& estimate) {
  add_bounded(waiting_, estimate);
  compare_waiting();
}

void TruthComparison::add_truth(const Fix& truth) {
  if (!truths_.empty() && truth.time <= truths_.back().time) return;
  add_bounded(truths_, truth);
  compare_waiting();
}

void TruthComparison::compare_waiting() {
  if (truths_.empty()) return;
  std::erase_if(waiting_, [this](const Fix& estimate) {
    if (estimate.time > truths_.back().time) return false;
    compare(estimate);
    return true;
  });
}

void TruthComparison::compare(const Fix& estimate) {
  const auto after = std::lower_bound(truths_.begin(), truths_.end(), estimate.time,
                                      [](const Fix& fix, TimePoint time) { return fix.time < time; });
  const bool exact = after->time == estimate.time;
  if (!exact && after == truths_.begin()) return;
  const Fix& before = exact ? *after : *std::prev(after);
  const Duration gap = after->time - before.time;
  if (gap > kLongestGap) return;
  const double share = exact ? 0.0 : to_seconds(estimate.time - before.time) / to_seconds(gap);
  const double x_m = std::lerp(before.x_m, after->x_m, share);
  const double y_m = std::lerp(before.y_m, after->y_m, share);
  latest_m_ = std::hypot(estimate.x_m - x_m, estimate.y_m - y_m);
  errors_.add(*latest_m_);
  if (same_level(estimate.level, share < 0.5 ? before.level : after->level)) ++right_levels_;
}

}  // namespace fiona::recorder
