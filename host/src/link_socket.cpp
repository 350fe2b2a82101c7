#include "link_socket.hpp"

#include <algorithm>

#include "link_keys.hpp"

namespace fiona::host {
namespace {

/// Messages read before the pool thread serves someone else.
constexpr int kReadsPerTurn = 64;
/// ZeroMQ is given more for a peer while it holds one chunk at most, so never holds more than two; and while it holds
/// fewer messages than this, so that small ones that come while it is busy are sent together.
constexpr std::size_t kMostInside_messages = 8;
/// ZeroMQ's own bound, for answers to peers that have proved nothing and do not read.
constexpr int kSendMark = 64;
/// And for peers that send more than their credit: it reads no more from one of whom so many messages wait to be read.
constexpr int kReceiveMark = 256;
/// The room that a chunk's message has for the frames beside it.
constexpr std::size_t kFrameRoom = 64 * 1024;
/// Lanes whose credit is paid back together.
constexpr std::size_t kLanesOwed = 16;

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
  return status;
}

/// Reads, and sends what had to wait; outlives its socket while it is queued.
struct LinkSocket::Turn final : Runnable {
  explicit Turn(LinkSocket& l) : link(&l) {}
  void run() override {
    const std::lock_guard lock(mutex);
    if (link) link->take_turn();
  }
  std::mutex mutex;
  LinkSocket* link;
};

/// What of a peer's is inside ZeroMQ. ZeroMQ tells from its own thread what it has let go of.
struct LinkSocket::Gate {
  Gate(Pool& p, std::shared_ptr<Turn> t) : pool(p), turn(std::move(t)) {}
  bool has_room() const { return messages < kMostInside_messages && bytes <= kChunkBytes + kFrameRoom; }
  /// Whether more may go in; if not, the turn comes when something has left.
  bool enter_or_wait() {
    if (has_room()) return true;
    waiting = true;
    return has_room() && waiting.exchange(false);
  }

  Pool& pool;
  const std::shared_ptr<Turn> turn;
  std::atomic<std::size_t> messages{0};
  std::atomic<std::size_t> bytes{0};
  std::atomic<bool> waiting{false};
};

/// What has arrived from a peer and has not been credited yet, by lane.
struct LinkSocket::Debts {
  Debts(Pool& p, std::shared_ptr<Turn> t) : pool(p), turn(std::move(t)) {}

  /// Whether it is time to pay: in portions, so that a stream of small messages does not double its traffic.
  bool add(std::uint64_t lane, std::size_t size) {
    const std::lock_guard lock(mutex);
    const auto known = std::find_if(owed.begin(), owed.end(), [lane](const auto& one) { return one.first == lane; });
    if (known != owed.end()) {
      known->second += size;
    } else {
      owed.emplace_back(lane, size);
    }
    bytes += size;
    return is_due();
  }
  bool is_due() const { return bytes >= kCreditPortion || owed.size() > kLanesOwed; }
  std::vector<std::pair<std::uint64_t, std::uint64_t>> take() {
    const std::lock_guard lock(mutex);
    bytes = 0;
    return std::exchange(owed, {});
  }
  bool due() {
    const std::lock_guard lock(mutex);
    return is_due();
  }

  Pool& pool;
  const std::shared_ptr<Turn> turn;
  std::mutex mutex;  ///< the innermost: whoever lets go of a receipt may hold another link's
  std::vector<std::pair<std::uint64_t, std::uint64_t>> owed;
  std::size_t bytes = 0;
};

/// What somebody still has of a peer's message.
struct LinkSocket::Debt {
  Debt(std::shared_ptr<Debts> d, std::uint64_t l, std::size_t b) : debts(std::move(d)), lane(l), bytes(b) {}
  Debt(const Debt&) = delete;
  Debt& operator=(const Debt&) = delete;
  ~Debt() {
    if (debts->add(lane, bytes)) debts->pool.submit(debts->turn);
  }
  const std::shared_ptr<Debts> debts;
  const std::uint64_t lane;
  const std::size_t bytes;
};

/// The bytes of one message inside ZeroMQ, and what is to be told when they have gone.
struct LinkSocket::Release {
  std::shared_ptr<Gate> gate;
  Block records;
  std::shared_ptr<const Payload> payload;
  std::size_t bytes = 0;

