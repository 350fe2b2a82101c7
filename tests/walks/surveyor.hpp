#pragma once

#include <cstdint>
#include <vector>

#include <fiona/building/building.hpp>

#include "beacon_map.hpp"
#include "fiona/simulator/survey.hpp"
#include "journey.hpp"

namespace fiona::walks {

/// What a receiver is told on a walk, in the order of time.
radio::Journey journey_of(const simulator::Trace& trace);

/// A survey with steps of all levels of this building, in the radio world of this seed.
std::vector<radio::Journey> survey_of(const building::Building& building, std::uint64_t seed);

/// The beacon map that `fiona-beaconmap learn DIR --plan` learns from a survey with steps of this building, in the
/// radio world of this seed: who draws another world each time, surveys it. Its covariance is judged by half as many
/// folds.
beacons::BeaconMap surveyed(const building::Building& building, std::uint64_t seed);

}  // namespace fiona::walks
