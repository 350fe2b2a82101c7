#include "fiona/send.hpp"

#include "fiona/hull.hpp"

namespace fiona::detail {

void SendClient::set_target(std::shared_ptr<Sink> target) {
  const std::lock_guard lock(target_mutex_);
  target_ = std::move(target);
}

Outcome SendClient::send_object(std::shared_ptr<const Object> object) {
  if (rules_.first_violation(*object)) {
    counters().refused.fetch_add(1, std::memory_order_relaxed);
    return Outcome::Rejected;
  }
  std::shared_ptr<Sink> target;
  {
    const std::lock_guard lock(target_mutex_);
    target = target_;
  }
  if (!target) return connection() == Connection::Unwired ? Outcome::Unwired : Outcome::Disconnected;
  Envelope envelope{std::move(object), ++sequence_, hull().clock().now(), 0};
  envelope.bytes = envelope.object->ByteSizeLong();
  counters().count(envelope.origin);
  const Outcome outcome = target->deliver(Parcel{std::move(envelope), nullptr});
  if (outcome != Outcome::Ok) counters().dropped.fetch_add(1, std::memory_order_relaxed);
  return outcome;
}

}  // namespace fiona::detail
