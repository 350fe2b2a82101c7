#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "beacon_map.hpp"

namespace fiona::beacons {

/// One second of a survey: where the surveyor was, and which beacons were heard how strongly.
struct SurveySecond {
  std::uint32_t walk;  ///< its receiver reads all along as much too high or too low
  double x_m, y_m;
  int level;
  std::map<std::string, float> rssi_dbm;  ///< by id, means of the second
};

/// Fits a map to a survey by least squares, in turns: place, power and exponent of each beacon (its place by search, as
/// nobody notes a beacon that was moved), and the offset of each walk's receiver. What remains is shadowing: its size
/// and reach by the likelihood of the Gaussian process. How often what is heard: the likelihood of a logistic curve.
/// Throws fiona::Error if no second heard anything.
BeaconMap learn(const std::vector<SurveySecond>& survey, const std::string& name);

}  // namespace fiona::beacons
