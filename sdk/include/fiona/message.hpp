#pragma once

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

/// Messages that are used again: a fresh 1 MiB costs more in page faults than in copying. Holds at most `kKept` idle
/// messages. [any thread]
template <class T>
class MessagePool {
 public:
  /// A cleared message that returns to the pool when its last owner lets go, even after the pool itself is gone.
  std::shared_ptr<T> acquire() {
    std::unique_ptr<T> message = shelf_->take();
    if (!message) message = std::make_unique<T>();
    T* raw = message.release();
    return std::shared_ptr<T>(raw, [shelf = shelf_](T* used) { shelf->put_back(std::unique_ptr<T>(used)); });
  }

 private:
  static constexpr std::size_t kKept = 16;

  class Shelf {
   public:
    std::unique_ptr<T> take() {
      const std::lock_guard lock(mutex_);
      if (idle_.empty()) return nullptr;
      auto message = std::move(idle_.back());
      idle_.pop_back();
      return message;
    }
    void put_back(std::unique_ptr<T> message) {
      message->Clear();
      const std::lock_guard lock(mutex_);
      if (idle_.size() < kKept) idle_.push_back(std::move(message));
    }

   private:
    std::mutex mutex_;
    std::vector<std::unique_ptr<T>> idle_;
  };
  std::shared_ptr<Shelf> shelf_ = std::make_shared<Shelf>();
};

}  // namespace fiona