  static void done(void*, void* hint) {
    const std::unique_ptr<Release> self(static_cast<Release*>(hint));
    if (!self->gate) return;
    self->gate->bytes -= self->bytes;
    self->gate->messages -= 1;
    if (self->gate->waiting.exchange(false)) self->gate->pool.submit(self->gate->turn);
  }
};

class LinkSocket::Peer {
 public:
  Peer(std::string i, std::string p, std::shared_ptr<Gate> g, std::shared_ptr<Debts> d, bool has_proved)
      : identity(std::move(i)),
        process(std::move(p)),
        gate(std::move(g)),
        debts(std::move(d)),
        proven(has_proved),
        control(lanes.open()) {}

  const std::string identity;
  const std::string process;
  const std::shared_ptr<Gate> gate;
  const std::shared_ptr<Debts> debts;
  bool proven;
  bool gone = false;
  FrameCounts counts;
  PeerLanes lanes;
  const std::shared_ptr<PeerLanes::Lane> control;
  FrameReader reader;  ///< the reader's
};

LinkSocket::LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, LinkCounters& counters, Receiver& receiver,
                       std::function<void()> on_dealt_with)
    : pool_(pool),
      counters_(counters),
      receiver_(receiver),
      on_dealt_with_(std::move(on_dealt_with)),
      routed_(type == zmq::socket_type::router),
      secret_(random_bytes(kKeyBytes)),
      socket_(context, type),
      turn_(std::make_shared<Turn>(*this)) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::sndhwm, kSendMark);
  socket_.set(zmq::sockopt::rcvhwm, kReceiveMark);
  socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(kChunkBytes + kFrameRoom));
}

LinkSocket::~LinkSocket() { stop(); }

void LinkSocket::listen(const std::string& endpoint, std::string key) {
  key_ = std::move(key);
  socket_.set(zmq::sockopt::router_mandatory, 1);
  socket_.bind(endpoint);
  start();
}

void LinkSocket::connect(const std::string& endpoint, std::string name, std::string key) {
  key_ = std::move(key);
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
  curve_ = true;
  socket_.set(zmq::sockopt::router_mandatory, 1);
  socket_.bind(endpoint);
  endpoint_ = socket_.get(zmq::sockopt::last_endpoint);
  start();
}

void LinkSocket::connect_proven(const std::string& endpoint, std::string provider) {
  curve_ = true;
  socket_.connect(endpoint);
  {
    const std::lock_guard lock(mutex_);
    add_peer("", std::move(provider), true);
  }
  start();
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
  {
    const std::lock_guard lock(turn_->mutex);
    turn_->link = nullptr;
  }
  const std::lock_guard lock(mutex_);
  stopped_ = true;
  socket_.set(zmq::sockopt::linger, static_cast<int>(linger.count()));
  socket_.close();
}

// ---- peers and lanes ------------------------------------------------------------------------------------------

std::shared_ptr<LinkSocket::Peer> LinkSocket::add_peer(const std::string& identity, std::string process, bool proven) {
  auto gate = std::make_shared<Gate>(pool_, turn_);
  auto debts = std::make_shared<Debts>(pool_, turn_);
  return peers_[identity] = std::make_shared<Peer>(identity, std::move(process), std::move(gate), std::move(debts), proven);
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
  return static_cast<std::size_t>(
      std::count_if(peers_.begin(), peers_.end(), [](const auto& entry) { return entry.second->proven; }));
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
std::shared_ptr<const Payload> payload_of(const std::shared_ptr<const Object>& object) {
  thread_local std::weak_ptr<const Object> last_object;
  thread_local std::weak_ptr<const Payload> last_payload;
  auto payload = last_payload.lock();
  if (payload && last_object.lock() == object) return payload;
  payload = std::make_shared<const Payload>(object);
  last_object = object;
  last_payload = payload;
  return payload;
}

}  // namespace

