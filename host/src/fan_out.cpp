#include "fan_out.hpp"

#include <algorithm>

namespace fiona::host {

void FanOut::join(std::uint64_t wire, std::uint64_t sequence, std::uint32_t prescale, bool each) {
  const std::lock_guard lock(mutex_);
  members_[wire] = Member{sequence, std::max(1U, prescale), 0, each, {}};
}

void FanOut::set_prescale(std::uint64_t wire, std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  const auto member = members_.find(wire);
  if (member == members_.end()) return;
  member->second.prescale = std::max(1U, prescale);
  member->second.puts = 0;
}

bool FanOut::take_on() {
  const std::lock_guard lock(mutex_);
  if (closed_ || wires_ > kMostAlso) return false;
  ++wires_;
  return true;
}

std::size_t FanOut::let_go(PeerLanes::Rest rest) {
  {
    const std::lock_guard lock(mutex_);
    closed_ = --wires_ == 0;
    if (!closed_) return 0;
  }
  return link_->close_lane(lane_, rest);
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
  member->second.room.sent(Inbox::cost_of(parcel.envelope.bytes));
  takers_.assign(1, wire);
  return send(parcel, takers_);
}

Outcome FanOut::deliver(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  takers_.clear();
  const bool shared = shares_room();
  for (auto& [wire, member] : members_) {
    const bool takes = parcel.envelope.sequence > member.after && member.takes_next();
    if (takes) takers_.push_back(wire);
    if (takes || shared) member.room.sent(Inbox::cost_of(parcel.envelope.bytes));
  }
  return takers_.empty() ? Outcome::Ok : send(parcel, takers_);
}

void FanOut::repeat(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  takers_.clear();
  for (auto& [wire, member] : members_) {
    takers_.push_back(wire);
    member.room.sent(Inbox::cost_of(parcel.envelope.bytes));
  }
  if (!takers_.empty()) send(parcel, takers_);
}

bool FanOut::has_room(std::size_t bytes, const std::function<void()>& notice) {
  const std::lock_guard lock(mutex_);
  const std::size_t cost = Inbox::cost_of(bytes);
  bool room = true;
  std::vector<std::uint64_t> asked;
  for (auto& [wire, member] : members_) {
    if (!member.each || member.room.holds(cost) || (!member.is_next() && !shares_room())) continue;
    room = false;
    if (member.room.ask()) asked.push_back(wire);
  }
  if (room) return true;
  notice_ = notice;
  if (asked.empty()) return false;
  wire::Frame frame;
  address(frame, asked);
  frame.mutable_room()->set_bytes(cost);
  link_->send(lane_, frame);
  return false;
}

void FanOut::on_room(std::uint64_t wire, std::size_t room) {
  std::function<void()> notice;
  {
    const std::lock_guard lock(mutex_);
    const auto member = members_.find(wire);
    if (member == members_.end() || !member->second.room.told(room)) return;
    notice = notice_;
  }
  if (notice) notice();
}

void FanOut::address(wire::Frame& frame, const std::vector<std::uint64_t>& wires) const {
  frame.set_wire(wires.front());
  frame.mutable_also()->Assign(wires.begin() + 1, wires.end());
}

/// Called with the mutex held, so that the order stays.
Outcome FanOut::send(const Parcel& parcel, std::vector<std::uint64_t>& wires) {
  address(frame_, wires);
  frame_.clear_size();
  LinkSocket::Wires also;
  if (wires.size() > 1) {
    also = std::make_shared<const std::vector<std::uint64_t>>(wires.begin() + 1, wires.end());
  }
  frame_.mutable_object()->set_sequence(parcel.envelope.sequence);
  frame_.mutable_object()->set_origin_ns(parcel.envelope.origin.time_since_epoch().count());
  const auto sent = link_->send(lane_, frame_, parcel.envelope.object, LinkSocket::Rule::DropOldest, std::move(also));
  auto& counters = provider_.counters();
  const std::size_t lost = sent.what == LinkSocket::Sent::What::Gone ? wires.size() : sent.lost;
  if (lost > 0) counters.dropped.fetch_add(lost, std::memory_order_relaxed);
  if (sent.what != LinkSocket::Sent::What::TooLarge) return Outcome::Ok;
  counters.refuse(LinkSocket::kTooLarge, provider_.hull().clock().now());
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
  frame.mutable_lease()->set_reason(told_reason(reason));
  link_->send(lane_, frame);
}

}  // namespace fiona::host
