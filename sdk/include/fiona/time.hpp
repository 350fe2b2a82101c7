#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace fiona {

using Duration = std::chrono::nanoseconds;

/// The time that components live in: read from the instance's clock (system, simulated or replayed), never from
/// the operating system. It only grows. On the system clock it is Unix time at the host's start plus what has
/// passed since, so it does not jump when the machine's clock is set; on a virtual clock it starts at zero, or at the
/// Unix time that the clock was given: where a recording began that is replayed.
struct Timeline {
  using duration = Duration;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::time_point<Timeline, Duration>;
  static constexpr bool is_steady = true;
};

using TimePoint = Timeline::time_point;

/// `time` and `duration` later, or the end of time where that is beyond it: `Duration::max()` is a deadline, too.
template <class C, class D>
constexpr std::chrono::time_point<C, D> saturating_sum(std::chrono::time_point<C, D> time, Duration duration) {
  using Time = std::chrono::time_point<C, D>;
  return duration > Time::max() - std::max(time, Time{}) ? Time::max() : time + duration;
}

/// So many milliseconds, or the longest that there is on that side of zero; what is no number (NaN) is none.
constexpr Duration from_milliseconds(double ms) {
  constexpr double kMost_ms = 9e12;
  if (ms >= kMost_ms) return Duration::max();
  if (ms <= -kMost_ms) return Duration::min();
  if (ms != ms) return Duration::zero();
  return std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(ms));
}

/// Milliseconds since the timeline's epoch: the document's `T` attributes.
constexpr std::int64_t to_milliseconds(TimePoint time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
}

constexpr double to_seconds(Duration duration) { return std::chrono::duration<double>(duration).count(); }

}  // namespace fiona
