#include "fiona/latencies.hpp"

#include <algorithm>
#include <bit>
#include <chrono>

namespace fiona {
namespace {

/// Below it a class is one microsecond wide.
constexpr std::size_t kLinear = 8;
constexpr std::size_t kPerOctave = 4;
constexpr std::int64_t kMostMicroseconds = (std::int64_t{1} << 27U) - 1;

}  // namespace

std::size_t Latencies::class_of(Duration latency) {
  const auto us = static_cast<std::uint64_t>(std::clamp<std::int64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(latency).count(), 0, kMostMicroseconds));
  if (us < kLinear) return us;
  const auto shift = static_cast<std::size_t>(std::bit_width(us)) - 3;
  return shift * kPerOctave + (us >> shift);
}

Duration Latencies::middle_of(std::size_t index) {
  const std::size_t shift = index < kLinear ? 0 : index / kPerOctave - 1;
  const std::size_t low = index < kLinear ? index : (index % kPerOctave + kPerOctave) << shift;
  return std::chrono::nanoseconds(1000 * low + 500 * (std::size_t{1} << shift));
}

void Latencies::add(Duration latency, TimePoint now) {
  const std::int64_t now_ns = now.time_since_epoch().count();
  const std::int64_t start_ns = windows_[current_].start_ns.load(std::memory_order_relaxed);
  if (start_ns < 0 || now_ns - start_ns >= kWindow.count()) {
    current_ = start_ns < 0 ? current_ : 1 - current_;
    for (auto& count : windows_[current_].counts) count.store(0, std::memory_order_relaxed);
    windows_[current_].start_ns.store(now_ns, std::memory_order_relaxed);
  }
  windows_[current_].counts[class_of(latency)].fetch_add(1, std::memory_order_relaxed);
}

bool Latencies::is_recent(const Window& window, TimePoint now) const {
  const std::int64_t start_ns = window.start_ns.load(std::memory_order_relaxed);
  return start_ns >= 0 && now.time_since_epoch().count() - start_ns < 2 * kWindow.count();
}

std::optional<Latencies::Quantiles> Latencies::recent(TimePoint now) const {
  std::array<std::uint64_t, kClasses> counts{};
  std::uint64_t all = 0;
  for (const Window& window : windows_) {
    if (!is_recent(window, now)) continue;
    for (std::size_t i = 0; i < kClasses; ++i) {
      const std::uint32_t count = window.counts[i].load(std::memory_order_relaxed);
      counts[i] += count;
      all += count;
    }
  }
  if (all == 0) return std::nullopt;
  const auto quantile = [&](std::uint64_t percent) {
    const std::uint64_t wanted = (all * percent + 99) / 100;
    std::uint64_t seen = 0;
    std::size_t i = 0;
    while ((seen += counts[i]) < wanted) ++i;
    return middle_of(i);
  };
  return Quantiles{quantile(50), quantile(99)};
}

}  // namespace fiona
