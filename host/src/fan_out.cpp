#include "fan_out.hpp"

#include <algorithm>

namespace fiona::host {

void FanOut::join(std::uint64_t wire, std::uint64_t sequence, std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  members_[wire] = Member{sequence, std::max(1U, prescale), 0};
}

void FanOut::leave(std::uint64_t wire) {
  {
    const std::lock_guard lock(mutex_);
    members_.erase(wire);
  }
  provider_.detach_unused(*this);
}

std::size_t FanOut::subscribers() const {
  const std::lock_guard lock(mutex_);
  return members_.size();
}

Outcome FanOut::deliver_to(std::uint64_t wire, const Parcel& parcel) {
  const std::lock_guard lock(mutex_);
  const auto member = members_.find(wire);
  if (member == members_.end()) return Outcome::Disconnected;
  if (!member->second.takes_next()) return Outcome::Ok;
  takers_.assign(1, wire);
  return send(parcel, takers_);
}

Outcome FanOut::deliver(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  takers_.clear();
  for (auto& [wire, member] : members_) {
    if (parcel.envelope.sequence > member.after && member.takes_next()) takers_.push_back(wire);
  }
  return takers_.empty() ? Outcome::Ok : send(parcel, takers_);
}

/// Called with the mutex held, so that the order stays.
Outcome FanOut::send(const Parcel& parcel, std::vector<std::uint64_t>& wires) {
  frame_.set_wire(wires.front());
  frame_.clear_also();
  frame_.clear_size();
  LinkSocket::Wires also;
  if (wires.size() > 1) {
    frame_.mutable_also()->Add(wires.begin() + 1, wires.end());
    also = std::make_shared<const std::vector<std::uint64_t>>(wires.begin() + 1, wires.end());
  }
  frame_.mutable_object()->set_sequence(parcel.envelope.sequence);
  frame_.mutable_object()->set_origin_ns(parcel.envelope.origin.time_since_epoch().count());
  const auto sent = link_->send(lane_, frame_, parcel.envelope.object, LinkSocket::Rule::DropOldest, std::move(also));
  auto& counters = provider_.counters();
  if (sent.lost > 0) counters.dropped.fetch_add(sent.lost, std::memory_order_relaxed);
  if (sent.what == LinkSocket::Sent::What::Ok) return Outcome::Ok;
  counters.refused.fetch_add(1, std::memory_order_relaxed);
  return Outcome::Rejected;
}

void FanOut::lease(bool held, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (members_.empty()) return;
  wire::Frame frame;
  for (const auto& [wire, member] : members_) {
    frame.wire() == 0 ? frame.set_wire(wire) : frame.add_also(wire);
  }
  frame.mutable_lease()->set_held(held);
  frame.mutable_lease()->set_reason(reason);
  link_->send(lane_, frame);
}

}  // namespace fiona::host
