#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "beacon_filter.hpp"
#include "journey.hpp"
#include "survey_learner.hpp"

namespace fiona::beacons {

/// The seconds of a survey walk: those between its first and its last way-point, the silent ones too.
std::vector<SurveySecond> seconds_of(const radio::Journey& journey, std::uint32_t walk);

/// Tells the filter what a live receiver would be told, and calls show(time) five times a second.
void replay(const radio::Journey& journey, const BeaconField& field, BeaconFilter& filter,
            const std::function<void(Time)>& show);

/// Covariance factor and floor, from walks that the map did not learn: an eighth of them against what the others teach,
/// in turns, in places where others went. Without enough of them the careful default.
BeaconMap::Accuracy accuracy_of(const std::vector<radio::Journey>& walks, const FloorPlan& plan,
                                const FilterOptions& options);

/// The same from a survey that says nothing of steps: each second alone is a fix, of a map that has not learnt its
/// place.
BeaconMap::Accuracy accuracy_of(const std::vector<SurveySecond>& survey, const FilterOptions& options);

}  // namespace fiona::beacons
