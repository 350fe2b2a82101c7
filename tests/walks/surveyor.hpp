#pragma once

#include <cstdint>

#include <fiona/building/building.hpp>

#include "beacon_map.hpp"

namespace fiona::walks {

/// The beacon map that `fiona-beaconmap learn DIR --plan` learns from a survey with steps of this building, in the
/// radio world of this seed: who draws another world each time, surveys it. Its covariance is judged by half as many
/// folds.
beacons::BeaconMap surveyed(const building::Building& building, std::uint64_t seed);

}  // namespace fiona::walks
