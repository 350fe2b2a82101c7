#include "link_socket.hpp"

#include <algorithm>

#include "link_keys.hpp"
#include "link_peer.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

/// ZeroMQ's own bound, for answers to peers that have proved nothing and do not read.
constexpr int kSendMark = 64;
/// And for peers that send more than their credit: it reads no more from one of whom so many messages wait to be read.
constexpr int kReceiveMark = 256;

}  // namespace

control::LinkStatus LinkCounters::status() const {
  control::LinkStatus status;
  status.set_sent_messages(sent_messages);
  status.set_sent_bytes(sent_bytes);
  status.set_received_messages(received_messages);
  status.set_received_bytes(received_bytes);
  status.set_garbled(garbled);
  status.set_unproven(unproven);
  status.set_not_granted(not_granted);
  status.set_too_large(too_large);
  status.set_overrun(overrun);
  status.set_memory_bytes(memory_bytes);
  status.set_late(late);
  return status;
}

LinkSocket::LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, LinkCounters& counters,
                       Receiver& receiver, std::function<void()> on_dealt_with)
    : pool_(pool),
      counters_(counters),
      receiver_(receiver),
      on_dealt_with_(std::move(on_dealt_with)),
      routed_(type == zmq::socket_type::router),
      secret_(random_bytes(kKeyBytes)),
      socket_(context, type),
      turn_(std::make_shared<Turn>(*this, &LinkSocket::take_turn)),
      batches_(std::make_shared<Turn>(*this, &LinkSocket::send_batches)) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::sndhwm, kSendMark);
  socket_.set(zmq::sockopt::rcvhwm, kReceiveMark);
  bound_parts();
}

LinkSocket::~LinkSocket() { stop(); }

void LinkSocket::listen(const std::string& endpoint, LinkKeys keys) {
  keys_ = std::move(keys);
  socket_.set(zmq::sockopt::router_mandatory, 1);
  socket_.bind(endpoint);
  start();
}

void LinkSocket::connect(const std::string& endpoint, std::string name, LinkKeys keys) {
  keys_ = std::move(keys);
  name_ = std::move(name);
  nonce_ = random_bytes(kNonceBytes);
  socket_.connect(endpoint);
  wire::Frame frame;
  frame.mutable_hello()->set_version(wire::VERSION_1);
  frame.mutable_hello()->set_client(name_);
  frame.mutable_hello()->set_nonce(nonce_);
  {
    const std::lock_guard lock(mutex_);
    add_peer("", "", false);
    send_plain("", frame);
  }
  start();
}

void LinkSocket::listen_proven(const std::string& endpoint) {
  be_proven();
  socket_.set(zmq::sockopt::router_mandatory, 1);
  socket_.bind(endpoint);
  endpoint_ = socket_.get(zmq::sockopt::last_endpoint);
  start();
}

void LinkSocket::connect_proven(const std::string& endpoint, std::string provider) {
  be_proven();
  socket_.connect(endpoint);
  {
    const std::lock_guard lock(mutex_);
    add_peer("", std::move(provider), true);
  }
  start();
}

/// Only what comes from other hosts proves itself so.
void LinkSocket::be_proven() {
  curve_ = true;
  chunk_ = kChunkBytes;
  bound_parts();
}

void LinkSocket::bound_parts() {
  socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(chunk_ + kFrameRoom));
}

void LinkSocket::start() {
  watch_ = pool_.watch(socket_.get(zmq::sockopt::fd), [this] { take_turn(); });
  pool_.submit(turn_);  // what came before the watch gives no edge
}

void LinkSocket::stop(std::chrono::milliseconds linger) {
  {
    const std::lock_guard lock(mutex_);
    if (stopped_) return;
  }
  watch_.reset();
  turn_->end();
  batches_->end();
  const std::lock_guard lock(mutex_);
  for (const auto& [identity, peer] : peers_) pump(*peer);
  stopped_ = true;
  socket_.set(zmq::sockopt::linger, static_cast<int>(linger.count()));
  socket_.close();
}

// ---- peers and lanes ------------------------------------------------------------------------------------------

std::shared_ptr<LinkSocket::Peer> LinkSocket::add_peer(const std::string& identity, std::string process, bool proven) {
  auto gate = std::make_shared<Gate>(pool_, turn_, chunk_);
  auto debts = std::make_shared<Debts>(pool_, turn_);
  return peers_[identity] =
             std::make_shared<Peer>(identity, std::move(process), std::move(gate), std::move(debts), proven);
}

