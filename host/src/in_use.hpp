#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>

namespace fiona::host {

/// Who is using something that someone else wants to destroy, without a lock that users would share: a grace period as
/// in sleepable read-copy-update (McKenney 2006). To enter never waits.
class InUse {
 public:
  class Scope {
   public:
    explicit Scope(InUse& use) : inside_(use.inside_[use.phase_ & 1U]) { ++inside_; }
    ~Scope() {
      if (--inside_ == 0) inside_.notify_all();
    }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;

   private:
    std::atomic<std::uint32_t>& inside_;
  };

  /// [any thread, inside no scope] Returns when every scope that was entered before has ended, and perhaps some that
  /// were entered meanwhile. What later ones could find must be out of their reach already.
  void wait_for_end() {
    const std::lock_guard lock(waiting_);
    // Twice: who has read the phase before it changed may enter after it did.
    for (int change = 0; change < 2; ++change) {
      auto& inside = inside_[phase_++ & 1U];
      for (std::uint32_t now = inside; now != 0; now = inside) inside.wait(now);
    }
  }

 private:
  std::atomic<std::uint32_t> phase_{0};
  std::array<std::atomic<std::uint32_t>, 2> inside_{};
  std::mutex waiting_;
};

}  // namespace fiona::host
