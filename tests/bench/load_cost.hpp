#pragma once

#include "bare_limits.hpp"

namespace fiona::bench {

// Loading a small plugin without protos of its own, `load.messages` times: each time a copy of the library that no
// process has opened before.

/// As a host does: the interface checked, the library opened, its entry called.
Latency plugin_load(const Load& load);
/// Boost.DLL's load, and the entry's symbol.
Latency bare_load(const Load& load);

/// The hash (BLAKE2b) of a library, which installing pays. Microseconds for each MiB.
double hash_us_per_mib();

}  // namespace fiona::bench