std::shared_ptr<LinkSocket::Peer> LinkSocket::find(const std::string& peer) {
  const std::lock_guard lock(mutex_);
  const auto found = peers_.find(peer);
  return found == peers_.end() ? nullptr : found->second;
}

std::string LinkSocket::process_of(const std::string& peer) {
  const auto found = find(peer);
  return found ? found->process : std::string();
}

std::size_t LinkSocket::peers() {
  const std::lock_guard lock(mutex_);
  return static_cast<std::size_t>(std::count_if(
      peers_.begin(), peers_.end(), [](const auto& entry) { return entry.second->proven && !entry.second->gone; }));
}

std::map<std::string, FrameCounts> LinkSocket::frame_counts() {
  const std::lock_guard lock(mutex_);
  std::map<std::string, FrameCounts> all;
  for (const auto& [identity, peer] : peers_) {
    all[peer->process].sent += peer->counts.sent;
    all[peer->process].received += peer->counts.received;
  }
  return all;
}

void LinkSocket::forget(const std::string& process) {
  const std::lock_guard lock(mutex_);
  forget_locked(process);
}

void LinkSocket::forget_locked(const std::string& process) {
  std::erase_if(peers_, [&](const auto& entry) {
    if (entry.second->process != process) return false;
    entry.second->gone = true;
    return true;
  });
}

void LinkSocket::drop(const std::string& peer) {
  const std::lock_guard lock(mutex_);
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return;
  found->second->gone = true;
  peers_.erase(found);
}

LinkSocket::Lane LinkSocket::open_lane(const std::string& peer) {
  const std::lock_guard lock(mutex_);
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return {};
  return {found->second, found->second->lanes.open()};
}

std::size_t LinkSocket::close_lane(const Lane& lane, PeerLanes::Rest rest) {
  if (!lane.peer) return 0;
  const std::lock_guard lock(mutex_);
  return lane.peer->lanes.close(*lane.lane, rest);
}

// ---- sending --------------------------------------------------------------------------------------------------

namespace {

/// The object's bytes, written once though it goes to several processes: one after the other, on the same thread.
std::shared_ptr<const Payload> payload_of(const std::shared_ptr<const Object>& object, std::size_t chunk) {
  thread_local std::weak_ptr<const Object> last_object;
  thread_local std::weak_ptr<const Payload> last_payload;
  auto payload = last_payload.lock();
  if (payload && payload->chunk() == chunk && last_object.lock() == object) return payload;
  payload = std::make_shared<const Payload>(object, chunk);
  last_object = object;
  last_payload = payload;
  return payload;
}

}  // namespace

PeerLanes::Item LinkSocket::item_for(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object,
                                     std::size_t size, Rule rule) {
  PeerLanes::Item item;
  item.rule = rule;
  item.wire = frame.wire();
  if (rule != Rule::Control) {
    item.cost = size + kFrameCost;
    frame.set_lane(lane.lane->id());
    if (frame.has_request()) item.messages = 0;  // who has made it is told
  }
  if (size > kInlineBytes) {
    item.payload = payload_of(object, chunk_);
    if (item.payload->chunks().size() > 1) frame.set_size(size);
    item.record = make_record(frame, ObjectBytes(item.payload->chunks().front().inside));
  } else {
    item.record = make_record(frame, object.get(), size);
  }
  return item;
}

bool LinkSocket::refuses(std::size_t size) {
  if (size <= kMaxObject) return false;
  ++counters_.too_large;
  return true;
}

LinkSocket::Sent LinkSocket::send(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object,
                                  Rule rule, Wires also) {
  if (!lane.peer) return {Sent::What::Gone, 0};
  const std::size_t size = object ? object->ByteSizeLong() : 0;
  if (refuses(size)) return {Sent::What::TooLarge, 0};
  if (on_dealt_with_) rule = Rule::Control;
  if (rule == Rule::DropOldest && object && !also && joined(lane, frame, *object, size)) return {};
  PeerLanes::Item item = item_for(lane, frame, object, size, rule);
  item.also = std::move(also);
  const std::lock_guard lock(mutex_);
  if (lane.peer->gone) return {Sent::What::Gone, 0};
  ++lane.peer->counts.sent;
  const auto taken = offer(*lane.peer, *lane.lane, std::move(item));
  return {taken.ok ? Sent::What::Ok : Sent::What::Full, taken.lost};
}

