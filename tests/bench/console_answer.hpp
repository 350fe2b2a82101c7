#pragma once

namespace fiona::bench {

/// What a user waits for, from starting `fiona` to its end, while a host with 100 instances moves 20,000 messages a
/// second: the 99th percentile of 200, in milliseconds. Throws when the host does not move them.
double ls_ms();
double completion_ms();

}  // namespace fiona::bench
