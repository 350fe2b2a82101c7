#pragma once

#include <string>
#include <vector>

#include "fiona/building/building.hpp"
#include "journey.hpp"

namespace fiona::beacons {

struct PlanOptions {
  std::string name;
  building::Wgs84 reference;  ///< of the survey's frame, y to the north
  double half_width_m = 2.0;  ///< free on both sides of where the survey walked
};

/// A building without a drawing: OSM XML (Simple Indoor Tagging) whose free space is what lies along the survey's ways,
/// with a wall around it, and stairs where the survey changed levels. It says where surveyors walked, not where walls
/// are; walkers who leave the surveyed ways are held back by it.
std::string plan_of(const std::vector<radio::Journey>& walks, const PlanOptions& options);

}  // namespace fiona::beacons
