#pragma once

#include <chrono>
#include <string>

namespace fiona::host {

/// How much of the CPU a process takes, and whether that is more than it may in the long run.
class CpuShare {
 public:
  using Time = std::chrono::steady_clock::time_point;
  /// More than it may for so long is too much: a burst is not.
  static constexpr std::chrono::seconds kWithin{2};

  /// `most` cores; 0: as many as there are.
  explicit CpuShare(double most) : most_(most) {}

  /// Call it every 100 ms or so with the CPU time that it has taken so far. True once, when it is to be held to less.
  bool exceeds(Time now, std::chrono::nanoseconds taken);
  /// Cores, lately.
  double cores() const { return cores_; }
  double most() const { return most_; }

 private:
  const double most_;
  Time since_{};
  std::chrono::nanoseconds taken_{0};
  double cores_ = 0;
  bool held_ = false;
};

}  // namespace fiona::host
