#pragma once

#include <cstddef>

namespace fiona::bench {

/// Of the heap, for each further instance with four ports that does nothing. KiB.
double instance_kib();
/// Proportional set size of a group with one instance, beside others: what they share counts once for all. MiB.
double group_mib(std::size_t groups);
/// Memory of a process with one publisher and one subscriber, 64 bytes a millisecond. KiB.
struct Memory {
  double resident = 0;      ///< RSS
  double proportional = 0;  ///< PSS
};
/// A host; both in `main`.
Memory host_memory();
/// A process with libzmq and protobuf alone.
Memory bare_memory();
/// From nothing to `components` that are active, half of them wired to the other half: in so many groups, 0: in `main`.
/// Seconds.
double start_s(std::size_t components, std::size_t groups);

}  // namespace fiona::bench