PeerLanes::Item LinkSocket::item_for(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object,
                                     Rule rule) {
  PeerLanes::Item item;
  item.rule = rule;
  item.wire = frame.wire();
  const std::size_t size = object ? object->ByteSizeLong() : 0;
  if (rule != Rule::Control) {
    item.cost = size + kFrameCost;
    frame.set_lane(lane.lane->id());
  }
  if (size > kInlineBytes) {
    item.payload = payload_of(object);
    if (item.payload->chunks().size() > 1) frame.set_size(size);
    item.record = make_record(frame, ObjectBytes(item.payload->chunks().front().inside));
  } else {
    item.record = make_record(frame, object.get(), size);
  }
  return item;
}

bool LinkSocket::refuses(const Object& object) {
  if (object.ByteSizeLong() <= kMaxObject) return false;
  ++counters_.too_large;
  return true;
}

LinkSocket::Sent LinkSocket::send(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object,
                                  Rule rule, Wires also) {
  if (!lane.peer) return {};
  if (object && refuses(*object)) return {Sent::What::TooLarge, 0};
  if (on_dealt_with_) rule = Rule::Control;
  PeerLanes::Item item = item_for(lane, frame, object, rule);
  item.also = std::move(also);
  const std::lock_guard lock(mutex_);
  if (lane.peer->gone) return {};
  ++lane.peer->counts.sent;
  const auto taken = lane.peer->lanes.offer(*lane.lane, std::move(item));
  pump(*lane.peer);
  return {taken.ok ? Sent::What::Ok : Sent::What::Full, taken.lost};
}

void LinkSocket::forward(const Lane& lane, const std::string& peer, wire::Frame frame, const ObjectBytes& object,
                         const std::shared_ptr<const Payload>& payload, std::shared_ptr<const void> receipt) {
  frame.clear_size();
  const bool has_lane = frame.lane() != 0 && lane.lane;
  frame.set_lane(has_lane ? lane.lane->id() : 0);
  PeerLanes::Item item;
  item.wire = frame.wire();
  item.cost = has_lane ? object.size() + kFrameCost : 0;
  item.payload = payload;
  item.receipt = std::move(receipt);
  if (payload && payload->chunks().size() > 1) frame.set_size(payload->size());
  item.record = make_record(frame, payload ? ObjectBytes(payload->chunks().front().inside) : object);
  const std::lock_guard lock(mutex_);
  const auto known = lane.peer ? lane.peer : peers_.contains(peer) ? peers_[peer] : nullptr;
  if (!known || known->gone) return;
  known->lanes.offer(lane.lane ? *lane.lane : *known->control, std::move(item));
  pump(*known);
}

void LinkSocket::tell(const std::string& peer, wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto found = peers_.find(peer);
  if (found == peers_.end()) return;
  ++found->second->counts.sent;
  tell_locked(*found->second, frame);
}

void LinkSocket::tell_locked(Peer& peer, wire::Frame& frame) {
  PeerLanes::Item item;
  item.record = make_record(frame, nullptr, 0);
  peer.lanes.offer(*peer.control, std::move(item));
  pump(peer);
}

/// Called with the mutex held, as is what follows.
void LinkSocket::pump(Peer& peer) {
  if (stopped_ || !peer.proven || peer.gone) return;
  bool sent = false;
  PeerLanes::Outgoing out;
  while (peer.lanes.has_ready() && peer.gate->enter_or_wait() && peer.lanes.next(out)) {
    if (!send_out(peer, out)) break;
    sent = true;
  }
  // Sending may have consumed the descriptor's edge for messages that wait.
  if (sent && has_input()) pool_.submit(turn_);
}

