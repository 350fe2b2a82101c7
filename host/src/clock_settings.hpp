#pragma once

#include <string>

#include "fiona/control.pb.h"
#include "fiona/time.hpp"

namespace fiona::host {

/// As RFC 3339 writes it, in UTC: "2024-05-31T09:30:00.500Z".
std::string text_of_time(TimePoint time);

/// The host's own parameters: which clock its system has, and what becomes of a virtual one.
struct ClockSettings {
  bool is_virtual = false;
  TimePoint start{};         ///< of a virtual one; Unix time, where a recording is replayed at its own
  double speed = 0;          ///< in times real time; 0: as fast as it goes
  std::string deliveries{};  ///< the file in which each delivery is recorded; empty: none

  bool operator==(const ClockSettings&) const = default;
  /// Whether instances would have to begin anew.
  bool is_another_than(const ClockSettings& other) const {
    return is_virtual != other.is_virtual || start != other.start;
  }
  /// With what `request` asks for. Throws Error Usage.
  ClockSettings changed(const control::Set& request) const;
  /// What makes these of those.
  control::Change change_from(const ClockSettings& before) const;
};

}  // namespace fiona::host
