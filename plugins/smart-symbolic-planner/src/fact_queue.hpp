#pragma once

#include <array>
#include <bit>

#include "lifted_task.hpp"

namespace fiona::planning {

/// Facts by cost, the lowest first, where no cost is pushed that is below the one popped last: a radix heap (Ahuja,
/// Mehlhorn, Orlin and Tarjan, "Faster algorithms for the shortest path problem", JACM 37, 1990).
class FactQueue {
 public:
  struct Entry {
    Cost cost;
    Index fact;
  };

  explicit FactQueue(std::pmr::memory_resource* memory) : buckets_(memory) { buckets_.resize(kBuckets); }

  bool empty() const { return size_ == 0; }
  /// And begins again at zero.
  void clear() {
    for (auto& bucket : buckets_) bucket.clear();
    last_ = 0;
    size_ = 0;
  }
  void push(Cost cost, Index fact) {
    buckets_[bucket_of(cost)].push_back({cost, fact});
    ++size_;
  }
  Entry pop() {
    if (buckets_[0].empty()) refill();
    --size_;
    const Entry entry = buckets_[0].back();
    buckets_[0].pop_back();
    return entry;
  }

 private:
  static constexpr std::size_t kBuckets = 64;
  /// By the highest bit in which it differs from the lowest.
  std::size_t bucket_of(Cost cost) const {
    return static_cast<std::size_t>(std::bit_width(static_cast<std::uint64_t>(cost ^ last_)));
  }

  void refill() {
    std::size_t first = 1;
    while (buckets_[first].empty()) ++first;
    last_ = buckets_[first].front().cost;
    for (const Entry& entry : buckets_[first]) last_ = entry.cost < last_ ? entry.cost : last_;
    for (const Entry& entry : buckets_[first]) buckets_[bucket_of(entry.cost)].push_back(entry);
    buckets_[first].clear();
  }

  List<List<Entry>> buckets_;
  Cost last_ = 0;
  std::size_t size_ = 0;
};

}  // namespace fiona::planning
