#include "fiona/local_wire.hpp"

#include <algorithm>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"
#include "fiona/port.hpp"

namespace fiona {

LocalWire::LocalWire(std::string name, Inbox& inbox)
    : name_(std::move(name)), prescale_(1), inbox_(&inbox), clock_(inbox.port().hull().clock()) {}

LocalWire::LocalWire(std::string name, std::shared_ptr<WireEnd> end, std::uint32_t prescale)
    : name_(std::move(name)),
      end_(std::move(end)),
      prescale_(std::max(1U, prescale)),
      inbox_(end_->port().inbox()),
      clock_(end_->port().hull().clock()),
      room_name_(name_ + "/room") {}

void LocalWire::set_prescale(std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  prescale_ = std::max(1U, prescale);
  puts_ = 0;
}

Outcome LocalWire::deliver(Parcel parcel) {
  std::unique_lock lock(mutex_);
  if (!inbox_) return Outcome::Disconnected;
  if (puts_++ % prescale_ != 0) return Outcome::Ok;
  return pass(lock, std::move(parcel));
}

void LocalWire::repeat(Parcel parcel) {
  std::unique_lock lock(mutex_);
  if (inbox_) static_cast<void>(pass(lock, std::move(parcel)));
}

/// Called with the mutex held.
Outcome LocalWire::pass(std::unique_lock<std::mutex>& lock, Parcel parcel) {
  room_.sent(Inbox::cost_of(parcel.envelope.bytes));
  if (parcel.is_request() && inbox_->port().service().pattern() == QUERY) keep_open(parcel.reply);
  if (!clock_.staging()) return hand_over(std::move(parcel));
  if (parcel.is_request()) give_up_in_turn(parcel.reply);
  const Object* object = parcel.envelope.object.get();
  stage(lock, object, {}, [self = shared_from_this(), parcel = std::move(parcel)]() mutable {
    const std::lock_guard inner(self->mutex_);
    const auto reply = parcel.reply;
    const Outcome outcome = self->hand_over(std::move(parcel));
    if (reply && outcome != Outcome::Ok)
      reply->answer(outcome, outcome == Outcome::Rejected ? Inbox::kFull : "", nullptr);
    if (!reply && outcome == Outcome::Rejected)
      self->inbox_->port().counters().refuse(Inbox::kFull, self->clock_.now());
  });
  return Outcome::Ok;
}

/// Lets go of the lock first: the clock may deliver at once.
void LocalWire::stage(std::unique_lock<std::mutex>& lock, const Object* object, std::string_view word, Job deliver) {
  const std::uint64_t sequence = ++staged_;
  lock.unlock();
  clock_.stage({name_, sequence, object, word, std::move(deliver)});
}

/// That the client has given up reaches the provider as a message does: behind what it sent before, and in its turn.
void LocalWire::give_up_in_turn(const std::shared_ptr<ReplySink>& reply) {
  reply->set_on_abandon(
      [self = shared_from_this(), weak = std::weak_ptr(reply)] {
        std::unique_lock lock(self->mutex_);
        self->stage(lock, nullptr, kGivenUp, [self, reply = weak.lock()] { reply->note_abandoned(); });
      },
      true);
}

/// Called with the mutex held, so that after `cut` nothing is under way.
Outcome LocalWire::hand_over(Parcel parcel) {
  if (!inbox_) return Outcome::Disconnected;
  if (end_) return end_->push(std::move(parcel));
  const auto receipt = inbox_->port().service().pattern() == SEND ? parcel.reply : nullptr;
  const Outcome outcome = inbox_->push(std::move(parcel));
  if (receipt) receipt->answer(outcome, outcome == Outcome::Rejected ? Inbox::kFull : "", nullptr);
  return outcome;
}

void LocalWire::lease(bool held, const std::string& reason) {
  const auto tell = [self = shared_from_this(), held, reason] {
    const std::lock_guard lock(self->mutex_);
    if (self->inbox_ && self->end_) self->end_->set_lease(held, reason);
  };
  if (!clock_.staging()) return tell();
  std::unique_lock lock(mutex_);
  stage(lock, nullptr, held ? kSpeaks : kSilent, tell);
}

bool LocalWire::has_room(std::size_t bytes, const std::function<void()>& notice) {
  std::unique_lock lock(mutex_);
  const std::size_t cost = Inbox::cost_of(bytes);
  const bool takes_it = inbox_ && inbox_->receives_each() && puts_ % prescale_ == 0;
  if (!takes_it || room_.holds(cost)) return true;
  notice_ = notice;
  if (!room_.ask()) return false;
  if (clock_.staging()) {
    stage(lock, nullptr, kAsksRoom, [self = shared_from_this(), cost] {
      const std::lock_guard inner(self->mutex_);
      if (const auto room = self->room_at_end(cost)) self->tell_room(*room);
    });
    return false;
  }
  if (const auto room = room_at_end(cost)) room_.told(*room);
  return room_.holds(cost);
}

/// Called with the mutex held.
std::optional<std::size_t> LocalWire::room_at_end(std::size_t cost) {
  if (!inbox_) return std::nullopt;
  return end_->room(cost, weak_from_this(), [weak = weak_from_this()](std::size_t room) {
    if (const auto self = weak.lock()) self->tell_room(room);
  });
}

void LocalWire::tell_room(std::size_t room) {
  if (!clock_.staging()) return has_been_told(room);
  clock_.stage({room_name_, ++rooms_staged_, nullptr, kHasRoom,
                [self = shared_from_this(), room] { self->has_been_told(room); }});
}

void LocalWire::has_been_told(std::size_t room) {
  std::function<void()> notice;
  {
    const std::lock_guard lock(mutex_);
    room_.told(room);
    notice = std::exchange(notice_, nullptr);
  }
  if (notice) notice();
}

void LocalWire::attached(std::uint64_t, Duration cycle) {
  if (end_) end_->set_cycle(cycle);
}

/// Called with the mutex held. As many as are open, and about as many more that are not any longer.
void LocalWire::keep_open(const std::shared_ptr<ReplySink>& request) {
  if (open_.size() >= most_open_) {
    std::erase_if(open_, [](const auto& one) { return one.expired(); });
    most_open_ = std::max(kLeastOpen, 2 * open_.size());
  }
  open_.push_back(request);
}

bool LocalWire::has_open() {
  const std::lock_guard lock(mutex_);
  return std::any_of(open_.begin(), open_.end(), [](const auto& one) { return !one.expired(); });
}

void LocalWire::cut(const std::string& reason) {
  cut_if([](const Inbox&) { return true; }, reason);
}

void LocalWire::cut_from(const Hull& hull, const std::string& reason) {
  cut_if([&hull](const Inbox& inbox) { return &inbox.port().hull() == &hull; }, reason);
}

/// Nobody else ends its open requests where the client's port has another provider by then. Who may still answer them
/// is told that nobody waits.
void LocalWire::cut_if(const std::function<bool(const Inbox&)>& is_meant, const std::string& reason) {
  std::vector<std::weak_ptr<ReplySink>> open;
  {
    const std::lock_guard lock(mutex_);
    if (!inbox_ || !is_meant(*inbox_)) return;
    inbox_ = nullptr;
    open.swap(open_);
  }
  for (const auto& one : open) {
    const auto request = one.lock();
    if (!request) continue;
    request->answer(Outcome::Disconnected, reason, nullptr);
    request->abandon();
  }
}

}  // namespace fiona
