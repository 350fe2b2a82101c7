#include "fiona/wire_end.hpp"

#include <utility>

#include "fiona/port.hpp"

namespace fiona {

std::string_view to_string(Connection connection) {
  switch (connection) {
    case Connection::Unwired: return "unwired";
    case Connection::Waiting: return "waiting";
    case Connection::Connected: return "connected";
    case Connection::Lost: return "lost";
  }
  return "unknown";
}

Outcome WireEnd::push(Parcel parcel) {
  if (open_.load(std::memory_order_acquire)) return port_.inbox()->push(std::move(parcel));
  const std::lock_guard lock(port_.mutex_);
  return port_.take(*this, std::move(parcel));
}

void WireEnd::push_all(std::vector<Parcel>& parcels) {
  if (open_.load(std::memory_order_acquire)) return port_.inbox()->push_all(parcels);
  const std::lock_guard lock(port_.mutex_);
  for (Parcel& parcel : parcels) port_.take(*this, std::move(parcel));
  parcels.clear();
}

std::optional<std::size_t> WireEnd::room(std::size_t cost, std::weak_ptr<const void> who, Inbox::OnRoom then) {
  if (!open_.load(std::memory_order_acquire)) {
    const std::lock_guard lock(port_.mutex_);
    if (port_.serving_.get() != this) return cost;
  }
  return port_.inbox()->room(cost, std::move(who), std::move(then));
}

void WireEnd::set_target(std::shared_ptr<Sink> target) {
  const std::lock_guard lock(port_.mutex_);
  const bool is_new = target != nullptr;
  target_ = std::move(target);
  const bool mine = is_new ? port_.adopts(*this) : port_.owns(*this);
  if (mine && port_.serving_.get() == this) port_.use_target(target_);
}

void WireEnd::set_connection(Connection connection, std::string reason) {
  const std::lock_guard lock(port_.mutex_);
  const bool comes = connection == Connection::Connected || connection == Connection::Waiting;
  if (comes ? port_.adopts(*this) : port_.owns(*this)) port_.connected(*this, connection, std::move(reason));
}

void WireEnd::set_lease(bool held, const std::string& reason) {
  const std::lock_guard lock(port_.mutex_);
  if (port_.owns(*this)) port_.leased(*this, held, reason);
}

void WireEnd::set_cycle(Duration cycle) {
  const std::lock_guard lock(port_.mutex_);
  cycle_ = cycle;
}

Connection WireEnd::connection() const {
  const std::lock_guard lock(port_.mutex_);
  if (port_.ends_.size() == 1) return port_.connection();
  return silence_ ? Connection::Lost : connection_;
}

std::string WireEnd::unfitness() const {
  if (connection_ != Connection::Connected) return provider_.empty() ? reason_ : provider_ + ": " + reason_;
  return silence_ ? *silence_ : reason_ + " " + std::string(flaw_);
}

}  // namespace fiona
