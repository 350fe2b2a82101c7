#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace fiona::bench {

/// One series of paced messages.
struct Load {
  std::size_t bytes = 64;
  std::size_t messages = 2000;
  double period_ms = 0.5;
};

/// Latencies from just before the send call to the receiver, nanoseconds.
struct Latency {
  double median_ns = 0;
  double p99_ns = 0;
};

Latency summarise(std::vector<std::int64_t> latencies_ns);
std::int64_t steady_ns();

/// A shared_ptr through a queue with mutex and condition variable to another thread: the least that a hand-over to
/// another strand can cost.
Latency through_queue(const Load& load);

/// The same bytes through a bare ZeroMQ PUSH/PULL pair over ipc to another process (`self`, started as receiver).
Latency through_zeromq(const Load& load, const std::string& self);
/// The receiver's side; prints the two figures. The exit code.
int receive_zeromq(const std::string& endpoint, std::size_t messages);

/// A round trip over a bare REQ/REP pair over ipc, the answer as large as the question, back to back.
Latency query_through_zeromq(const Load& load, const std::string& self);
int answer_zeromq(const std::string& endpoint);

/// Time for each message of a stream at full speed to `receivers` of one process, each filled anew, none lost: bare
/// PUB/SUB over ipc that waits where a queue is full.
Latency stream_through_zeromq(const Load& load, std::size_t receivers, const std::string& self);
int count_zeromq(const std::string& endpoint, std::size_t messages, std::size_t receivers);

/// From the call that connects to the first message of a publisher that sends every `load.period_ms`, `load.messages`
/// times over: a queue that is added to the publisher's list under its lock, in one process.
Latency connect_to_queue(const Load& load);
/// The same: a new SUB socket over ipc, the publisher in another process.
Latency connect_over_zeromq(const Load& load, const std::string& self);
/// The publisher's side: until something is said to it.
int publish_zeromq(const std::string& endpoint, double period_ms);

}  // namespace fiona::bench
