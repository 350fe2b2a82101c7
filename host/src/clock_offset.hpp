#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>

#include "fiona/wire.pb.h"

namespace fiona::host {

/// A time, or how long something lasts, that a peer has told: not before 1970, and before 2043, where sums of times do
/// not overflow.
constexpr std::int64_t told_ns(std::int64_t ns) { return std::clamp<std::int64_t>(ns, 0, 1LL << 61); }

/// How far another host's timeline is ahead of ours, from the beats that go to and fro. Half of a round trip at most is
/// its error (Mills, RFC 5905, section 8), and that of an old one grows by what clocks wander: what has the smallest
/// error now counts. So a way that becomes slow does not make the ages wrong that a quick one has told.
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
  struct Trip {
    std::int64_t error_ns = 0;
    std::int64_t ahead_ns = 0;
    std::int64_t at_ns = 0;
  };
  std::optional<Trip> best_;
  std::atomic<std::int64_t> ahead_ns_{0};
};

}  // namespace fiona::host