bool LinkSocket::send_out(Peer& peer, PeerLanes::Outgoing& out) {
  const std::size_t bytes = out.bytes();
  peer.gate->bytes += bytes;
  peer.gate->messages += 1;
  auto release = std::make_unique<Release>();
  release->gate = peer.gate;
  release->bytes = bytes;
  zmq::message_t beside_frames;
  Block records = std::move(out.records);
  const std::string_view beside = out.payload ? out.payload->chunks()[out.chunk].beside : std::string_view();
  const bool chunk = !beside.empty();
  if (chunk) beside_frames.rebuild(records.data(), records.size());
  release->payload = std::move(out.payload);
  if (!chunk) release->records = std::move(records);
  // ZeroMQ only reads the bytes: they are not its own.
  void* data = chunk ? const_cast<char*>(beside.data()) : static_cast<void*>(release->records.data());
  const std::size_t size = chunk ? beside.size() : release->records.size();
  zmq::message_t body(data, size, &Release::done, release.release());
  try {
    // A connection that is just not there takes none of the parts.
    bool taken = !routed_ || socket_.send(zmq::buffer(peer.identity), zmq::send_flags::sndmore | zmq::send_flags::dontwait);
    if (taken && chunk) taken = socket_.send(beside_frames, zmq::send_flags::sndmore | zmq::send_flags::dontwait).has_value();
    if (taken) socket_.send(body, zmq::send_flags::dontwait);
  } catch (const zmq::error_t&) {
    peer.gone = true;  // supervision reports that, not each message
    return false;
  }
  counters_.sent_messages.fetch_add(1, std::memory_order_relaxed);
  counters_.sent_bytes.fetch_add(bytes, std::memory_order_relaxed);
  return true;
}

void LinkSocket::send_plain(const std::string& peer, const wire::Frame& frame) {
  if (stopped_) return;
  const Block record = make_record(frame, nullptr, 0);
  try {
    if (routed_) socket_.send(zmq::buffer(peer), zmq::send_flags::sndmore | zmq::send_flags::dontwait);
    socket_.send(zmq::buffer(record.data(), record.size()), zmq::send_flags::dontwait);
  } catch (const zmq::error_t&) {
    return;  // it has gone again
  }
  if (has_input()) pool_.submit(turn_);
}

