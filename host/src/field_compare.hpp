#pragma once

#include <string>
#include <utility>

#include "fiona/control.pb.h"

namespace fiona::host {

/// Compares the field at `path` ("position.x", "waypoints[0].x") of `object` with `value`: true or false and the
/// field's text. An empty path is the value of a probe that is no object, whose unit is then `unit`. Throws Error
/// NotFound for a field that is not there, Usage for kinds that do not compare.
std::pair<bool, std::string> compare_field(const google::protobuf::Message& object, const std::string& path,
                                           control::Comparison comparison, const control::Value& value,
                                           const std::string& unit = "");

}  // namespace fiona::host
