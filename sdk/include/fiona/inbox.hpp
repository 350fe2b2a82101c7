#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/parcel.hpp"
#include "fiona/parcel_queue.hpp"
#include "fiona/port_options.hpp"
#include "fiona/result.hpp"
#include "fiona/strand.hpp"

namespace fiona {

class ActivityHold;
class Port;
class Task;

/// The bounded queue in front of a handler, or the slot of a *newest* subscription.
class Inbox {
 public:
  /// Ends a parcel on the strand. An Async that it returns keeps the next parcel waiting until it has ended.
  using Handler = std::function<std::optional<Async<>>(const Parcel&)>;

  /// Bytes that may wait, unless a single message is larger (docs/architecture.md, The way of a message).
  static constexpr std::size_t kMaxBytes = 4 * 1024 * 1024;
  static constexpr const char* kFull = "the provider's queue is full";

  Inbox(Port& port, Delivery delivery, Handler handler, Duration max_age = {});
  ~Inbox();

  /// [any thread] Queues the parcel; when full, the oldest goes and is counted (push), or the parcel is refused
  /// with Rejected (send, query: nothing that a client counts on is dropped behind its back).
  Outcome push(Parcel parcel);
  /// [any thread] The same, of messages of a push that have come together: they wait for the lock once. Empties it.
  void push_all(std::vector<Parcel>& parcels);

  /// The value in the slot of a *newest* inbox; stale: from a provider that has been replaced.
  struct Newest {
    Envelope envelope;
    bool stale = false;
  };
  /// [any thread] The slot of a *newest* inbox without handler, unless it is too old; the value stays.
  std::optional<Newest> newest();
  /// [any thread] Calls `waiter` once, with the envelope, on the strand, when the next message has come, as long as
  /// `who` lives.
  void on_next(std::weak_ptr<const void> who, std::function<void(const Envelope&)> waiter);
  /// [any thread] Nobody waits by this name any more.
  void forget_next(const std::weak_ptr<const void>& who);
  /// [any thread] What is in the slot is from a provider that has been replaced.
  void mark_stale();
  /// [any thread] Empties the slot. What waits for a handler has arrived, and still reaches it.
  void empty_slot();
  /// [strand] The port's mode is left, or entered: what waits here, and what is in the slot, is of the one before.
  /// Counted; requests are answered with NotActive.
  void leave_mode();
  /// Each parcel that finds no mode for it is told, on the strand. While the component is made.
  void on_not_active(std::function<void(const Parcel&)> told) { on_not_active_ = std::move(told); }
  /// [any thread] Empties queue and slot; requests are answered with `outcome`.
  void clear(Outcome outcome);

  Port& port() const { return port_; }
  /// Each arrival that the instance's mode serves may start the task. While the component is made.
  void start_on_arrival(Task& task) { tasks_.push_back(&task); }

  /// [any thread] Messages that wait for the handler.
  std::size_t depth() const;

  /// [strand] Handles at most `limit` parcels.
  void drain(std::size_t limit);

  bool has_handler() const { return static_cast<bool>(handler_); }
  /// Whether each message reaches a handler: a push that waits for room waits for such as this.
  bool receives_each() const { return has_handler() && delivery_ == Delivery::Each; }
  /// What a message of so many bytes takes of the room.
  static constexpr std::size_t cost_of(std::size_t bytes) { return bytes + kMessageOverhead; }
  using OnRoom = std::function<void(std::size_t room)>;
  /// [any thread] The room that there is, if `cost` fits and it is worth while: half of all, or whatever is asked for
  /// where nothing waits. Else `then` is called [any thread, holding nothing] when there is, as long as `who` lives.
  std::optional<std::size_t> room(std::size_t cost, std::weak_ptr<const void> who, OnRoom then);

  /// [any thread] Whether it was true longer ago than the port's `max_age`.
  bool is_too_old(const Envelope& envelope) const;

 private:
  friend class Strand;
  /// What a message costs in memory beside its serialised size: object, queue entry, shared count.
  static constexpr std::size_t kMessageOverhead = 256;
  struct Waiter {
    std::weak_ptr<const void> who;
    std::function<void(const Envelope&)> then;
  };
  struct RoomWish {
    std::size_t cost;
    std::weak_ptr<const void> who;
    OnRoom then;
  };
  std::optional<std::size_t> room_for(std::size_t cost) const;
  void tell_room();
  Outcome enqueue(Parcel&& parcel);
  void push_newest(std::unique_lock<std::mutex>& lock, Parcel parcel);
  void wake(std::unique_lock<std::mutex>& lock);
  void notify_waiters(const Envelope& envelope);
  void note_arrival();
  void post_locked(Job job);
  void begin_tasks(TimePoint since);
  bool make_room(std::size_t bytes);
  bool refill();
  void go_on_later();
  void handle();
  void drop_not_active(const Parcel& parcel);
  void begin_parcel();
  void finish_parcel();

  Port& port_;
  Strand& strand_;
  const Delivery delivery_;
  const Handler handler_;
  const std::uint32_t mark_;  ///< of its work
  const Duration max_age_;
  std::vector<Task*> tasks_;  ///< that start on an arrival
  std::function<void(const Parcel&)> on_not_active_;

  // guarded by the strand's mutex
  ParcelQueue queue_;
  std::optional<Newest> slot_;
  bool slot_read_ = true;
  bool ready_ = false;
  std::vector<Waiter> waiters_;
  std::vector<RoomWish> room_wishes_;

  std::atomic<bool> room_wished_{false};  ///< written under the mutex
  std::atomic<std::size_t> bytes_{0};     ///< of queue_ and batch_
  std::atomic<std::size_t> batched_{0};   ///< the size of batch_, for others than the strand

  // strand only
  ParcelQueue::Block batch_;
  std::optional<Parcel> current_;       ///< what the handler, perhaps a coroutine, refers to
  std::shared_ptr<ActivityHold> hold_;  ///< of a coroutine
};

}  // namespace fiona
