#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>

#include "fiona/latencies.hpp"
#include "fiona/time.hpp"

namespace fiona {

class Clock;

/// Counters of a port, written on its strand or link, read by anyone.
struct PortCounters {
  std::atomic<std::uint64_t> messages{0};    ///< put, or received; of a slot: read, or not overwritten yet
  std::atomic<std::uint64_t> superseded{0};  ///< overwritten by a newer value before anyone read them
  std::atomic<std::uint64_t> dropped{0};     ///< lost to a full queue or an outage, or too old
  std::atomic<std::uint64_t> refused{0};     ///< failed the check of size, range or finiteness: `refuse`
  std::atomic<std::uint64_t> not_active{0};  ///< arrived in a mode that does not serve the port
  std::atomic<std::int64_t> newest_ns{-1};   ///< origin of the newest message on the instance's clock
  std::atomic<float> rate_hz{0};             ///< over the last second or so of the instance's clock

  Latencies latencies;  ///< from the origin of what arrived to the handler, or into the slot

  /// [strand] One more message, of this origin.
  void count(TimePoint origin);
  /// [strand] One more message that has arrived. Of many a second the latency of some is taken.
  void count_arrival(TimePoint origin, const Clock& clock);
  /// [any thread] One that has arrived is overwritten before anyone read it.
  void supersede_arrived();
  /// [any thread] One more was refused, for this reason.
  void refuse(std::string reason, TimePoint now);
  struct Refusal {
    std::string reason;
    TimePoint at{};
  };
  /// [any thread] The last one.
  std::optional<Refusal> last_refusal() const;
  /// [any thread] Of the newest message; none: there was none.
  std::optional<Duration> age(TimePoint now) const;
  /// [any thread] The rate, where it is not from long ago.
  double rate_now_hz(TimePoint now) const;

 private:
  std::int64_t window_start_ns_ = -1;
  std::uint64_t window_messages_ = 0;
  mutable std::mutex mutex_;
  std::optional<Refusal> refusal_;
};

}  // namespace fiona
