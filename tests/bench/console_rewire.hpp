#pragma once

#include "through_fiona.hpp"

namespace fiona::bench {

/// As `rewire_to_first_message`, but from the request that a console sends: over its socket to a host in a process of
/// its own, whose journal has the transaction before it begins.
Latency console_rewire_to_first_message(const Load& load, Transport transport);

}  // namespace fiona::bench