bool LinkSocket::has_input() { return (socket_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0; }

// ---- receiving ------------------------------------------------------------------------------------------------

void LinkSocket::take_turn() {
  {
    const std::lock_guard lock(mutex_);
    if (stopped_) return;
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
      if (stopped_ || !receive(peer)) return false;
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
    if (!socket_.recv(part, zmq::recv_flags::dontwait)) return false;
    if (routed_) peer = part.to_string();
    bool more = part.more();
    if (!routed_) parts_.push_back(std::move(part));
    while (more) {
      if (!socket_.recv(part, zmq::recv_flags::dontwait)) return false;
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

  bool accepts(const wire::Frame& frame) override {
    if (link_.receiver_.accepts(peer_.identity, frame)) return true;
    link_.count_received(peer_);
    arrived(frame, frame.size());
    return false;
  }
  void on_frame(const wire::Frame& frame, const ObjectBytes& object) override {
    if (frame.has_credit()) {
      const std::lock_guard lock(link_.mutex_);
      const int lanes = std::min(frame.credit().lane_size(), frame.credit().bytes_size());
      for (int i = 0; i < lanes; ++i) peer_.lanes.credit(frame.credit().lane(i), frame.credit().bytes(i));
      return link_.pump(peer_);
    }
    link_.sender_ = &peer_;
    link_.arrived_ = {frame.lane(), object.size() + kFrameCost};
    link_.receiver_.on_frame(peer_.identity, frame, object);
    link_.count_received(peer_);
    if (!std::exchange(link_.receipt_, nullptr)) arrived(frame, object.size());
  }

 private:
  void arrived(const wire::Frame& frame, std::size_t bytes) {
    if (frame.lane() != 0 && peer_.debts->add(frame.lane(), bytes + kFrameCost)) link_.pay(peer_);
  }

  LinkSocket& link_;
  Peer& peer_;
};

void LinkSocket::dispatch(const std::string& identity) {
  std::size_t bytes = 0;
  for (const auto& part : parts_) bytes += part.size();
  counters_.received_messages.fetch_add(1, std::memory_order_relaxed);
  counters_.received_bytes.fetch_add(bytes, std::memory_order_relaxed);
  auto peer = find(identity);
  if (!peer && curve_ && routed_ && !parts_.empty()) {
    const char* user = zmq_msg_gets(parts_.front().handle(), "User-Id");
    const std::lock_guard lock(mutex_);
    if (user && *user) peer = add_peer(identity, user, true);
  }
  if (!peer && curve_) return void(++counters_.unproven);
  if (!peer || !peer->proven) return shake_hands(identity);
  Incoming incoming(*this, *peer);
  if (!peer->reader.read(parts_, incoming)) ++counters_.garbled;
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

// ---- the proof of the key -------------------------------------------------------------------------------------

/// Of somebody who has proved nothing yet: only the proof itself is looked at.
void LinkSocket::shake_hands(const std::string& peer) {
  struct Single final : FrameReader::Receiver {
    bool accepts(const wire::Frame&) override { return false; }
    void on_frame(const wire::Frame& one, const ObjectBytes& object) override {
      if (object.size() == 0) frame = one;
    }
    wire::Frame frame;
  } single;
  FrameReader reader;
  if (parts_.size() == 1) reader.read(parts_, single);
  if (routed_ && (single.frame.has_hello() || single.frame.has_proof())) return welcome(peer, single.frame);
  if (!routed_ && single.frame.has_challenge()) return check_challenge(single.frame);
  if (!routed_ && single.frame.has_refused()) return receiver_.on_refused(single.frame.refused().reason());
  ++counters_.unproven;
}

void LinkSocket::welcome(const std::string& peer, const wire::Frame& frame) {
  const bool hello = frame.has_hello();
  const std::string& name = hello ? frame.hello().client() : frame.proof().client();
  const std::string& nonce = hello ? frame.hello().nonce() : frame.proof().nonce();
  wire::Frame answer;
  if (hello && frame.hello().version() != wire::VERSION_1) {
    answer.mutable_refused()->set_reason(kUnknownVersion);
    const std::lock_guard lock(mutex_);
    return send_plain(peer, answer);
  }
  if (nonce.size() != kNonceBytes) return void(++counters_.unproven);
  const std::string key = link_key(key_, name);
  const std::string ours = derived_nonce(secret_, peer + nonce + name);
  if (hello) {
    answer.mutable_challenge()->set_nonce(ours);
    answer.mutable_challenge()->set_proof(link_proof(key, LinkSide::Provider, nonce, ours));
    const std::lock_guard lock(mutex_);
    return send_plain(peer, answer);
  }
  if (!same_proof(frame.proof().proof(), link_proof(key, LinkSide::Client, nonce, ours))) {
    ++counters_.unproven;
    return;
  }
  const std::lock_guard lock(mutex_);
  forget_locked(name);  // a process has one link: what it leaves behind does not add up
  add_peer(peer, name, true);
}

void LinkSocket::check_challenge(const wire::Frame& frame) {
  const auto& challenge = frame.challenge();
  if (!same_proof(challenge.proof(), link_proof(key_, LinkSide::Provider, nonce_, challenge.nonce()))) {
    ++counters_.unproven;
    return receiver_.on_refused("the process that listens there does not know the system's key");
  }
  wire::Frame answer;
  answer.mutable_proof()->set_client(name_);
  answer.mutable_proof()->set_nonce(nonce_);
  answer.mutable_proof()->set_proof(link_proof(key_, LinkSide::Client, nonce_, challenge.nonce()));
  const std::lock_guard lock(mutex_);
  send_plain("", answer);
  const auto provider = peers_.find("");
  if (provider == peers_.end()) return;
  provider->second->proven = true;
  pump(*provider->second);
}

}  // namespace fiona::host
