#include "fiona/push.hpp"

#include <algorithm>

#include "fiona/hull.hpp"

namespace fiona::detail {

std::uint64_t PushProvider::attach(std::shared_ptr<Sink> sink) {
  Sink& newcomer = *sink;
  return attach(std::move(sink), newcomer);
}

std::uint64_t PushProvider::attach(std::shared_ptr<Sink> carrier, Sink& newcomer) {
  const std::lock_guard lock(mutex_);
  if (std::find(sinks_->begin(), sinks_->end(), carrier) == sinks_->end()) {
    auto sinks = std::make_shared<Sinks>(*sinks_);
    sinks->push_back(std::move(carrier));
    sinks_ = std::move(sinks);
  }
  newcomer.attached(sequence_, cycle_);
  if (silence_) {
    newcomer.lease(false, *silence_);  // and no old value as if it were fresh
  } else if (last_ && service().contract().last_value()) {
    newcomer.deliver(Parcel{*last_, nullptr});
  }
  return sequence_;
}

void PushProvider::detach_unused(const Sink& carrier) {
  room_may_have_changed();
  const std::lock_guard lock(mutex_);
  if (carrier.subscribers() > 0) return;
  auto sinks = std::make_shared<Sinks>(*sinks_);
  std::erase_if(*sinks, [&carrier](const auto& other) { return other.get() == &carrier; });
  sinks_ = std::move(sinks);
}

void PushProvider::detach(const Sink& sink) {
  {
    const std::lock_guard lock(mutex_);
    auto sinks = std::make_shared<Sinks>(*sinks_);
    std::erase_if(*sinks, [&sink](const auto& other) { return other.get() == &sink; });
    sinks_ = std::move(sinks);
  }
  room_may_have_changed();
}

bool PushProvider::is_silent() const {
  const std::lock_guard lock(mutex_);
  return silence_.has_value();
}

std::size_t PushProvider::subscribers() const {
  const std::lock_guard lock(mutex_);
  std::size_t count = 0;
  for (const auto& sink : *sinks_) count += sink->subscribers();
  return count;
}

Duration PushProvider::lease_for(const ServiceInfo& service, Duration cycle) {
  if (service.contract().lease_ms() > 0) return service.lease();
  return std::max(service.lease(), 3 * cycle);  // which may be longer than the contract's period
}

void PushProvider::on_active() {
  const std::lock_guard lock(mutex_);
  renewed_ = hull().clock().now();
  started_ ? watch_lease() : tell_lease("has stopped");
}

void PushProvider::on_inactive() {
  const bool has_failed = hull().has_failed();  // then it is lost, whatever its service promises
  if (lease_ == Duration::zero() && !has_failed) return;
  const std::lock_guard lock(mutex_);
  hull().clock().cancel(lease_timer_);
  tell_lease(has_failed ? "has failed" : "is not active");
}

void PushProvider::set_started(bool started) {
  const std::lock_guard lock(mutex_);
  if (std::exchange(started_, started) == started || !is_active()) return;
  hull().clock().cancel(lease_timer_);
  if (!started) return tell_lease("has stopped");
  renewed_ = hull().clock().now();
  tell_lease(std::nullopt);
  watch_lease();
}

/// Not on the provider's strand, which may hang in a handler: then above all its clients must be told. In virtual time
/// it is, so that a put of the same instant comes before or after it in the same order each time; a strand that hangs
/// stops that time anyway.
void PushProvider::watch_lease() {
  if (lease_ == Duration::zero()) return;
  Clock& clock = hull().clock();
  clock.cancel(lease_timer_);
  const auto& strand = clock.staging() ? hull().shared_strand() : hull().side_strand();
  lease_timer_ = clock.schedule(renewed_ + lease_, strand, [watch = watch_] {
    const std::lock_guard lock(watch->mutex);
    if (watch->port) watch->port->check_lease();
  });
}

void PushProvider::check_lease() {
  const std::lock_guard lock(mutex_);
  if (!is_active() || silence_) return;
  if (hull().clock().now() < renewed_ + lease_) return watch_lease();
  tell_lease("has been silent for " +
             std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(lease_).count()) + " ms");
}

void PushProvider::end_watch() {
  const std::lock_guard lock(watch_->mutex);
  watch_->port = nullptr;
}

/// Who came while it was silent, or emptied its slot for that, has not got what is still valid.
void PushProvider::confirm() {
  const std::lock_guard lock(mutex_);
  if (!renew() || !last_ || !service().contract().last_value()) return;
  for (const auto& sink : *sinks_) sink->repeat({*last_, nullptr});
}

/// Whether it had been silent. Called with the mutex held.
bool PushProvider::renew() {
  if (lease_ == Duration::zero() || !is_active() || !started_) return false;
  renewed_ = hull().clock().now();
  if (!silence_) return false;
  tell_lease(std::nullopt);
  watch_lease();
  return true;
}

void PushProvider::tell_lease(std::optional<std::string> silence) {
  if (silence_ == silence) return;
  silence_ = std::move(silence);
  for (const auto& sink : *sinks_) sink->lease(!silence_, silence_.value_or(""));
}

