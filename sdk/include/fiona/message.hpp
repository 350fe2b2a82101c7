#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "fiona/service.hpp"
#include "fiona/time.hpp"

namespace fiona {

/// A message under way: the object, shared and immutable from here on, and where it comes from.
/// Ownership is shared because the same object waits in the inboxes of several consumers at once.
struct Envelope {
  std::shared_ptr<const Object> object;
  std::uint64_t sequence = 0;   ///< counts the provider's puts, from 1
  TimePoint origin{};           ///< when the provider put it, or when what it describes was measured
  std::size_t bytes = 0;        ///< serialised size, what bounded queues count
};

/// A message as a handler gets it: the object and its envelope.
template <class T>
struct Received {
  std::shared_ptr<const T> object;
  std::uint64_t sequence = 0;
  TimePoint origin{};
  bool stale = false;  ///< from a provider that has been replaced; nothing has come from the new one yet

  const T& operator*() const { return *object; }
  const T* operator->() const { return object.get(); }
};

namespace detail {

template <class T>
Received<T> received(const Envelope& envelope) {
  return {std::static_pointer_cast<const T>(envelope.object), envelope.sequence, envelope.origin, false};
}

}  // namespace detail

/// Messages of one type that are used again: a fresh 1 MiB costs more in page faults than in copying. Holds at most
/// `kKept` idle messages, and of their bytes at most `kKeptBytes`. [any thread]
class ObjectPool {
 public:
  static constexpr std::size_t kKept = 4;
  static constexpr std::size_t kKeptBytes = 16 * 1024 * 1024;  ///< serialised, as each was at its largest

  /// Makes messages like `prototype`, which must outlive the pool and what it has given out.
  explicit ObjectPool(const Object& prototype) : shelf_(std::make_shared<Shelf>(prototype)) {}

  /// A cleared message that returns to the pool when its last owner lets go, even after the pool itself is gone.
  std::shared_ptr<Object> acquire() {
    Idle taken = shelf_->take();
    return {taken.message.release(), [shelf = shelf_, largest = taken.largest](Object* used) {
              shelf->put_back({std::unique_ptr<Object>(used), largest});
            }};
  }
  /// Messages that wait to be used again.
  std::size_t idle() const { return shelf_->idle(); }

 private:
  /// A message keeps the memory of the largest content it has had.
  struct Idle {
    std::unique_ptr<Object> message;
    std::size_t largest = 0;
  };
  class Shelf {
   public:
    explicit Shelf(const Object& prototype) : prototype_(prototype) {}
    Idle take() {
      {
        const std::lock_guard lock(mutex_);
        if (!idle_.empty()) {
          Idle one = std::move(idle_.back());
          idle_.pop_back();
          bytes_ -= one.largest;
          return one;
        }
      }
      return {std::unique_ptr<Object>(prototype_.New()), 0};
    }
    void put_back(Idle one) {
      one.largest = std::max(one.largest, one.message->ByteSizeLong());
      one.message->Clear();
      const std::lock_guard lock(mutex_);
      if (idle_.size() >= kKept || bytes_ + one.largest > kKeptBytes) return;
      bytes_ += one.largest;
      idle_.push_back(std::move(one));
    }
    std::size_t idle() const {
      const std::lock_guard lock(mutex_);
      return idle_.size();
    }

   private:
    const Object& prototype_;
    mutable std::mutex mutex_;
    std::vector<Idle> idle_;
    std::size_t bytes_ = 0;
  };
  std::shared_ptr<Shelf> shelf_;
};

/// The same, of a type that is known.
template <class T>
class MessagePool {
 public:
  std::shared_ptr<T> acquire() { return std::static_pointer_cast<T>(pool_.acquire()); }

 private:
  ObjectPool pool_{T::default_instance()};
};

}  // namespace fiona
