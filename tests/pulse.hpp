#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <thread>

namespace fiona::tests {

/// How long the machine has kept a thread waiting that wanted to run: what comes later than that by no fault of ours.
class Pulse {
 public:
  Pulse()
      : thread_([this] {
          while (!stopping_) {
            const std::int64_t begun_ns = now_ns();
            std::this_thread::sleep_for(std::chrono::milliseconds(2));
            longest_ns_ = std::max(longest_ns_.load(), now_ns() - begun_ns - 2'000'000);
          }
        }) {}
  ~Pulse() {
    stopping_ = true;
    thread_.join();
  }
  double longest_ms() const { return static_cast<double>(longest_ns_.load()) / 1e6; }

 private:
  static std::int64_t now_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }
  std::atomic<std::int64_t> longest_ns_{0};
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace fiona::tests
