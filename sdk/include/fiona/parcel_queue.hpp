#pragma once

#include <cstddef>
#include <deque>
#include <utility>
#include <vector>

#include "fiona/parcel.hpp"

namespace fiona {

/// Parcels in their order, in blocks. Who empties it takes a whole block by a swap: the lock is held for a moment
/// however many they are, and who fills it hardly ever has to wait for that, which would cost more than a message.
/// It has no lock and no bound of its own: an inbox holds its strand's mutex, and fills it up to `Inbox::kMaxBytes`. A
/// block that has been taken is its taker's alone.
class ParcelQueue {
 public:
  /// Parcels of a block: those that leave the queue at once, so that "drop the oldest" finds most of them still there.
  static constexpr std::size_t kBlock = 64;
  /// Bytes of a block, unless its last parcel has more: large messages leave one by one, for the same reason.
  static constexpr std::size_t kBlockBytes = 64 * 1024;

  /// What has been taken, from the oldest on.
  class Block {
   public:
    bool empty() const { return next_ == parcels_.size(); }
    std::size_t size() const { return parcels_.size() - next_; }
    Parcel pop() { return std::move(parcels_[next_++]); }
    void clear() {
      parcels_.clear();
      next_ = 0;
      bytes_ = 0;
    }
    template <class F>
    void for_each(const F& what) const {
      for (std::size_t i = next_; i < parcels_.size(); ++i) what(parcels_[i]);
    }

   private:
    friend class ParcelQueue;
    bool is_full() const { return parcels_.size() == kBlock || bytes_ >= kBlockBytes; }
    std::vector<Parcel> parcels_;
    std::size_t next_ = 0;
    std::size_t bytes_ = 0;  ///< of all that it was given
  };

  bool empty() const { return size_ == 0; }
  std::size_t size() const { return size_; }

  void push(Parcel&& parcel) {
    if (blocks_.empty() || blocks_.back().is_full()) blocks_.push_back(std::exchange(spare_, {}));
    blocks_.back().bytes_ += parcel.envelope.bytes;
    blocks_.back().parcels_.push_back(std::move(parcel));
    ++size_;
  }
  Parcel pop() {
    Parcel oldest = blocks_.front().pop();
    if (blocks_.front().empty()) blocks_.pop_front();
    --size_;
    return oldest;
  }
  /// The oldest block in the place of an empty one, whose memory is used for one to come; nothing of an empty queue.
  void take(Block& block) {
    if (empty()) return;
    block.clear();
    std::swap(block, blocks_.front());
    size_ -= block.size();
    spare_ = std::move(blocks_.front());
    blocks_.pop_front();
  }
  void clear() {
    blocks_.clear();
    size_ = 0;
  }
  template <class F>
  void for_each(const F& what) const {
    for (const Block& block : blocks_) block.for_each(what);
  }

 private:
  std::deque<Block> blocks_;  ///< none of them empty
  Block spare_;
  std::size_t size_ = 0;
};

}  // namespace fiona
