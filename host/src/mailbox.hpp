#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <cstdint>
#include <deque>
#include <map>
#include <mutex>
#include <utility>

#include "os/descriptor.hpp"

namespace fiona::host {

/// Hands values from any thread to the one that polls its descriptor.
template <class T>
class Mailbox {
 public:
  Mailbox() : signal_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

  int descriptor() const { return signal_.get(); }

  /// [any thread] Not where `most` wait already.
  void push(T value, std::size_t most = SIZE_MAX) {
    {
      const std::lock_guard lock(mutex_);
      if (values_.size() >= most) return;
      values_.push_back(std::move(value));
    }
    signal();
  }

  /// [any thread] Has the reader look, though nothing may wait here.
  void wake() { signal(); }

  /// [any thread] For what may be dropped where too much waits, but not the newest of its `key`; that too where the
  /// newest alone are too much.
  void push_newest(std::uint64_t key, T value, std::size_t bytes) {
    {
      const std::lock_guard lock(mutex_);
      const bool full = values_.size() >= kMaxValues || (bytes_ > 0 && bytes_ + bytes > kMaxBytes);
      if (full || !newest_.empty()) {
        keep_newest(key, std::move(value), bytes);
      } else {
        bytes_ += bytes;
        values_.push_back(std::move(value));
      }
    }
    signal();
  }

  /// [any thread] Behind the newest of its `key`.
  void push_last(std::uint64_t key, T value) {
    {
      const std::lock_guard lock(mutex_);
      if (auto newest = newest_.extract(key)) {
        newest_bytes_ -= newest.mapped().bytes;
        values_.push_back(std::move(newest.mapped().value));
      }
      values_.push_back(std::move(value));
    }
    signal();
  }

  /// [reader] Everything that waits, oldest first.
  std::deque<T> take() {
    std::uint64_t count = 0;
    static_cast<void>(::read(signal_.get(), &count, sizeof count));
    const std::lock_guard lock(mutex_);
    for (auto& [key, newest] : std::exchange(newest_, {})) values_.push_back(std::move(newest.value));
    bytes_ = newest_bytes_ = 0;
    return std::exchange(values_, {});
  }

 private:
  static constexpr std::size_t kMaxValues = 10'000;
  static constexpr std::size_t kMaxBytes = 8 * 1024 * 1024;
  static constexpr std::size_t kMaxNewestBytes = 64 * 1024 * 1024;

  struct Newest {
    T value;
    std::size_t bytes = 0;
  };

  /// Called with the mutex held.
  void keep_newest(std::uint64_t key, T value, std::size_t bytes) {
    if (const auto before = newest_.extract(key)) newest_bytes_ -= before.mapped().bytes;
    if (newest_bytes_ + bytes > kMaxNewestBytes) return;
    newest_bytes_ += bytes;
    newest_.emplace(key, Newest{std::move(value), bytes});
  }

  void signal() {
    const std::uint64_t one = 1;
    static_cast<void>(::write(signal_.get(), &one, sizeof one));
  }

  os::Descriptor signal_;
  std::mutex mutex_;
  std::deque<T> values_;
  std::size_t bytes_ = 0;                   ///< of those in values_ that may be dropped
  std::map<std::uint64_t, Newest> newest_;  ///< of what did not fit, one for each key
  std::size_t newest_bytes_ = 0;
};

}  // namespace fiona::host
