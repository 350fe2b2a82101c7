#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace fiona::bench {

/// One series of messages, paced where it says so.
struct Load {
  std::size_t bytes = 64;
  std::size_t messages = 2000;
  double period_ms = 0.5;
};

/// Nanoseconds: latencies from just before the send call to the receiver, or what each message of a stream took.
struct Latency {
  double median_ns = 0;
  double p99_ns = 0;
};

Latency summarise(std::vector<std::int64_t> latencies_ns);
std::int64_t steady_ns();

// ---- in one process: the least that a hand-over to another strand can cost (bare_queue.cpp)

/// A shared_ptr through a queue with mutex and condition variable to another thread.
Latency through_queue(const Load& load);
/// There and back through two of them, back to back, either message filled anew.
Latency round_trip_through_queues(const Load& load);
/// Time for each message of a stream at full speed to `receivers` threads with a queue each, filled once, at most
/// `window` ahead of the slowest.
Latency stream_through_queues(const Load& load, std::size_t receivers, std::size_t window);
/// From the call that connects to the first message of a publisher that sends every `load.period_ms`, `load.messages`
/// times over: a queue that is added to the publisher's list under its lock.
Latency connect_to_queue(const Load& load);

// ---- between processes: bare ZeroMQ (bare_zeromq.cpp)

/// How two processes are connected, and the program that is the other one.
struct Medium {
  std::string self;
  bool tcp = false;  ///< with CURVE, over the loopback; else ipc
};

/// The same bytes through a PUSH/PULL pair.
Latency through_zeromq(const Load& load, const Medium& medium);
/// A round trip over a REQ/REP pair, the answer as large as the question, back to back.
Latency query_through_zeromq(const Load& load, const Medium& medium);
/// Time for each message of a stream at full speed to `receivers` of one process, each filled anew, none lost:
/// PUB/SUB that waits where a queue is full.
Latency stream_through_zeromq(const Load& load, std::size_t receivers, const Medium& medium);
/// As `connect_to_queue`: a new SUB socket, the publisher in another process.
Latency connect_over_zeromq(const Load& load, const Medium& medium);

/// What the other process does, where the first of these arguments of the program names something of the above: its
/// exit code. Else -1.
int other_side(int argc, char** argv);

}  // namespace fiona::bench