void PushProvider::close() {
  waiting_.clear();
  end_watch();
  const std::lock_guard lock(mutex_);
  sinks_ = std::make_shared<Sinks>();
  last_.reset();
}

Outcome PushProvider::put_object(std::shared_ptr<const Object> object, TimePoint origin) {
  return refuses(*object) ? Outcome::Rejected : put_checked(std::move(object), origin);
}

bool PushProvider::refuses(const Object& object) {
  const auto violation = rules_.first_violation(object);
  if (!violation) return false;
  const TimePoint now = hull().clock().now();
  counters().refuse(*violation, now);
  if (told_ && (told_->reason == *violation || now < told_->at + kTellAgain)) return true;
  told_ = {*violation, now};
  hull().events().logged(hull().name(), LogLevel::Warning, full_name() + " refused a put: " + *violation);
  return true;
}

Outcome PushProvider::put_checked(std::shared_ptr<const Object> object, TimePoint origin) {
  if (!started_ || hull().has_failed()) return Outcome::NotActive;
  Envelope envelope{std::move(object), 0, origin, 0};
  envelope.bytes = envelope.object->ByteSizeLong();
  std::shared_ptr<const Sinks> sinks;
  {
    // The subscriber list, the sequence and the lease change together, so that "from sequence n" is exact, and who
    // comes to one that was silent gets this or what is last.
    const std::lock_guard lock(mutex_);
    renew();
    envelope.sequence = ++sequence_;
    sinks = sinks_;
    if (service().contract().last_value()) last_ = envelope;
  }
  counters().count(origin);
  for (const auto& sink : *sinks) {
    sink->deliver({&sink == &sinks->back() ? std::move(envelope) : envelope, nullptr});
  }
  return Outcome::Ok;
}

// ---- waiting for room -----------------------------------------------------------------------------------------

bool PushProvider::has_room(std::size_t bytes) {
  std::shared_ptr<const Sinks> sinks;
  {
    const std::lock_guard lock(mutex_);
    sinks = sinks_;
  }
  const auto notice = [this, strand = hull().shared_strand()] { strand->post([this] { put_waiting(); }); };
  bool room = true;
  for (const auto& sink : *sinks) room = sink->has_room(bytes, notice) && room;  // all are asked at once
  return room;
}

/// [any thread]
void PushProvider::room_may_have_changed() {
  if (paced_) hull().strand().post([this] { put_waiting(); });
}

/// Puts what waits, in its order, as far as there is room.
void PushProvider::put_waiting() {
  while (!waiting_.empty() && !obstacle() && has_room(waiting_.front()->bytes)) {
    const auto call = std::move(waiting_.front());
    waiting_.pop_front();
    calls().finish(call, put_checked(std::move(call->object), call->origin));
  }
}

Async<Outcome> PushProvider::put_with_room(std::shared_ptr<const Object> object, TimePoint origin, Duration within) {
  paced_ = true;
  const auto call = std::make_shared<PutCall>();
  call->bytes = object->ByteSizeLong();
  if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal);
  } else if (refuses(*object) || waiting_.size() >= kMaxWaiting) {
    calls().finish(call, Outcome::Rejected);
  } else if (waiting_.empty() && has_room(call->bytes)) {
    calls().finish(call, put_checked(std::move(object), origin));
  } else {
    call->object = std::move(object);
    call->origin = origin;
    waiting_.push_back(call);
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  if (std::erase(waiting_, call) > 0) put_waiting();  // a smaller one behind it may fit
  co_return outcome;
}

PushClient::PushClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
                       Inbox::Handler handler)
    : RequiredPort(owner, name, service, options),
      inbox_(*this, options.delivery, std::move(handler), options.max_age) {}

/// At once: on the strand it would come after the first value of the new provider, and take that for an old one.
void PushClient::on_entering(Connection connection) {
  connection == Connection::Connected ? inbox_.mark_stale() : inbox_.empty_slot();
}

void PushClient::on_connection(Connection connection, std::uint64_t change) {
  if (connection == Connection::Unwired || connection == Connection::Lost)
    calls().finish_all(Outcome::Disconnected, connection_reason(), change);
}

/// As to one that subscribes now: a service that speaks only on change may have spoken meanwhile, and not again.
void PushClient::on_active() { repeat_last(); }

Async<Result<Envelope>> PushClient::next(Duration within) {
  const auto call = std::make_shared<NextCall>();
  call->since = changes();
  if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal, reason_for(*refusal));
  } else {
    // The call is kept by who waits, and by nobody else: one that has ended leaves nothing behind.
    inbox_.on_next(call, [this, waiting = std::weak_ptr(call)](const Envelope& envelope) {
      const auto next = waiting.lock();
      next->envelope = envelope;
      calls().finish(next, Outcome::Ok);
    });
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  if (outcome != Outcome::Ok) {
    inbox_.forget_next(call);  // which the strand may keep for a while yet
    co_return Result<Envelope>(outcome, call->reason);
  }
  co_return std::move(*call->envelope);
}

}  // namespace fiona::detail
