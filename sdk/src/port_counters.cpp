#include "fiona/port_counters.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include "fiona/clock.hpp"

namespace fiona {

void PortCounters::count(TimePoint origin) {
  messages.fetch_add(1, std::memory_order_relaxed);
  const std::int64_t now_ns = origin.time_since_epoch().count();
  newest_ns.store(now_ns, std::memory_order_relaxed);
  constexpr std::int64_t kWindowNs = 1'000'000'000;
  // Origins may step back a little, as those of the rows of a radio scan do: that is no new beginning.
  constexpr std::int64_t kStepBackNs = 60 * kWindowNs;
  if (window_start_ns_ < 0 || now_ns < window_start_ns_ - kStepBackNs) {
    window_start_ns_ = now_ns;
    window_messages_ = 0;
    return;
  }
  ++window_messages_;
  const std::int64_t elapsed_ns = now_ns - window_start_ns_;
  if (elapsed_ns < kWindowNs) return;
  rate_hz.store(static_cast<float>(static_cast<double>(window_messages_) * 1e9 / static_cast<double>(elapsed_ns)),
                std::memory_order_relaxed);
  window_start_ns_ = now_ns;
  window_messages_ = 0;
}

void PortCounters::count_arrival(TimePoint origin, const Clock& clock) {
  count(origin);
  constexpr float kManyHz = 1000;
  constexpr std::uint64_t kOneOf = 16;
  const bool many = rate_hz.load(std::memory_order_relaxed) > kManyHz;
  if (many && window_messages_ % kOneOf != 0) return;
  const TimePoint now = clock.now();
  latencies.add(now - origin, now);
}

void PortCounters::supersede_arrived() {
  superseded.fetch_add(1, std::memory_order_relaxed);
  messages.fetch_sub(1, std::memory_order_relaxed);
}

void PortCounters::refuse(std::string reason, TimePoint now) {
  const std::lock_guard lock(mutex_);
  refused.fetch_add(1, std::memory_order_relaxed);
  refusal_ = Refusal{std::move(reason), now};
}

std::optional<PortCounters::Refusal> PortCounters::last_refusal() const {
  const std::lock_guard lock(mutex_);
  return refusal_;
}

std::optional<Duration> PortCounters::age(TimePoint now) const {
  const std::int64_t newest = newest_ns.load(std::memory_order_relaxed);
  if (newest < 0) return std::nullopt;
  return std::max(Duration::zero(), now.time_since_epoch() - Duration(newest));
}

double PortCounters::rate_now_hz(TimePoint now) const {
  const auto newest = age(now);
  return !newest || *newest > std::chrono::seconds(3) ? 0.0
                                                      : static_cast<double>(rate_hz.load(std::memory_order_relaxed));
}

}  // namespace fiona
