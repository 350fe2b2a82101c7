#pragma once

#include <chrono>
#include <coroutine>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <memory_resource>

#include "fiona/async.hpp"

namespace fiona::planning {

/// Ends a planning from inside: it may hold no more memory.
struct OutOfMemory final : std::exception {
  const char* what() const noexcept override { return "the memory bound was reached"; }
};

/// Ends a planning from inside: it may compute no longer.
struct OutOfTime final : std::exception {
  const char* what() const noexcept override { return "the time bound was reached"; }
};

/// Where all memory of one planning comes from, so that it can be bounded without the process that it shares.
class Memory final : public std::pmr::memory_resource {
 public:
  explicit Memory(std::size_t limit) : limit_(limit) {}
  Memory(const Memory&) = delete;
  Memory& operator=(const Memory&) = delete;

  /// Bytes; the most that were held at once.
  std::size_t peak() const { return peak_; }

 private:
  /// What an allocation costs beside its bytes.
  static constexpr std::size_t kOverhead = 16;

  /// Throws OutOfMemory.
  void* do_allocate(std::size_t bytes, std::size_t alignment) override;
  void do_deallocate(void* block, std::size_t bytes, std::size_t alignment) override;
  bool do_is_equal(const memory_resource& other) const noexcept override { return this == &other; }

  const std::size_t limit_;
  std::size_t used_ = 0;
  std::size_t peak_ = 0;
};

/// Lets a long computation be a coroutine that works in slices, so that a strand can do it between its other work:
///
///     if (pace.due()) co_await pace.pause();
///
/// Asked often, it looks at the clock now and then.
class Pace {
 public:
  using Clock = std::chrono::steady_clock;

  explicit Pace(Clock::duration bound) : bound_(bound) {}
  Pace(const Pace&) = delete;
  Pace& operator=(const Pace&) = delete;

  /// Whether the slice is over; for work of well under a microsecond. Throws OutOfTime.
  bool due() { return --until_look_ == 0 && look(); }
  /// The same for work that takes longer.
  bool look();

  struct Pause {
    Pace& pace;
    bool await_ready() const noexcept { return false; }
    void await_suspend(std::coroutine_handle<> caller) const noexcept { pace.paused_ = caller; }
    void await_resume() const noexcept {}
  };
  Pause pause() { return Pause{*this}; }

  /// Starts `work`, or goes on with it where it paused, until the slice is over or it has ended.
  void run(const Async<>& work, Clock::duration slice);
  /// The time of all slices.
  Clock::duration spent() const { return spent_; }

 private:
  static constexpr std::uint32_t kLookEvery = 512;

  const Clock::duration bound_;
  Clock::duration spent_{};
  Clock::time_point slice_begin_{};
  Clock::duration slice_{};
  std::uint32_t until_look_ = kLookEvery;
  std::coroutine_handle<> paused_{};
};

}  // namespace fiona::planning
