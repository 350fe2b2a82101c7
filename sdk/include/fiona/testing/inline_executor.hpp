#pragma once

#include <deque>
#include <memory>
#include <mutex>
#include <utility>

#include "fiona/strand.hpp"

namespace fiona::testing {

/// An executor without threads: what was submitted runs, in order, on the thread that calls `help`.
class InlineExecutor final : public Executor {
 public:
  void submit(std::shared_ptr<Runnable> runnable) override {
    const std::lock_guard lock(mutex_);
    waiting_.push_back(std::move(runnable));
  }

  /// Runs until nothing waits. A call from within returns at once.
  void help() override {
    if (std::exchange(helping_, true)) return;
    while (auto next = take()) next->run();
    helping_ = false;
  }

 private:
  std::shared_ptr<Runnable> take() {
    const std::lock_guard lock(mutex_);
    if (waiting_.empty()) return nullptr;
    auto next = std::move(waiting_.front());
    waiting_.pop_front();
    return next;
  }

  std::mutex mutex_;
  std::deque<std::shared_ptr<Runnable>> waiting_;
  bool helping_ = false;
};

}  // namespace fiona::testing
