#include "fiona/inbox.hpp"

#include <algorithm>
#include <bit>
#include <chrono>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"
#include "fiona/port.hpp"

namespace fiona {
namespace {

/// How long an inbox is served before the strand looks at what else waits. Not on a virtual clock, where the order of
/// things must not depend on how fast the machine is.
constexpr std::chrono::milliseconds kTurn{2};
/// The clock is looked at after so many messages; of the first ones after one, and after twice as many each time.
constexpr std::size_t kLook = 8;

using Who = std::weak_ptr<const void>;
/// Whether both are of one object, though it may have gone.
bool is_same(const Who& one, const Who& other) { return !one.owner_before(other) && !other.owner_before(one); }

std::size_t cost(const Parcel& parcel) { return Inbox::cost_of(parcel.envelope.bytes); }

}  // namespace

Inbox::Inbox(Port& port, Delivery delivery, Handler handler, Duration max_age)
    : port_(port),
      strand_(port.hull().strand()),
      delivery_(delivery),
      handler_(std::move(handler)),
      mark_(Liveness::mark(port.name())),
      max_age_(max_age) {}

Inbox::~Inbox() = default;

bool Inbox::is_too_old(const Envelope& envelope) const {
  return max_age_ > Duration::zero() && owner_now(port_) - envelope.origin > max_age_;
}

Outcome Inbox::push(Parcel parcel) {
  // An acknowledged send: the wire passes on what is returned here, and nothing is left to answer later.
  if (port_.service().pattern() == SEND && std::exchange(parcel.reply, nullptr) && !port_.is_active()) {
    return port_.hull().has_failed() ? Outcome::Disconnected : Outcome::NotActive;
  }
  if (is_too_old(parcel.envelope)) {
    port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
    return Outcome::Ok;
  }
  std::unique_lock lock(strand_.mutex_);
  if (strand_.closed_) return Outcome::Disconnected;
  if (delivery_ == Delivery::Newest) {
    push_newest(lock, std::move(parcel));
    return Outcome::Ok;
  }
  const Outcome outcome = enqueue(std::move(parcel));
  if (outcome == Outcome::Ok) wake(lock);
  return outcome;
}

void Inbox::push_all(std::vector<Parcel>& parcels) {
  if (delivery_ == Delivery::Newest) {
    for (Parcel& parcel : parcels) push(std::move(parcel));
    return parcels.clear();
  }
  const auto old = std::erase_if(parcels, [this](const Parcel& parcel) { return is_too_old(parcel.envelope); });
  port_.counters().dropped.fetch_add(old, std::memory_order_relaxed);
  if (parcels.empty()) return;
  {
    std::unique_lock lock(strand_.mutex_);
    if (strand_.closed_) return parcels.clear();
    for (Parcel& parcel : parcels) enqueue(std::move(parcel));
    wake(lock);
  }
  parcels.clear();
}

/// Called with the strand's mutex held.
Outcome Inbox::enqueue(Parcel&& parcel) {
  const std::size_t bytes = cost(parcel);
  if (!make_room(bytes)) return Outcome::Rejected;
  bytes_.fetch_add(bytes, std::memory_order_relaxed);
  notify_waiters(parcel.envelope);
  queue_.push(std::move(parcel));
  return Outcome::Ok;
}

void Inbox::push_newest(std::unique_lock<std::mutex>& lock, Parcel parcel) {
  if (!handler_) {
    if (!port_.is_active()) {
      port_.counters().not_active.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    PortCounters& counters = port_.counters();
    counters.count_arrival(parcel.envelope.origin, port_.hull().clock());
    if (slot_ && !slot_read_) counters.supersede_arrived();
    slot_read_ = std::any_of(waiters_.begin(), waiters_.end(), [](const Waiter& one) { return !one.who.expired(); });
    notify_waiters(parcel.envelope);
    slot_ = Newest{std::move(parcel.envelope), false};
    return note_arrival();
  }
  queue_.for_each([this](const Parcel& old) {
    bytes_.fetch_sub(cost(old), std::memory_order_relaxed);
    port_.counters().superseded.fetch_add(1, std::memory_order_relaxed);
  });
  queue_.clear();
  bytes_.fetch_add(cost(parcel), std::memory_order_relaxed);
  notify_waiters(parcel.envelope);
  queue_.push(std::move(parcel));
  wake(lock);
}

/// A full push queue loses its oldest entries, counted; a full queue of requests takes no more.
bool Inbox::make_room(std::size_t bytes) {
  const auto full = [&] {
    const std::size_t waiting = bytes_.load(std::memory_order_relaxed);
    return waiting > 0 && waiting + bytes > kMaxBytes;
  };
  if (!port_.service().is_push()) return !full();
  while (full() && !queue_.empty()) {
    bytes_.fetch_sub(cost(queue_.pop()), std::memory_order_relaxed);
    port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
  }
  return true;
}

void Inbox::wake(std::unique_lock<std::mutex>& lock) {
  if (!ready_) {
    ready_ = true;
    strand_.ready_.push_back(this);
  }
  strand_.wake(lock);
}

/// Called with the strand's mutex held: the waiters run as jobs of the strand.
void Inbox::notify_waiters(const Envelope& envelope) {
  if (waiters_.empty()) return;
  for (auto& waiter : std::exchange(waiters_, {})) {
    post_locked([waiter = std::move(waiter), envelope] {
      if (const auto who = waiter.who.lock()) waiter.then(envelope);
    });
  }
}

/// Called with the strand's mutex held.
void Inbox::post_locked(Job job) {
  strand_.jobs_.push_back(std::move(job));
  if (strand_.scheduled_) return;
  strand_.scheduled_ = true;
  if (strand_.clock_.strand_busy(strand_)) strand_.start();
}

/// Of a slot: nothing runs for it on the strand yet. Called with the strand's mutex held.
void Inbox::note_arrival() {
  for (Task* task : tasks_) {
    if (!task->takes_arrival() || !task->note()) continue;
    post_locked([task, since = strand_.clock_.now()] { task->begin_noted(since); });
  }
}

/// Of a message that has been handled.
void Inbox::begin_tasks(TimePoint since) {
  for (Task* task : tasks_) {
    if (task->takes_arrival()) task->begin(since);
  }
}

std::optional<Inbox::Newest> Inbox::newest() {
  const std::lock_guard lock(strand_.mutex_);
  slot_read_ = true;
  return slot_ && is_too_old(slot_->envelope) ? std::nullopt : slot_;
}

void Inbox::on_next(std::weak_ptr<const void> who, std::function<void(const Envelope&)> waiter) {
  const std::lock_guard lock(strand_.mutex_);
  std::erase_if(waiters_, [](const Waiter& waiting) { return waiting.who.expired(); });
  waiters_.push_back({std::move(who), std::move(waiter)});
}

void Inbox::forget_next(const std::weak_ptr<const void>& who) {
  const std::lock_guard lock(strand_.mutex_);
  std::erase_if(waiters_, [&who](const Waiter& waiter) { return is_same(waiter.who, who); });
}

void Inbox::mark_stale() {
  const std::lock_guard lock(strand_.mutex_);
  if (slot_) slot_->stale = true;
}

void Inbox::empty_slot() {
  const std::lock_guard lock(strand_.mutex_);
  slot_.reset();
  slot_read_ = true;
}

void Inbox::leave_mode() {
  ParcelQueue dropped;
  {
    const std::lock_guard lock(strand_.mutex_);
    std::swap(dropped, queue_);
    batched_.store(0, std::memory_order_relaxed);
    slot_.reset();
    slot_read_ = true;
  }
  const auto batched = std::exchange(batch_, {});
  const auto drop = [this](const Parcel& parcel) {
    bytes_.fetch_sub(cost(parcel));
    drop_not_active(parcel);
  };
  batched.for_each(drop);
  dropped.for_each(drop);
  tell_room();
}

/// To who is wired to one that has failed it has died.
void Inbox::drop_not_active(const Parcel& parcel) {
  const Hull& hull = port_.hull();
  port_.counters().not_active.fetch_add(1, std::memory_order_relaxed);
  if (parcel.is_request()) {
    hull.has_failed()
        ? parcel.reply->answer(Outcome::Disconnected, "'" + hull.name() + "' has failed: " + hull.reason(), nullptr)
        : parcel.reply->answer(Outcome::NotActive, "mode " + hull.mode(), nullptr);
  }
  if (on_not_active_) on_not_active_(parcel);
}

void Inbox::clear(Outcome outcome) {
  ParcelQueue dropped;
  {
    const std::lock_guard lock(strand_.mutex_);
    std::swap(dropped, queue_);
    slot_.reset();
    slot_read_ = true;
    dropped.for_each([this](const Parcel& parcel) { bytes_.fetch_sub(cost(parcel)); });
  }
  tell_room();
  dropped.for_each([outcome](const Parcel& parcel) {
    if (parcel.is_request()) parcel.reply->answer(outcome, {}, nullptr);
  });
}

bool Inbox::refill() {
  const std::lock_guard lock(strand_.mutex_);
  queue_.take(batch_);
  batched_.store(batch_.size(), std::memory_order_relaxed);
  return !batch_.empty();
}

std::size_t Inbox::depth() const {
  const std::lock_guard lock(strand_.mutex_);
  return queue_.size() + batched_.load(std::memory_order_relaxed);
}

void Inbox::drain(std::size_t limit) {
  const bool timed = !strand_.clock_.staging();
  std::optional<std::chrono::steady_clock::time_point> begun;  // none: of one that waits alone
  for (std::size_t handled = 0; !current_; ++handled) {
    const bool looks = begun && (handled % kLook == 0 || std::has_single_bit(handled));
    const bool long_enough = looks && std::chrono::steady_clock::now() - *begun > kTurn;
    if (handled == limit || long_enough) return go_on_later();
    // Not before: what has been taken from the queue is not superseded any more.
    if (batch_.empty() && !refill()) return;
    if (timed && !begun && (handled > 0 || batch_.size() > 1)) begun = std::chrono::steady_clock::now();
    begin_parcel();
    handle();
    if (strand_.closed_) return;
  }
}

void Inbox::go_on_later() {
  std::unique_lock lock(strand_.mutex_);
  if (!queue_.empty() || !batch_.empty()) wake(lock);
}

/// Ends the current parcel, or leaves it to the coroutine that the handler returned.
void Inbox::handle() {
  Hull& hull = port_.hull();
  if (current_->reply && current_->reply->abandoned()) return finish_parcel();
  if (!port_.is_active() || (port_.begins_work() && hull.is_leaving(port_.activity()))) {
    drop_not_active(*current_);
    return finish_parcel();
  }
  if (is_too_old(current_->envelope)) {
    port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
    return finish_parcel();
  }
  port_.counters().count_arrival(current_->envelope.origin, hull.clock());
  const TimePoint since = tasks_.empty() ? TimePoint() : hull.clock().now();
  std::optional<Async<>> coroutine;
  strand_.begins(mark_);
  hull.guarded([&] { coroutine = handler_(*current_); });
  if (!coroutine) {
    finish_parcel();
    return begin_tasks(since);
  }
  if (auto hold = hull.acquire(port_.activity(), "the handler of '" + port_.name() + "'")) {
    hold_ = std::make_shared<ActivityHold>(std::move(*hold));
  }
  hull.spawn(std::move(*coroutine), [this, since] {
    finish_parcel();
    begin_tasks(since);
    drain(ParcelQueue::kBlock);
  });
}

/// What is in the handler's hands waits no longer: its place is free.
void Inbox::begin_parcel() {
  current_ = batch_.pop();
  batched_.store(batch_.size(), std::memory_order_relaxed);
  bytes_.fetch_sub(cost(*current_));
  tell_room();
}

void Inbox::finish_parcel() {
  current_.reset();
  hold_.reset();
}

/// Half of all, so that who waits comes back for many messages and not for each.
std::optional<std::size_t> Inbox::room_for(std::size_t cost) const {
  const std::size_t waiting = bytes_.load();
  if (waiting > 0 && waiting + std::max(cost, kMaxBytes / 2) > kMaxBytes) return std::nullopt;
  return waiting == 0 ? std::max(cost, kMaxBytes) : kMaxBytes - waiting;
}

/// The wish is there before the room is looked at, as the room is made before the wishes are: one sees the other.
std::optional<std::size_t> Inbox::room(std::size_t cost, std::weak_ptr<const void> who, OnRoom then) {
  const std::lock_guard lock(strand_.mutex_);
  // One each: who asks again before he has his answer, as only a peer that keeps to nothing does, gets the last one.
  std::erase_if(room_wishes_, [&](const RoomWish& wish) { return wish.who.expired() || is_same(wish.who, who); });
  room_wished_ = true;
  const auto room = room_for(cost);
  if (!room) room_wishes_.push_back({cost, std::move(who), std::move(then)});
  room_wished_ = !room_wishes_.empty();
  return room;
}

/// Who has wished is told the room that his wish was taken from the list for, though others may have used it since: he
/// takes what he sent himself off it, and asks again.
void Inbox::tell_room() {
  if (!room_wished_) return;
  std::vector<std::pair<RoomWish, std::size_t>> fulfilled;
  {
    const std::lock_guard lock(strand_.mutex_);
    std::erase_if(room_wishes_, [&](RoomWish& wish) {
      const auto room = room_for(wish.cost);
      if (room) fulfilled.emplace_back(std::move(wish), *room);
      return room.has_value();
    });
    room_wished_ = !room_wishes_.empty();
  }
  for (const auto& [wish, room] : fulfilled) wish.then(room);
}

}  // namespace fiona
