#include "landmarks.hpp"

#include <algorithm>
#include <cmath>

#include <fiona/building/geometry.hpp>

namespace fiona::guidance {

void Passing::watch(std::vector<Landmark> landmarks) {
  std::vector<Watched> next;
  for (Landmark& landmark : landmarks) {
    const auto known = std::find_if(watched_.begin(), watched_.end(), [&](const Watched& one) {
      return one.landmark.place.at == landmark.place.at && one.landmark.place.level == landmark.place.level &&
             one.landmark.name == landmark.name;
    });
    next.push_back({std::move(landmark), known != watched_.end() && known->told});
  }
  watched_ = std::move(next);
}

std::vector<Landmark> Passing::follow(const LevelPlan& plan, const building::PathPoint& place, double near_m) {
  std::vector<Landmark> passed;
  for (Watched& one : watched_) {
    const building::PathPoint& at = one.landmark.place;
    const double away_m = distance_m(place.at, at.at);
    const bool level = std::abs(place.level - at.level) < 0.25;
    if (!level || away_m > 2.0 * near_m) one.told = false;
    if (one.told || !level || away_m > near_m || plan.walled(place.at, at.at, at.level)) continue;
    one.told = true;
    passed.push_back(one.landmark);
  }
  return passed;
}

}  // namespace fiona::guidance
