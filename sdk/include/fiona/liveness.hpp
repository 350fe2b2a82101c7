#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string_view>
#include <vector>

namespace fiona {

/// What the strands of a process are busy with, for whoever watches that none of them hangs. It is in memory that
/// another process may share, so that it is seen from there even when no thread of this one goes on.
///
/// A strand that begins a piece of work writes another number; one that has nothing to do writes 0. A number that stays
/// is a piece of work that does not end: who watches counts by his own clock for how long it has been there.
class Liveness {
 public:
  /// Cache lines of its own for each strand, so that they do not slow each other down. It holds the longest name.
  struct alignas(64) Slot {
    std::atomic<std::uint64_t> work{0};  ///< 0: idle; otherwise a count, then the mark of what is being done
    char name[120] = {};                 ///< of the strand, cut off; ends with 0
  };
  /// Strands of one process at most.
  static constexpr std::size_t kSlots = 4095;
  struct Page {
    alignas(64) std::atomic<std::uint32_t> used{0};  ///< slots below it have been in use
    Slot slots[kSlots];
  };

  /// In memory of its own.
  Liveness();
  /// On a page whose bytes are all zero, and which outlives it.
  explicit Liveness(Page& page) : page_(&page) {}

  const Page& page() const { return *page_; }

  /// A short number for the name of something that a strand does: a port's, or another text. FNV-1a, 32 bits
  /// (http://www.isthe.com/chongo/tech/comp/fnv/).
  static constexpr std::uint32_t mark(std::string_view text) {
    std::uint32_t hash = 2166136261U;
    for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619U;
    return hash;
  }

  /// A slot, until its end.
  class Place {
   public:
    Place() = default;
    /// [any thread] Of no table: nothing is written. Throws Error NotAllowed if all slots are taken.
    Place(std::shared_ptr<Liveness> of, std::string_view name);
    ~Place();
    Place(const Place&) = delete;
    Place& operator=(const Place&) = delete;

    /// [one thread at a time] A piece of work begins.
    void begins(std::uint32_t mark) {
      if (slot_) slot_->work.store(std::uint64_t{++count_} << 32U | mark, std::memory_order_release);
    }
    /// [one thread at a time] Nothing is to be done.
    void rests() {
      if (slot_) slot_->work.store(0, std::memory_order_relaxed);
    }

   private:
    const std::shared_ptr<Liveness> of_{};  ///< shared: a strand may outlive the pool that it ran on
    Slot* slot_ = nullptr;
    std::uint32_t count_ = 0;
  };

 private:
  Slot& take(std::string_view name);
  void give_back(Slot& slot);

  struct Unmap {
    void operator()(Page* page) const;
  };
  std::unique_ptr<Page, Unmap> own_;  ///< mapped: memory that no slot has used is not there
  Page* const page_;
  std::mutex mutex_;
  std::vector<Slot*> free_;
};

}  // namespace fiona
