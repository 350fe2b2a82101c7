#pragma once

#include <string>
#include <vector>

#include "catalogue.hpp"

#include "fiona/control.pb.h"

namespace fiona::console {

/// Something that could fill a white spot, and the line to type for it.
struct Filler {
  std::string from;  ///< "running", "installed", "market"
  std::string what;  ///< "wifi.location", "fiona/user-profiles 1.0.0"
  std::string line;  ///< "wire nav.location to wifi.location"
};

/// A required port that nobody serves, or a provided one that nobody uses.
struct WhiteSpot {
  bool required = false;
  bool optional = false;
  std::string port;     ///< "nav.profile"
  std::string service;  ///< full name
  std::string reason;   ///< "unwired", "lost: …"; empty for a provided port
  std::vector<Filler> fillers;
};

/// The white spots of a running system, required ones first.
std::vector<WhiteSpot> white_spots(const control::System& system, const Catalogue& catalogue);

/// Those that --strict refuses: required, not optional.
std::vector<std::string> strict_spots(const control::System& system);

}  // namespace fiona::console
