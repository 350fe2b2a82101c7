#pragma once

#include <filesystem>
#include <optional>
#include <string_view>

#include "fiona/building/frames.hpp"
#include "fiona/smart_bluetooth_localization/beacon_map.pb.h"

namespace fiona::beacons {

using smart_bluetooth_localization::BeaconMap;

inline constexpr double kUsualExponent = 2.5;

/// What is taken for members of `radio` and `accuracy` that a map leaves at 0.
BeaconMap::Radio usual_radio();
BeaconMap::Accuracy careful_accuracy();

/// Reads a map from text, `name` standing for the file in errors, and fills in what it leaves out. Throws fiona::Error
/// that names line and column of what is no map, or the beacon, place or member whose value cannot be.
BeaconMap parse(std::string_view text, const std::string& name);
/// The same from a file of at most 64 MiB.
BeaconMap load(const std::filesystem::path& file);

/// Writes the file anew. Throws fiona::Error if it cannot.
void save(const BeaconMap& map, const std::filesystem::path& file);

/// The frame that it is told in; none: it does not say.
std::optional<building::Reference> reference_of(const BeaconMap& map);
void set_reference(BeaconMap& map, const building::Reference& reference);
/// The same in another frame, `how` that of the map lies in it.
BeaconMap moved(BeaconMap map, const building::Placement& how);

/// How ids are compared: lower case; an address without its separators.
std::string normalised_id(std::string_view id);

}  // namespace fiona::beacons
