#pragma once

#include <filesystem>
#include <string_view>

#include "fiona/building/plan.hpp"

namespace fiona::building {

/// Reads floor plans in the layout of the Indoor Location Competition 2.0: a folder that has one folder for each
/// floor, with `floor_info.json` (width and height of the floor in metres) and `geojson_map.json`, which may be packed
/// as `geojson_map.json.gz`. They hold shapes and names: a plan to be drawn, without walls, doors and stairs.
///
/// The plan's frame is that of the recordings: (0, 0) is the lower left corner of the floor's outline, x right, y up.
/// Throws fiona::Error that names the file: NotFound where there is no floor, Failed where one cannot be read.
Plan read_floor_folders(const std::filesystem::path& folder);

/// Adds one floor from its two texts; `name` stands for the GeoJSON file in errors. The first feature is the outline,
/// whose property `floor_num` counts 1 for the ground floor and -1 for the one below it. Longitude and latitude are
/// fitted so that the outline's box is as wide and high as the floor. Features that are no polygons are left out.
void add_floor(Plan& plan, std::string_view floor_info, std::string_view geojson, const std::string& name);

}  // namespace fiona::building
