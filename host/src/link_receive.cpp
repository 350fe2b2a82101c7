#include <algorithm>

#include "link_peer.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

/// Messages read before the pool thread serves someone else.
constexpr int kReadsPerTurn = 64;

}  // namespace

void LinkSocket::take_turn() {
  {
    const std::lock_guard lock(mutex_);
    if (stopped_) return;
    tries_soon_ = false;
    for (const auto& [identity, peer] : peers_) {
      if (peer->debts->due()) pay_locked(*peer);
      pump(*peer);
    }
  }
  const bool more = drain();
  if (on_dealt_with_) on_dealt_with_();
  if (more) pool_.submit(turn_);
}

void LinkSocket::read_now() {
  if (drain()) pool_.submit(turn_);
}

/// Whether there may be more.
bool LinkSocket::drain() {
  const std::lock_guard draining(drain_mutex_);
  for (int reads = 0; reads < kReadsPerTurn; ++reads) {
    std::string peer;
    {
      const std::lock_guard lock(mutex_);
      if (stopped_) return false;
      if (!receive(peer)) return has_held_ && look_again();  // reading may have told of room
    }
    dispatch(peer);
  }
  return true;
}

/// One message into `parts_`. To the end: ZeroMQ has no edge for what is left.
bool LinkSocket::receive(std::string& peer) {
  parts_.clear();
  try {
    zmq::message_t part;
    if (!received(socket_, part)) return false;
    if (routed_) peer = part.to_string();
    bool more = part.more();
    if (!routed_) parts_.push_back(std::move(part));
    while (more) {
      if (!received(socket_, part)) return false;
      more = part.more();
      if (parts_.size() < 3) parts_.push_back(std::move(part));
    }
    return true;
  } catch (const zmq::error_t&) {
    return false;
  }
}

/// What a proven peer sends, on its way to the receiver; credit stays here.
class LinkSocket::Incoming final : public FrameReader::Receiver {
 public:
  Incoming(LinkSocket& link, Peer& peer) : link_(link), peer_(peer) {}
  ~Incoming() {
    link_.receiver_.settle();
    settle();
  }
  Incoming(const Incoming&) = delete;
  Incoming& operator=(const Incoming&) = delete;

  std::optional<std::uint64_t> accepts(const wire::Frame& frame) override {
    if (const auto wire = link_.receiver_.accepts(peer_.identity, frame)) return wire;
    on_dropped(frame);
    return std::nullopt;
  }
  void on_dropped(const wire::Frame& frame) override {
    link_.count_received(peer_);
    arrived(frame, frame.size());
  }
  void on_frame(const wire::Frame& frame, const ObjectBytes& object) override {
    if (frame.has_credit()) {
      const std::lock_guard lock(link_.mutex_);
      const int lanes = std::min(frame.credit().lane_size(), frame.credit().bytes_size());
      for (int i = 0; i < lanes; ++i) peer_.lanes.credit(frame.credit().lane(i), frame.credit().bytes(i));
      return link_.pump(peer_);
    }
    if (frame.has_memory() && peer_.memory) return link_.on_memory(peer_, frame.memory());
    link_.sender_ = &peer_;
    link_.arrived_ = {frame.lane(), object.size() + kFrameCost};
    link_.receiver_.on_frame(peer_.identity, frame, object);
    link_.count_received(peer_);
    if (!std::exchange(link_.receipt_, nullptr)) arrived(frame, object.size());
  }

 private:
  /// Of small messages that come together most are of one lane: they are told as one.
  void arrived(const wire::Frame& frame, std::size_t bytes) {
    if (frame.lane() == 0) return;
    if (frame.lane() != lane_) settle();
    lane_ = frame.lane();
    bytes_ += bytes + kFrameCost;
  }
  void settle() {
    const std::size_t bytes = std::exchange(bytes_, 0);
    if (bytes > 0 && peer_.debts->add(lane_, bytes)) link_.pay(peer_);
  }

  LinkSocket& link_;
  Peer& peer_;
  std::uint64_t lane_ = 0;
  std::size_t bytes_ = 0;  ///< of this lane, not told yet
};

void LinkSocket::dispatch(const std::string& identity) {
  auto peer = find(identity);
  const bool lent = peer && peer->memory && peer->memory->take(parts_);
  std::size_t bytes = 0;
  for (const auto& part : parts_) bytes += part.size();
  counters_.received_messages.fetch_add(1, std::memory_order_relaxed);
  counters_.received_bytes.fetch_add(bytes, std::memory_order_relaxed);
  if (!peer && curve_ && routed_ && !parts_.empty()) {
    const std::string user = property_of(parts_.front(), "User-Id");
    const std::lock_guard lock(mutex_);
    if (!user.empty()) peer = add_peer(identity, user, true);
  }
  const bool heard = peer && peer->proven && !peer->gone;
  if (!heard && curve_) return void(++counters_.unproven);
  if (!heard) return shake_hands(identity);
  Incoming incoming(*this, *peer);
  if (!peer->reader.read(parts_, incoming, lent)) ++counters_.garbled;
}

void LinkSocket::on_memory(Peer& peer, const wire::Memory& told) {
  const std::lock_guard lock(mutex_);
  tell_locked(peer, peer.memory->on_told(told));
}

void LinkSocket::count_received(Peer& peer) {
  if (!on_dealt_with_) return;
  const std::lock_guard lock(mutex_);
  ++peer.counts.received;
}

std::shared_ptr<const void> LinkSocket::receipt() {
  if (arrived_.first == 0) return nullptr;
  if (!receipt_) receipt_ = std::make_shared<const Debt>(sender_->debts, arrived_.first, arrived_.second);
  return receipt_;
}

void LinkSocket::pay(Peer& peer) {
  const std::lock_guard lock(mutex_);
  pay_locked(peer);
}

void LinkSocket::pay_locked(Peer& peer) {
  wire::Frame frame;
  for (const auto& [lane, bytes] : peer.debts->take()) {
    frame.mutable_credit()->add_lane(lane);
    frame.mutable_credit()->add_bytes(bytes);
  }
  if (frame.has_credit()) tell_locked(peer, frame);
}

}  // namespace fiona::host
