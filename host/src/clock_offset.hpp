#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <mutex>
#include <utility>

#include "fiona/wire.pb.h"

namespace fiona::host {

/// How far another host's timeline is ahead of ours, from the beats that go to and fro: of the last few round trips the
/// shortest counts, half of it at most is the error (Mills, RFC 5905, section 8).
class ClockOffset {
 public:
  /// [any thread] The next beat to send.
  wire::Beat beat(std::int64_t now_ns);
  /// [any thread] A beat came. One that cannot be true is ignored.
  void heard(const wire::Beat& beat, std::int64_t now_ns);
  /// [any thread] A time of theirs on our timeline.
  std::int64_t to_ours(std::int64_t theirs_ns) const;
  /// [any thread] Turns the origin that a frame carries into ours.
  void turn(wire::Frame& frame) const;
  std::int64_t ahead_ns() const { return ahead_ns_.load(); }

 private:
  std::mutex mutex_;
  std::int64_t echo_ns_ = 0;
  std::int64_t heard_ns_ = 0;
  std::deque<std::pair<std::int64_t, std::int64_t>> trips_;  ///< round trip, ahead
  std::atomic<std::int64_t> ahead_ns_{0};
};

}  // namespace fiona::host
