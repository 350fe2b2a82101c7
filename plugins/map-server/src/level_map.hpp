#pragma once

#include <set>
#include <string>

#include "fiona/building/building.hpp"
#include "fiona/navigation.pb.h"

namespace fiona::map_server {

/// The building as the service LevelMap tells it: rooms, walls and doors of `levels` (empty: of all), the whole graph.
navigation::CommLevelMap level_map_of(const building::Building& building, const std::string& name,
                                      const std::set<double>& levels);

/// x, y and level as a valid position in the building's frame, with its WGS84 reference.
localisation::CommPosition position_of(const building::Reference& reference, building::Point at, double level);

}  // namespace fiona::map_server
