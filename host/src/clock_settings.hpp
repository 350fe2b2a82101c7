#pragma once

#include <string>

#include "fiona/control.pb.h"

namespace fiona::host {

/// The host's own parameters: which clock its system has, and what becomes of a virtual one.
struct ClockSettings {
  bool is_virtual = false;
  double speed = 0;          ///< in times real time; 0: as fast as it goes
  std::string deliveries{};  ///< the file in which each delivery is recorded; empty: none

  bool operator==(const ClockSettings&) const = default;
  /// With what `request` asks for. Throws Error Usage.
  ClockSettings changed(const control::Set& request) const;
  /// What makes these of those.
  control::Change change_from(const ClockSettings& before) const;
};

}  // namespace fiona::host
