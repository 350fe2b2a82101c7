#pragma once

#include "bare_limits.hpp"

namespace fiona::bench {

/// One value set in a probe of a component, while nobody watches.
Latency set_of_probe(const Load& load);
/// What it cannot do without: a value kept under a lock, with the time at which it was set.
Latency locked_store(const Load& load);

/// A piece of work on a strand that somebody watches, and on one that nobody does.
Latency watched_work(const Load& load);
Latency unwatched_work(const Load& load);

}  // namespace fiona::bench
