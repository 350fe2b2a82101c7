#include "fiona/message.hpp"

#include <google/protobuf/message.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <utility>

namespace fiona {

/// A message, and room for the count of its owners.
struct ObjectPool::Cell {
  static constexpr std::size_t kCountBytes = 64;

  Cell(Shelf& s, const Object& prototype) : shelf(&s), message(prototype.New()) {}
  std::size_t cost() const { return largest + kMessageCost; }

  Shelf* const shelf;
  const std::unique_ptr<Object> message;
  std::size_t largest = 0;  ///< a message keeps the memory of the largest content it has had
  Cell* below = nullptr;
  alignas(std::max_align_t) std::byte count[kCountBytes];
};

/// Idle cells. Those that have come back lie on a stack, onto which any thread puts one without waiting; whoever takes
/// one takes all of them at once, and the others lie on a stack of the takers' own. So the two, who mostly are
/// different threads, write different cache lines.
class ObjectPool::Shelf {
 public:
  explicit Shelf(const Object& prototype) : prototype_(prototype) {}

  std::shared_ptr<Object> take() {
    Cell* const cell = pop();
    return {cell->message.get(), Clearing{cell}, InCell<Object>{cell}};
  }
  std::size_t idle() const {
    const std::lock_guard lock(taking_);
    std::size_t cells = 0;
    for (const Cell* stack : {own_, back_.load(std::memory_order_acquire)}) {
      for (const Cell* cell = stack; cell; cell = cell->below) ++cells;
    }
    return cells;
  }
  /// Of the pool: nothing is taken any more.
  void close() {
    const std::int64_t taken = taken_;  // for whoever lets go of the last one ends the shelf
    if (balance_.fetch_sub(taken, std::memory_order_acq_rel) == taken) delete this;
  }

 private:
  /// What the last owner does.
  struct Clearing {
    Cell* cell;
    void operator()(Object* message) const {
      cell->largest = std::max(cell->largest, message->ByteSizeLong());
      message->Clear();
    }
  };
  /// The allocator of the owners' count. Once that is let go of, the cell is idle.
  template <class T>
  struct InCell {
    using value_type = T;
    Cell* cell;
    explicit InCell(Cell* c) : cell(c) {}
    template <class U>
    InCell(const InCell<U>& other) : cell(other.cell) {}
    T* allocate(std::size_t) {
      static_assert(sizeof(T) <= Cell::kCountBytes);
      return reinterpret_cast<T*>(cell->count);
    }
    void deallocate(T*, std::size_t) { cell->shelf->put_back(cell); }
    bool operator==(const InCell&) const = default;
  };

  ~Shelf() {
    take_back();
    drop_own();
  }
  Cell* pop() {
    const std::lock_guard lock(taking_);
    if (!own_ || own_->largest > kLarge) take_back();
    Cell* cell = own_;
    if (!cell) {
      cell = new Cell(*this, prototype_);
    } else {
      own_ = cell->below;
      own_bytes_ -= static_cast<std::int64_t>(cell->cost());
      if (own_) __builtin_prefetch(own_);  // it comes from another thread's cache
    }
    ++taken_;
    return cell;
  }
  /// The newest go before the others, as long as they fit together; else the others go.
  void take_back() {
    const std::int64_t bytes = back_bytes_.exchange(0, std::memory_order_relaxed);
    Cell* const newest = back_.exchange(nullptr, std::memory_order_acquire);
    if (own_bytes_ + bytes > static_cast<std::int64_t>(kKeptBytes)) drop_own();
    own_bytes_ += bytes;
    if (!newest) return;
    Cell* oldest = newest;
    while (own_ && oldest->below) oldest = oldest->below;
    if (own_) oldest->below = own_;
    own_ = newest;
  }
  void drop_own() {
    while (own_) {
      own_bytes_ -= static_cast<std::int64_t>(own_->cost());
      delete std::exchange(own_, own_->below);
    }
  }
  void put_back(Cell* cell) {
    const auto cost = static_cast<std::int64_t>(cell->cost());
    if (back_bytes_.fetch_add(cost, std::memory_order_relaxed) + cost > static_cast<std::int64_t>(kKeptBytes)) {
      back_bytes_.fetch_sub(cost, std::memory_order_relaxed);
      delete cell;
    } else {
      cell->below = back_.load(std::memory_order_relaxed);
      while (!back_.compare_exchange_weak(cell->below, cell, std::memory_order_release, std::memory_order_relaxed)) {
      }
    }
    if (balance_.fetch_add(1, std::memory_order_acq_rel) == -1) delete this;
  }

  static constexpr std::size_t kCacheLine = 64;
  static constexpr std::size_t kLarge = 64 * 1024;  ///< of these the newest is taken, which may still be in a cache
  const Object& prototype_;
  // The takers'.
  mutable std::mutex taking_;
  Cell* own_ = nullptr;
  std::int64_t own_bytes_ = 0;  ///< what those on the stack cost, and what is about to come back and counted already
  std::int64_t taken_ = 0;
  // Of those who put back.
  alignas(kCacheLine) std::atomic<Cell*> back_{nullptr};
  std::atomic<std::int64_t> back_bytes_{0};  ///< what those on the stack cost
  std::atomic<std::int64_t> balance_{0};     ///< put back; once the pool is closed, less all that were taken
};

ObjectPool::ObjectPool(const Object& prototype) : shelf_(new Shelf(prototype)) {}
ObjectPool::~ObjectPool() { shelf_->close(); }
std::shared_ptr<Object> ObjectPool::acquire() { return shelf_->take(); }
std::size_t ObjectPool::idle() const { return shelf_->idle(); }

}  // namespace fiona