/// Of a small message of a stream: most find others that wait.
bool LinkSocket::joined(const Lane& lane, wire::Frame& frame, const Object& object, std::size_t size) {
  if (size > kTogetherBytes) return false;
  frame.set_lane(lane.lane->id());
  const std::size_t bytes = record_size(frame, size);
  const std::lock_guard lock(mutex_);
  Peer& peer = *lane.peer;
  if (peer.gone) return false;
  std::uint8_t* const place = peer.lanes.join(*lane.lane, frame.wire(), size + kFrameCost, bytes);
  if (!place) return false;
  write_record(place, frame, &object, size);
  ++peer.counts.sent;
  if (!peer.batch.waits_with(bytes)) pump(peer);
  return true;
}

std::size_t LinkSocket::forward(const Lane& lane, const std::string& peer, wire::Frame frame, const ObjectBytes& object,
                                const std::shared_ptr<const Payload>& payload, Rule rule,
                                std::shared_ptr<const void> receipt) {
  frame.clear_size();
  const bool has_lane = frame.lane() != 0 && lane.lane;
  frame.set_lane(has_lane ? lane.lane->id() : 0);
  PeerLanes::Item item;
  item.rule = on_dealt_with_ || !has_lane ? Rule::Control : rule;
  item.wire = frame.wire();
  if (!frame.also().empty())
    item.also = std::make_shared<const std::vector<std::uint64_t>>(frame.also().begin(), frame.also().end());
  item.cost = has_lane ? object.size() + kFrameCost : 0;
  if (frame.has_request()) item.messages = 0;  // who has made it is told
  item.payload = payload;
  item.receipt = std::move(receipt);
  if (payload && payload->chunks().size() > 1) frame.set_size(payload->size());
  item.record = make_record(frame, payload ? ObjectBytes(payload->chunks().front().inside) : object);
  const std::lock_guard lock(mutex_);
  const auto known = lane.peer ? lane.peer : peers_.contains(peer) ? peers_[peer] : nullptr;
  if (!known || known->gone) {
    if (rule == Rule::DropOldest) return item.losses();
    if (object.size() > 0 || item.cost > 0) counters_.late += item.losses();
    return 0;
  }
  // A window is what its sender has credit for, and a queue behind it what he keeps himself.
  const bool credited =
      item.rule == Rule::DropOldest || (has_lane ? lane.lane->waiting() <= 2 * kLaneWindow : object.size() == 0);
  if (!credited && !on_dealt_with_) {
    ++counters_.overrun;
    return 0;
  }
  return offer(*known, lane.lane ? *lane.lane : *known->control, std::move(item)).lost;
}

/// A peer that leaves unread more than may wait for it is let go: as one that has gone, it is sent nothing more and not
/// heard.
PeerLanes::Taken LinkSocket::offer(Peer& peer, PeerLanes::Lane& lane, PeerLanes::Item item) {
  if (peer.memory && item.payload && item.payload->size() >= kMemoryFrom) tell_locked(peer, peer.memory->offer());
  const bool is_small_push = item.rule == Rule::DropOldest && !item.payload;
  const bool waits = is_small_push && peer.batch.waits_with(item.record.size());
  const auto taken = peer.lanes.offer(lane, std::move(item));
  if (!waits) pump(peer);
  if (peer.lanes.control_bytes() > kMostControl && !on_dealt_with_ && !peer.gone.exchange(true)) ++counters_.overrun;
  return taken;
}

/// In virtual time nothing waits for company: what one round sends is there in the next.
void LinkSocket::end_batch(Peer& peer) {
  const bool is_due = peer.batch.may_wait;
  peer.batch = {.may_wait = peer.batch.messages >= kStream_messages && !on_dealt_with_};
  if (peer.batch.may_wait && !is_due) pool_.submit_soon(batches_);
}

void LinkSocket::send_batches() {
  const std::lock_guard lock(mutex_);
  for (const auto& [identity, peer] : peers_) {
    if (std::exchange(peer->batch.may_wait, false)) pump(*peer);
  }
}

void LinkSocket::tell(const std::string& peer, wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return;
  ++found->second->counts.sent;
  tell_locked(*found->second, frame);
}

void LinkSocket::tell_locked(Peer& peer, wire::Frame& frame) {
  if (peer.gone) return;
  PeerLanes::Item item;
  item.record = make_record(frame, nullptr, 0);
  offer(peer, *peer.control, std::move(item));
}

void LinkSocket::tell_locked(Peer& peer, const std::optional<wire::Memory>& memory) {
  if (!memory) return;
  wire::Frame frame;
  *frame.mutable_memory() = *memory;
  tell_locked(peer, frame);
}

