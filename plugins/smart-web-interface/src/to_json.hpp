#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"

namespace fiona::smart_web_interface {

// Objects as the page reads them: JSON, metres and levels of the building's frame.

/// As text on one line; bytes that are no UTF-8, where a supplier does not check them, are replaced.
std::string text_of(const nlohmann::json& value);

/// {x, y, level?, measured, valid, ellipse?: {major, minor, angle}}: when the walker was there, in milliseconds of Unix
/// time; the semi-axes of the 95 % ellipse in metres, and the angle of the major one counter-clockwise from east in
/// radians; no ellipse where the covariance is not known or none.
std::string location_json(const localisation::CommLocation& location, TimePoint measured);

/// {valid, points: [[x, y, level?]]}
std::string path_json(const navigation::CommPath& path);

/// {number, kind, text, language, uncertain, distance?, hour?}
std::string instruction_json(const hmi::Instruction& instruction);

/// {title, levels, rooms, walls, entrances}
std::string map_json(const navigation::CommLevelMap& map);

}  // namespace fiona::smart_web_interface
