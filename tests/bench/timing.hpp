#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <vector>

namespace fiona::bench {

template <class F>
double milliseconds_of(F work) {
  const auto begun = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begun).count();
}

/// Sorts the times; `share` 0 .. 1.
inline double percentile(std::vector<double>& times, double share) {
  std::sort(times.begin(), times.end());
  return times[static_cast<std::size_t>(share * static_cast<double>(times.size() - 1))];
}

}  // namespace fiona::bench
