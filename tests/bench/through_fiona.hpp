#pragma once

#include "bare_limits.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {

// What bare_limits.hpp measures of the bare limit, through two instances that a host has loaded and wired. Both
// are in `main`; or each in a group of its own; or the consumers on another host.
using conformance::Transport;

Latency push(const Load& load, Transport transport);
/// Back to back, each asked when the one before is answered.
Latency query(const Load& load, Transport transport);
/// The slowest of the consumers says how long each message took; `window` messages may be under way. A lost message is
/// an error.
Latency stream(const Load& load, std::size_t consumers, std::size_t window, Transport transport);
/// From the command that wires to the consumer's first message.
Latency wire_to_first_message(const Load& load, Transport transport);
/// From the command that rewires from a provider that says nothing just now to the first message of the other one.
Latency rewire_to_first_message(const Load& load, Transport transport);

}  // namespace fiona::bench
