#pragma once

#include <string>

#include "fiona/control.pb.h"

namespace fiona::console {

/// The system as a script that gives it back: the clock where it is not the system's, instances with their parameters
/// in the order in which they were loaded, wires, modes that are not those of the load. The same system always gives
/// the same text.
std::string saved_system(const control::System& system);

}  // namespace fiona::console
