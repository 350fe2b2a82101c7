#pragma once

#include <algorithm>
#include <chrono>

namespace fiona::tests {

/// When to look again for what is waited for: soon at first, and the longer one has looked the later, so that who waits
/// leaves the processor to what he waits for.
class Polling {
 public:
  explicit Polling(std::chrono::steady_clock::duration deadline) : end_(begun_ + deadline) {}
  bool over() const { return std::chrono::steady_clock::now() > end_; }
  /// 1 to 10 ms: a tenth of the time until now.
  std::chrono::milliseconds pause() const {
    using std::chrono::milliseconds;
    const auto looked = std::chrono::steady_clock::now() - begun_;
    return std::clamp(std::chrono::duration_cast<milliseconds>(looked / 10), milliseconds(1), milliseconds(10));
  }

 private:
  const std::chrono::steady_clock::time_point begun_ = std::chrono::steady_clock::now();
  const std::chrono::steady_clock::time_point end_;
};

}  // namespace fiona::tests
