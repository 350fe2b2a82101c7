#pragma once

#include "beacon_map.hpp"
#include "fiona/building/building.hpp"

namespace fiona::beacons {

/// The beacons that a building's file has, `fiona:beacon=UUID/MAJOR/MINOR` on a node, with the power that they say of
/// themselves (`fiona:measured_power`, else -59 dBm) on the level that they are on. Nothing of how the radio is there:
/// that is learnt from a survey. Throws fiona::Error if the file has none, or names the one that cannot be read.
BeaconMap drawn_in(const building::Building& building);

}  // namespace fiona::beacons
