#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "fiona/time.hpp"

namespace fiona {

/// How long what arrived had been under way, over the last ten to twenty seconds: counted in classes that are a quarter
/// of an octave wide, as in a high dynamic range histogram, so that a quantile is right to one part in ten.
class Latencies {
 public:
  /// Written by one thread at a time. Longer than 134 s is counted as that; negative, between two hosts, as 0.
  void add(Duration latency, TimePoint now);

  struct Quantiles {
    Duration p50;
    Duration p99;
  };
  /// [any thread] None: nothing has arrived lately.
  std::optional<Quantiles> recent(TimePoint now) const;

 private:
  static constexpr std::size_t kClasses = 104;  ///< of microseconds up to 2^27
  static constexpr Duration kWindow = std::chrono::seconds(10);
  struct Window {
    std::atomic<std::int64_t> start_ns{-1};  ///< -1: not begun
    std::array<std::atomic<std::uint32_t>, kClasses> counts{};
  };
  static std::size_t class_of(Duration latency);
  static Duration middle_of(std::size_t index);
  bool is_recent(const Window& window, TimePoint now) const;

  std::array<Window, 2> windows_{};
  std::size_t current_ = 0;  ///< of the thread that adds
};

}  // namespace fiona