/// Called with the mutex held, as is what follows.
void LinkSocket::pump(Peer& peer) {
  if (stopped_ || !peer.proven || peer.gone || !fill(peer)) return;
  if (look_again()) pool_.submit(turn_);
}

/// Whatever is done with ZeroMQ, also in vain, may take its descriptor's edge, for messages that wait as for room. So
/// input is looked for last, and what is held even then is tried again soon: it has lost its edge by that look, maybe.
/// True: there is input.
bool LinkSocket::look_again() {
  if (has_held_) {
    has_held_ = false;
    for (const auto& [identity, peer] : peers_) {
      if (peer->held && !peer->gone) fill(*peer);
    }
    if (has_held_ && !std::exchange(tries_soon_, true)) pool_.submit_soon(turn_);
  }
  return has_input();
}

/// Whether anything was tried.
bool LinkSocket::fill(Peer& peer) {
  bool tried = peer.held.has_value();
  if (tried && !cross(peer, *std::exchange(peer.held, std::nullopt))) return true;
  PeerLanes::Outgoing out;
  while (peer.lanes.has_ready() && peer.gate->enter_or_wait() && peer.lanes.next(out)) {
    tried = true;
    if (!out.payload) end_batch(peer);
    if (!send_out(peer, out)) break;
  }
  return tried;
}

bool LinkSocket::send_out(Peer& peer, PeerLanes::Outgoing& out) {
  Crossing crossing;
  crossing.bytes = out.bytes();
  const std::string_view beside = out.payload ? out.payload->chunks()[out.chunk].beside : std::string_view();
  std::optional<zmq::message_t> place;
  if (peer.memory && beside.size() >= kMemoryFrom) place = peer.memory->put(beside);
  if (place) {  // what ZeroMQ carries of it is small
    counters_.memory_bytes.fetch_add(beside.size(), std::memory_order_relaxed);
    out.payload = nullptr;
  }
  auto release = std::make_unique<Release>();
  release->gate = peer.gate;
  release->bytes = out.bytes();
  peer.gate->bytes += release->bytes;
  if (!out.payload) peer.gate->messages += 1;
  Block records = std::move(out.records);
  const bool chunk = !beside.empty() && !place;
  if (chunk) crossing.add(zmq::message_t(records.data(), records.size()));
  release->payload = std::move(out.payload);
  if (!chunk) release->records = std::move(records);
  // ZeroMQ only reads the bytes: they are not its own.
  void* data = chunk ? const_cast<char*>(beside.data()) : static_cast<void*>(release->records.data());
  const std::size_t size = chunk ? beside.size() : release->records.size();
  crossing.add(zmq::message_t(data, size, &Release::done, release.release()));
  if (place) {
    crossing.add(zmq::message_t());
    crossing.add(std::move(*place));
  }
  return cross(peer, std::move(crossing));
}

/// False: nothing more goes to this peer now. The gate is there so that ZeroMQ has room whenever this is called; where
/// it has none all the same, or no connection just then, what was to go waits for the next try, and is not lost.
bool LinkSocket::cross(Peer& peer, Crossing crossing) {
  bool taken = false;
  try {
    taken = !routed_ || sent(socket_, zmq::buffer(peer.identity), zmq::send_flags::sndmore);
    for (std::size_t i = 0; taken && i < crossing.count; ++i) {
      const bool last = i + 1 == crossing.count;
      taken = sent(socket_, crossing.parts[i], last ? zmq::send_flags::none : zmq::send_flags::sndmore);
    }
  } catch (const zmq::error_t&) {
    peer.gone = true;  // supervision reports that, not each message
    return false;
  }
  if (!taken) {
    peer.held = std::move(crossing);
    has_held_ = true;
    return false;
  }
  counters_.sent_messages.fetch_add(1, std::memory_order_relaxed);
  counters_.sent_bytes.fetch_add(crossing.bytes, std::memory_order_relaxed);
  return true;
}

void LinkSocket::send_plain(const std::string& peer, const wire::Frame& frame) {
  if (stopped_) return;
  const Block record = make_record(frame, nullptr, 0);
  try {
    if (!routed_ || sent(socket_, zmq::buffer(peer), zmq::send_flags::sndmore))
      sent(socket_, zmq::buffer(record.data(), record.size()));
  } catch (const zmq::error_t&) {  // it has gone again
  }
  if (look_again()) pool_.submit(turn_);
}

bool LinkSocket::has_input() {
  return uninterrupted([this] { return (socket_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0; });
}

}  // namespace fiona::host
