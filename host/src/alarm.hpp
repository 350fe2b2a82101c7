#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>

#include "fiona/pool.hpp"
#include "os/descriptor.hpp"

namespace fiona::host {

/// Calls on a thread of the pool, a fixed time after it was set. To set it costs a call of the kernel and wakes nobody.
class Alarm {
 public:
  /// Throws std::system_error where there is no descriptor for it.
  Alarm(Pool& pool, std::chrono::nanoseconds after, std::function<void()> ring);
  /// [any thread] It rings once, `after` the first of all that have set it since it rang last.
  void set();

 private:
  void rung();

  const std::chrono::nanoseconds after_;
  const std::function<void()> ring_;
  const os::Descriptor timer_;
  std::atomic<bool> set_{false};
  const std::unique_ptr<Pool::Readable> watch_;  ///< its end waits for a call that is being made
};

}  // namespace fiona::host
