#include "fiona/message.hpp"

#include <google/protobuf/message.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <mutex>

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

/// A stack of idle cells: any thread puts one on it without waiting, one at a time takes from it (so that none can have
/// been taken and put back between a look and the exchange).
class ObjectPool::Shelf {
 public:
  explicit Shelf(const Object& prototype) : prototype_(prototype) {}

  std::shared_ptr<Object> take() {
    Cell* cell = pop();
    if (!cell) cell = new Cell(*this, prototype_);
    users_.fetch_add(1, std::memory_order_relaxed);
    return {cell->message.get(), Clearing{cell}, InCell<Object>{cell}};
  }
  std::size_t idle() const {
    const std::lock_guard lock(taking_);
    std::size_t cells = 0;
    for (const Cell* cell = top_.load(std::memory_order_acquire); cell; cell = cell->below) ++cells;
    return cells;
  }
  void leave() {
    if (users_.fetch_sub(1, std::memory_order_acq_rel) == 1) delete this;
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
    while (Cell* cell = pop()) delete cell;
  }
  Cell* pop() {
    const std::lock_guard lock(taking_);
    Cell* cell = top_.load(std::memory_order_acquire);
    while (cell && !top_.compare_exchange_weak(cell, cell->below, std::memory_order_acquire)) {
    }
    if (cell) bytes_.fetch_sub(cell->cost(), std::memory_order_relaxed);
    return cell;
  }
  void put_back(Cell* cell) {
    const std::size_t cost = cell->cost();
    if (bytes_.fetch_add(cost, std::memory_order_relaxed) + cost > kKeptBytes) {
      bytes_.fetch_sub(cost, std::memory_order_relaxed);
      delete cell;
    } else {
      cell->below = top_.load(std::memory_order_relaxed);
      while (!top_.compare_exchange_weak(cell->below, cell, std::memory_order_release, std::memory_order_relaxed)) {
      }
    }
    leave();
  }

  const Object& prototype_;
  mutable std::mutex taking_;
  std::atomic<Cell*> top_{nullptr};
  std::atomic<std::size_t> bytes_{0};  ///< cost of what is idle
  std::atomic<std::size_t> users_{1};  ///< the pool, and each message that is out
};

ObjectPool::ObjectPool(const Object& prototype) : shelf_(new Shelf(prototype)) {}
ObjectPool::~ObjectPool() { shelf_->leave(); }
std::shared_ptr<Object> ObjectPool::acquire() { return shelf_->take(); }
std::size_t ObjectPool::idle() const { return shelf_->idle(); }

}  // namespace fiona
