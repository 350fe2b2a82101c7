#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "fiona/service.hpp"
#include "fiona/time.hpp"

namespace fiona {

/// A message under way: the object, shared and immutable from here on, and where it comes from.
/// Ownership is shared because the same object waits in the inboxes of several consumers at once.
struct Envelope {
  std::shared_ptr<const Object> object;
  std::uint64_t sequence = 0;  ///< counts the provider's puts, from 1
  TimePoint origin{};          ///< when the provider put it, or when what it describes was measured
  std::size_t bytes = 0;       ///< serialised size, what bounded queues count
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

/// Messages of one type that are used again, each with the count of its owners: a fresh 1 MiB costs more in page faults
/// than in copying, and a small one more in the allocator, whose memory wanders between threads, than in the rest of
/// its way. Idle ones are kept: up to `kKeptBytes` of those that have come back lately, and as much of those that are
/// to be taken next. [any thread]
class ObjectPool {
 public:
  /// Serialised, as each message was at its largest, and `kMessageCost` for each.
  static constexpr std::size_t kKeptBytes = 8 * 1024 * 1024;
  static constexpr std::size_t kMessageCost = 256;

  /// Makes messages like `prototype`, which must outlive the pool and what it has given out.
  explicit ObjectPool(const Object& prototype);
  ~ObjectPool();
  ObjectPool(const ObjectPool&) = delete;
  ObjectPool& operator=(const ObjectPool&) = delete;

  /// A cleared message that returns to the pool when its last owner lets go, even after the pool itself is gone.
  std::shared_ptr<Object> acquire();
  /// Messages that wait to be used again.
  std::size_t idle() const;

 private:
  struct Cell;
  class Shelf;
  Shelf* const shelf_;  ///< lives until the pool and all that it has given out are gone
};

/// The same, of a type that is known.
template <class T>
class MessagePool {
 public:
  std::shared_ptr<T> acquire() { return std::static_pointer_cast<T>(pool_.acquire()); }
  std::size_t idle() const { return pool_.idle(); }

 private:
  ObjectPool pool_{T::default_instance()};
};

}  // namespace fiona
