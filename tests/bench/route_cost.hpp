#pragma once

#include <filesystem>
#include <optional>

namespace fiona::bench {

/// Where the stations are, whose maps are no part of the project: $FIONA_DATA/osm_indoor. Nothing where they are not.
std::optional<std::filesystem::path> station_maps();

/// 99th percentile of 2000 routes between landings of a station, a quarter each with all allowed, without stairs,
/// without lifts and indoors only. A route that does not exist counts: it takes longest.
double route_ms(const std::filesystem::path& packed);

}  // namespace fiona::bench
