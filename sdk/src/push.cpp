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
  newcomer.attached(sequence_);
  if (silence_) {
    newcomer.lease(false, *silence_);  // and no old value as if it were fresh
  } else if (last_ && service().contract().last_value()) {
    newcomer.deliver(Parcel{*last_, nullptr});
  }
  return sequence_;
}

void PushProvider::detach_unused(const Sink& carrier) {
  const std::lock_guard lock(mutex_);
  if (carrier.subscribers() > 0) return;
  auto sinks = std::make_shared<Sinks>(*sinks_);
  std::erase_if(*sinks, [&carrier](const auto& other) { return other.get() == &carrier; });
  sinks_ = std::move(sinks);
}

void PushProvider::detach(const Sink& sink) {
  const std::lock_guard lock(mutex_);
  auto sinks = std::make_shared<Sinks>(*sinks_);
  std::erase_if(*sinks, [&sink](const auto& other) { return other.get() == &sink; });
  sinks_ = std::move(sinks);
}

std::size_t PushProvider::subscribers() const {
  const std::lock_guard lock(mutex_);
  std::size_t count = 0;
  for (const auto& sink : *sinks_) count += sink->subscribers();
  return count;
}

void PushProvider::on_active() {
  if (lease_ == Duration::zero()) return;
  renewed_ = hull().clock().now();
  watch_lease();
}

void PushProvider::on_inactive() {
  if (lease_ == Duration::zero()) return;
  hull().clock().cancel(lease_timer_);
  tell_lease("is not active");
}

void PushProvider::watch_lease() {
  hull().clock().cancel(lease_timer_);
  lease_timer_ = hull().clock().schedule(renewed_ + lease_, hull().shared_strand(), [this] {
    if (!is_active()) return;
    if (hull().clock().now() < renewed_ + lease_) return watch_lease();
    tell_lease("has been silent for " + std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(lease_).count()) + " ms");
  });
}

void PushProvider::renew() {
  if (lease_ == Duration::zero() || !is_active()) return;
  renewed_ = hull().clock().now();
  {
    const std::lock_guard lock(mutex_);
    if (!silence_) return;
  }
  tell_lease(std::nullopt);
  watch_lease();
}

void PushProvider::tell_lease(std::optional<std::string> silence) {
  const std::lock_guard lock(mutex_);
  if (silence_ == silence) return;
  silence_ = std::move(silence);
  for (const auto& sink : *sinks_) sink->lease(!silence_, silence_.value_or(""));
}

void PushProvider::close() {
  const std::lock_guard lock(mutex_);
  sinks_ = std::make_shared<Sinks>();
  last_.reset();
}

Outcome PushProvider::put_object(std::shared_ptr<const Object> object, TimePoint origin) {
  if (const auto violation = rules_.first_violation(*object)) {
    const auto refused = counters().refused.fetch_add(1, std::memory_order_relaxed);
    if (refused == 0) hull().events().logged(hull().name(), LogLevel::Warning, full_name() + " refused a put: " + *violation);
    return Outcome::Rejected;
  }
  Envelope envelope{std::move(object), 0, origin, 0};
  envelope.bytes = envelope.object->ByteSizeLong();
  std::shared_ptr<const Sinks> sinks;
  {
    // The subscriber list and the sequence change together, so that "from sequence n" is exact.
    const std::lock_guard lock(mutex_);
    envelope.sequence = ++sequence_;
    sinks = sinks_;
    if (service().contract().last_value()) last_ = envelope;
  }
  counters().count(origin);
  renew();
  for (const auto& sink : *sinks) sink->deliver(Parcel{envelope, nullptr});
  return Outcome::Ok;
}

PushClient::PushClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
                       Inbox::Handler handler)
    : RequiredPort(owner, name, service, options), inbox_(*this, options.delivery, std::move(handler)) {}

/// At once: on the strand it would come after the first value of the new provider, and take that for an old one.
void PushClient::on_entering(Connection connection) {
  connection == Connection::Connected ? inbox_.mark_stale() : inbox_.empty_slot();
}

void PushClient::on_connection(Connection connection) {
  if (connection == Connection::Unwired || connection == Connection::Lost) calls().finish_all(Outcome::Disconnected, connection_reason());
}

Async<Result<Envelope>> PushClient::next(Duration within) {
  const auto call = std::make_shared<NextCall>();
  if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal, connection_reason());
  } else {
    inbox_.on_next([this, call](const Envelope& envelope) {
      call->envelope = envelope;
      calls().finish(call, Outcome::Ok);
    });
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  if (outcome != Outcome::Ok) co_return Result<Envelope>(outcome, call->reason);
  co_return std::move(*call->envelope);
}

}  // namespace fiona::detail
