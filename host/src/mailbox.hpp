#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <cstdint>
#include <deque>
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

  /// [any thread] False when `bound` values wait already; the value is dropped then.
  bool push(T value, std::size_t bound = SIZE_MAX) {
    {
      const std::lock_guard lock(mutex_);
      if (values_.size() >= bound) return false;
      values_.push_back(std::move(value));
    }
    const std::uint64_t one = 1;
    static_cast<void>(::write(signal_.get(), &one, sizeof one));
    return true;
  }

  /// [reader] Everything that waits, oldest first.
  std::deque<T> take() {
    std::uint64_t count = 0;
    static_cast<void>(::read(signal_.get(), &count, sizeof count));
    const std::lock_guard lock(mutex_);
    return std::exchange(values_, {});
  }

 private:
  os::Descriptor signal_;
  std::mutex mutex_;
  std::deque<T> values_;
};

}  // namespace fiona::host
