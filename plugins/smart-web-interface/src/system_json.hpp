#pragma once

#include <string>
#include <string_view>

#include "fiona/control.pb.h"

namespace fiona::smart_web_interface {

/// {host, clock, mayChange, instances, wires}: each instance with its mode and where it runs; each required port with
/// who serves it, and, where it is for the page to change, who else could: those that provide the same service.
std::string system_json(const control::System& system, bool may_change);

/// "nav.location"; null if there is none.
const control::PortStatus* port_of(const control::System& system, std::string_view name);

}  // namespace fiona::smart_web_interface
