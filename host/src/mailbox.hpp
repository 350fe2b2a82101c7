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

  /// [any thread] For what may be dropped where too much waits, but not the newest of its `key`.
  void push_newest(std::uint64_t key, T value, std::size_t bytes) {
    {
      const std::lock_guard lock(mutex_);
      const bool full = values_.size() >= kMaxValues || (bytes_ > 0 && bytes_ + bytes > kMaxBytes);
      if (full || !newest_.empty()) {
        newest_.insert_or_assign(key, std::move(value));
      } else {
        bytes_ += bytes;
        values_.push_back(std::move(value));
      }
    }
    signal();
  }

  /// [reader] Everything that waits, oldest first.
  std::deque<T> take() {
    std::uint64_t count = 0;
    static_cast<void>(::read(signal_.get(), &count, sizeof count));
    const std::lock_guard lock(mutex_);
    for (auto& [key, value] : std::exchange(newest_, {})) values_.push_back(std::move(value));
    bytes_ = 0;
    return std::exchange(values_, {});
  }

 private:
  static constexpr std::size_t kMaxValues = 10'000;
  static constexpr std::size_t kMaxBytes = 8 * 1024 * 1024;

  void signal() {
    const std::uint64_t one = 1;
    static_cast<void>(::write(signal_.get(), &one, sizeof one));
  }

  os::Descriptor signal_;
  std::mutex mutex_;
  std::deque<T> values_;
  std::size_t bytes_ = 0;              ///< of those in values_ that may be dropped
  std::map<std::uint64_t, T> newest_;  ///< of what did not fit, one for each key
};

}  // namespace fiona::host
