#pragma once

#include <cstddef>

namespace fiona::bench {

/// Of the heap, for each further instance with four ports that does nothing. KiB.
double instance_kib();
/// Proportional set size of a group with one instance. MiB.
double group_mib();
/// From nothing to `components` that are active, half of them wired to the other half: in so many groups, 0: in `main`.
/// Seconds.
double start_s(std::size_t components, std::size_t groups);

}  // namespace fiona::bench
