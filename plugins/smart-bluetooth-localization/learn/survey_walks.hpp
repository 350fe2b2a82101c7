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

/// How the building turns a compass: by place, the mean of what the magnetometer said at the walks' steps less the way
/// from way-point to way-point. What it is off everywhere is left out. Walks without steps teach nothing.
void learn_compass(const std::vector<radio::Journey>& walks, BeaconMap& map);

constexpr std::size_t kFolds = 8;  ///< a map without an eighth of its walks is nearly what the whole is

/// Covariance factor and floor, from walks that the map did not learn: an eighth of them against what the others teach,
/// in places where others went; of the eighths the first `most_folds` in turns, each of which costs as much as learning
/// a map. Without enough of them the careful default.
BeaconMap::Accuracy accuracy_of(const std::vector<radio::Journey>& walks, const FloorPlan& plan,
                                const FilterOptions& options, std::size_t most_folds = kFolds);

/// The same from a survey that says nothing of steps: each second alone is a fix, of a map that has not learnt its
/// place.
BeaconMap::Accuracy accuracy_of(const std::vector<SurveySecond>& survey, const FilterOptions& options);

}  // namespace fiona::beacons
