#include "link.hpp"

#include <google/protobuf/message.h>

#include <algorithm>
#include <cstring>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/push.hpp"

namespace fiona::host {
namespace {

constexpr std::size_t kLengthBytes = 4;
/// The largest message that is read from a peer (architecture 7.5).
constexpr std::int64_t kMaxMessage = 64LL * 1024 * 1024;
/// What a message counts beside its object's bytes.
constexpr std::size_t kFrameCost = 64;
/// Messages read before the pool thread serves someone else.
constexpr int kReadsPerTurn = 64;

bool is_push(const Port& port) {
  const Pattern pattern = port.service().pattern();
  return pattern == PUSH_NEWEST || pattern == PUSH_TIMED;
}

const Object& prototype_of(const google::protobuf::Descriptor& type) {
  return *google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type);
}

wire::Frame frame_for(std::uint64_t wire) {
  wire::Frame frame;
  frame.set_wire(wire);
  return frame;
}

}  // namespace

// ---- socket ---------------------------------------------------------------------------------------------------

struct LinkSocket::Drain final : Runnable {
  explicit Drain(LinkSocket& l) : link(&l) {}
  void run() override {
    const std::lock_guard lock(mutex);
    if (link) link->drain();
  }
  std::mutex mutex;
  LinkSocket* link;
};

LinkSocket::LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, OnFrame on_frame)
    : pool_(pool),
      on_frame_(std::move(on_frame)),
      socket_(context, type),
      drain_(std::make_shared<Drain>(*this)),
      routed_(type == zmq::socket_type::router) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::sndhwm, 0);  // bounded by the wires' credit instead, which counts bytes
  socket_.set(zmq::sockopt::rcvhwm, 0);
  socket_.set(zmq::sockopt::maxmsgsize, kMaxMessage + (1 << 20));
}

LinkSocket::~LinkSocket() { stop(); }

void LinkSocket::start() {
  watch_ = pool_.watch(socket_.get(zmq::sockopt::fd), [this] { drain(); });
  pool_.submit(drain_);  // what came before the watch gives no edge
}

void LinkSocket::stop() {
  watch_.reset();
  {
    const std::lock_guard lock(drain_->mutex);
    drain_->link = nullptr;
  }
  const std::lock_guard lock(mutex_);
  stopped_ = true;
  socket_.close();
}

void LinkSocket::send(const std::string& peer, const wire::Frame& frame, const Object* object) {
  const std::size_t frame_size = frame.ByteSizeLong();
  const std::size_t object_size = object ? object->ByteSizeLong() : 0;
  zmq::message_t body(kLengthBytes + frame_size + object_size);
  auto* out = static_cast<std::uint8_t*>(body.data());
  for (std::size_t i = 0; i < kLengthBytes; ++i) out[i] = static_cast<std::uint8_t>(frame_size >> (8 * i));
  frame.SerializeWithCachedSizesToArray(out + kLengthBytes);
  if (object) object->SerializeWithCachedSizesToArray(out + kLengthBytes + frame_size);

  bool input = false;
  {
    const std::lock_guard lock(mutex_);
    if (stopped_) return;
    try {
      if (routed_) socket_.send(zmq::buffer(peer), zmq::send_flags::sndmore | zmq::send_flags::dontwait);
      socket_.send(body, zmq::send_flags::dontwait);
    } catch (const zmq::error_t&) {
      return;  // the peer is gone: supervision reports that, not each message
    }
    input = has_input();
  }
  // Sending may have consumed the descriptor's edge for messages that wait.
  if (input) pool_.submit(drain_);
}

bool LinkSocket::has_input() { return (socket_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0; }

void LinkSocket::drain() {
  std::unique_lock draining(drain_mutex_, std::try_to_lock);
  if (!draining) {
    draining.lock();  // the other reader may have looked already: look again after it
  }
  for (int reads = 0; reads < kReadsPerTurn; ++reads) {
    std::string peer;
    zmq::message_t body;
    {
      std::unique_lock lock(mutex_);
      if (stopped_ || !has_input() || !receive(lock, peer, body)) return;
    }
    dispatch(peer, body);
  }
  pool_.submit(drain_);
}

bool LinkSocket::receive(std::unique_lock<std::mutex>&, std::string& peer, zmq::message_t& body) {
  try {
    if (routed_) {
      zmq::message_t identity;
      if (!socket_.recv(identity, zmq::recv_flags::dontwait)) return false;
      peer = identity.to_string();
    }
    if (!socket_.recv(body, zmq::recv_flags::dontwait)) return false;
    // Further parts are not ours: read away so that the next message starts clean.
    bool foreign = false;
    for (zmq::message_t extra; socket_.get(zmq::sockopt::rcvmore);) {
      foreign = true;
      if (!socket_.recv(extra, zmq::recv_flags::dontwait)) break;
    }
    if (foreign) body.rebuild();
    return true;
  } catch (const zmq::error_t&) {
    return false;
  }
}

/// Everything from the network is checked before use: lengths, then protobuf, then the wire's own rules.
void LinkSocket::dispatch(const std::string& peer, const zmq::message_t& body) {
  if (body.size() < kLengthBytes) return;
  const auto* in = static_cast<const std::uint8_t*>(body.data());
  std::size_t frame_size = 0;
  for (std::size_t i = 0; i < kLengthBytes; ++i) frame_size |= static_cast<std::size_t>(in[i]) << (8 * i);
  if (frame_size > body.size() - kLengthBytes) return;
  wire::Frame frame;
  if (!frame.ParseFromArray(in + kLengthBytes, static_cast<int>(frame_size))) return;
  const char* object = static_cast<const char*>(body.data()) + kLengthBytes + frame_size;
  on_frame_(peer, frame, {object, body.size() - kLengthBytes - frame_size});
}

// ---- credit ---------------------------------------------------------------------------------------------------

bool CreditQueue::offer(Item item, bool drop_oldest, const SendNow& send) {
  if (waiting_.empty() && may_send(item.bytes)) {
    in_flight_ += item.bytes;
    send(item);
    return true;
  }
  const auto full = [&] { return waiting_bytes_ > 0 && waiting_bytes_ + item.bytes > kWireWindow; };
  if (!drop_oldest && full()) return false;
  while (full()) {
    waiting_bytes_ -= waiting_.front().bytes;
    waiting_.pop_front();
    ++dropped_;
  }
  waiting_bytes_ += item.bytes;
  waiting_.push_back(std::move(item));
  return true;
}

void CreditQueue::credit(std::size_t bytes, const SendNow& send) {
  in_flight_ -= std::min(in_flight_, bytes);
  while (!waiting_.empty() && may_send(waiting_.front().bytes)) {
    Item item = std::move(waiting_.front());
    waiting_.pop_front();
    waiting_bytes_ -= item.bytes;
    in_flight_ += item.bytes;
    send(item);
  }
}

// ---- wire -----------------------------------------------------------------------------------------------------

/// Sends the answer to a request of the peer's back over the wire.
class RemoteWire::RemoteReply final : public ReplySink {
 public:
  RemoteReply(std::weak_ptr<RemoteWire> wire, std::uint64_t id) : wire_(std::move(wire)), id_(id) {}
  ~RemoteReply() override {
    if (const auto wire = wire_.lock()) wire->forget(id_);
  }

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (answered_.exchange(true) || abandoned()) return;
    const auto wire = wire_.lock();
    if (!wire) return;
    wire::Frame frame = frame_for(wire->wire_);
    auto& answer = *frame.mutable_answer();
    answer.set_id(id_);
    answer.set_outcome(static_cast<std::uint32_t>(outcome));
    answer.set_reason(std::move(reason));
    const std::lock_guard lock(wire->mutex_);
    wire->served_.erase(id_);
    if (!wire->cut_) wire->send_frame(frame, object.get());
  }

  Outcome event(Envelope event) override {
    const auto wire = wire_.lock();
    if (answered_ || abandoned() || !wire) return Outcome::Disconnected;
    CreditQueue::Item item;
    item.frame = frame_for(wire->wire_);
    auto& fired = *item.frame.mutable_fired();
    fired.set_id(id_);
    fired.set_sequence(event.sequence);
    fired.set_origin_ns(event.origin.time_since_epoch().count());
    item.object = std::move(event.object);
    item.bytes = event.bytes + kFrameCost;
    const std::lock_guard lock(wire->mutex_);
    if (wire->cut_) return Outcome::Disconnected;
    return wire->credit_.offer(std::move(item), false, wire->sender()) ? Outcome::Ok : Outcome::Rejected;
  }

 private:
  const std::weak_ptr<RemoteWire> wire_;
  const std::uint64_t id_;
  std::atomic<bool> answered_{false};
};

RemoteWire::RemoteWire(LinkSocket& link, std::string peer, std::uint64_t wire, Port& port)
    : link_(link),
      peer_(std::move(peer)),
      wire_(wire),
      port_(port),
      object_rules_(port.service().object()),
      objects_(prototype_of(port.service().object())),
      answer_rules_(port.service().answer() ? std::optional<ObjectRules>(std::in_place, *port.service().answer())
                                            : std::nullopt),
      answers_(prototype_of(port.service().answer() ? *port.service().answer() : port.service().object())),
      admitted_(port.direction() == PortDirection::Provides) {}

void RemoteWire::open(const std::function<std::uint64_t()>& attach) {
  {
    const std::lock_guard lock(mutex_);
    opening_ = true;
  }
  wire::Frame frame = frame_for(wire_);
  frame.mutable_opened()->set_from_sequence(attach());
  const std::lock_guard lock(mutex_);
  send_frame(frame, nullptr);
  opening_ = false;
  for (auto& parcel : std::exchange(early_, {})) deliver_locked(std::move(parcel));
}

CreditQueue::SendNow RemoteWire::sender() {
  return [this](const CreditQueue::Item& item) { send_frame(item.frame, item.object.get()); };
}

Outcome RemoteWire::deliver(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  if (cut_) return Outcome::Disconnected;
  if (opening_) {
    early_.push_back(std::move(parcel));
    return Outcome::Ok;
  }
  return deliver_locked(std::move(parcel));
}

void RemoteWire::lease(bool held, const std::string& reason) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_lease()->set_held(held);
  frame.mutable_lease()->set_reason(reason);
  const std::lock_guard lock(mutex_);
  if (!cut_) send_frame(frame, nullptr);
}

Outcome RemoteWire::deliver_locked(Parcel parcel) {
  CreditQueue::Item item;
  item.frame.set_wire(wire_);
  item.object = std::move(parcel.envelope.object);
  item.bytes = parcel.envelope.bytes + kFrameCost;
  const auto origin_ns = parcel.envelope.origin.time_since_epoch().count();
  if (parcel.reply) {
    const std::uint64_t id = next_id_++;
    auto& request = *item.frame.mutable_request();
    request.set_id(id);
    request.set_origin_ns(origin_ns);
    request.set_continuous(parcel.continuous);
    parcel.reply->set_on_abandon([weak = weak_from_this(), id] {
      if (const auto wire = weak.lock()) wire->cancel(id);
    });
    open_.emplace(id, std::move(parcel.reply));
    return credit_.offer(std::move(item), false, sender()) ? Outcome::Ok : Outcome::Rejected;
  }
  auto& object = *item.frame.mutable_object();
  object.set_sequence(parcel.envelope.sequence);
  object.set_origin_ns(origin_ns);
  const bool push = is_push(port_);
  const std::uint64_t dropped = credit_.dropped();
  const bool taken = credit_.offer(std::move(item), push, sender());
  port_.counters().dropped.fetch_add(credit_.dropped() - dropped, std::memory_order_relaxed);
  return taken ? Outcome::Ok : Outcome::Rejected;
}

/// The client gave up: the provider is told, so that it need not go on.
void RemoteWire::cancel(std::uint64_t id) {
  std::shared_ptr<ReplySink> given_up;  // let go outside the lock
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(id);
    if (open == open_.end()) return;
    given_up = std::move(open->second);
    open_.erase(open);
    if (cut_) return;
    wire::Frame frame = frame_for(wire_);
    frame.mutable_cancel()->set_id(id);
    send_frame(frame, nullptr);
  }
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::on_frame(const wire::Frame& frame, std::string_view object) {
  {
    const std::lock_guard lock(mutex_);
    if (!admitted_) {
      kept_.emplace_back(frame, object);
      return;
    }
  }
  handle_frame(frame, object);
}

void RemoteWire::admit() {
  // What comes meanwhile is kept behind what is handled here, so that the order stays.
  while (true) {
    std::vector<std::pair<wire::Frame, std::string>> kept;
    {
      const std::lock_guard lock(mutex_);
      kept.swap(kept_);
      admitted_ = kept.empty();
      if (admitted_) return;
    }
    for (const auto& [frame, object] : kept) handle_frame(frame, object);
  }
}

void RemoteWire::drain(std::function<void()> drained) {
  {
    const std::lock_guard lock(mutex_);
    drained_ = std::move(drained);
  }
  if (const auto notice = take_drained()) notice();
}

/// What is to be called, outside the lock, because nothing is open any more.
std::function<void()> RemoteWire::take_drained() {
  const std::lock_guard lock(mutex_);
  return open_.empty() ? std::exchange(drained_, nullptr) : nullptr;
}

void RemoteWire::handle_frame(const wire::Frame& frame, std::string_view object) {
  switch (frame.what_case()) {
    case wire::Frame::kObject:
    case wire::Frame::kRequest: return on_object(frame, object);
    case wire::Frame::kAnswer: return on_answer(frame.answer(), object);
    case wire::Frame::kCredit: {
      const std::lock_guard lock(mutex_);
      if (!cut_) credit_.credit(frame.credit().bytes(), sender());
      return;
    }
    case wire::Frame::kLease: {
      auto* client = dynamic_cast<RequiredPort*>(&port_);
      const std::lock_guard lock(mutex_);
      if (client && !cut_) client->set_lease(frame.lease().held(), frame.lease().reason());
      return;
    }
    case wire::Frame::kFired: return on_fired(frame.fired(), object);
    case wire::Frame::kCancel: {
      std::shared_ptr<ReplySink> given_up;  // let go outside the lock
      const std::lock_guard lock(mutex_);
      const auto served = served_.find(frame.cancel().id());
      if (served == served_.end()) return;
      given_up = served->second.lock();
      served_.erase(served);
      if (given_up) given_up->abandon();
      return;
    }
    default: return;
  }
}

void RemoteWire::forget(std::uint64_t id) {
  const std::lock_guard lock(mutex_);
  served_.erase(id);
}

std::shared_ptr<Object> RemoteWire::parse(ObjectPool& pool, std::string_view object) {
  auto parsed = pool.acquire();
  if (!parsed->ParseFromArray(object.data(), static_cast<int>(object.size()))) return nullptr;
  return parsed;
}

void RemoteWire::on_object(const wire::Frame& frame, std::string_view object) {
  Inbox* inbox = nullptr;
  if (auto* provided = dynamic_cast<ProvidedPort*>(&port_)) inbox = provided->inbox();
  if (auto* required = dynamic_cast<RequiredPort*>(&port_)) inbox = required->inbox();
  const Pattern pattern = port_.service().pattern();
  const bool request = frame.has_request();
  const bool fits = request ? pattern == QUERY || pattern == EVENT || pattern == SEND : pattern != QUERY && pattern != EVENT;
  if (!inbox || !fits) return;
  auto parsed = parse(objects_, object);
  auto refusal = parsed ? object_rules_.first_violation(*parsed) : "the object does not parse";
  Outcome outcome = Outcome::Rejected;
  std::shared_ptr<ReplySink> reply;
  {
    const std::lock_guard lock(mutex_);
    if (cut_) return;
    give_credit(object.size() + kFrameCost);
    if (request) {
      reply = std::make_shared<RemoteReply>(weak_from_this(), frame.request().id());
      served_[frame.request().id()] = reply;
    }
    if (!refusal) {
      const auto origin_ns = request ? frame.request().origin_ns() : frame.object().origin_ns();
      Envelope envelope{std::move(parsed), request ? frame.request().id() : frame.object().sequence(),
                        TimePoint(Duration(origin_ns)), object.size()};
      outcome = inbox->push({std::move(envelope), reply, frame.request().continuous(), 0});
      if (outcome == Outcome::Rejected) refusal = "the provider's queue is full";
    }
  }
  if (outcome == Outcome::Rejected) port_.counters().refused.fetch_add(1, std::memory_order_relaxed);
  // An acknowledged send ends here, as does what was not taken; the rest is the provider's to answer.
  if (reply && (outcome != Outcome::Ok || pattern == SEND)) reply->answer(outcome, refusal.value_or(""), nullptr);
}

void RemoteWire::on_fired(const wire::Fired& fired, std::string_view object) {
  std::shared_ptr<ReplySink> activation;
  {
    const std::lock_guard lock(mutex_);
    if (cut_ || port_.service().pattern() != EVENT) return;
    give_credit(object.size() + kFrameCost);
    const auto open = open_.find(fired.id());
    if (open == open_.end()) return;
    activation = open->second;
  }
  if (fired.sequence() == 0) {
    activation->event({});
    return;
  }
  auto parsed = parse(answers_, object);
  const auto violation = parsed ? answer_rules_->first_violation(*parsed) : "it does not parse";
  if (violation) {
    port_.counters().refused.fetch_add(1, std::memory_order_relaxed);
    return;  // the client sees the gap in the sequence
  }
  const Outcome outcome = activation->event(
      Envelope{std::move(parsed), fired.sequence(), TimePoint(Duration(fired.origin_ns())), object.size()});
  if (outcome == Outcome::Rejected) port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
}

/// Credit goes back in quarters of the window, so that a stream of small messages does not double its traffic.
void RemoteWire::give_credit(std::size_t bytes) {
  owed_credit_ += bytes;
  if (owed_credit_ < kWireWindow / 4) return;
  wire::Frame frame = frame_for(wire_);
  frame.mutable_credit()->set_bytes(std::exchange(owed_credit_, 0));
  send_frame(frame, nullptr);
}

void RemoteWire::on_answer(const wire::Answer& answer, std::string_view object) {
  std::shared_ptr<ReplySink> reply;
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(answer.id());
    if (cut_ || open == open_.end()) return;
    reply = std::move(open->second);
    open_.erase(open);
  }
  auto outcome = static_cast<Outcome>(std::min<std::uint32_t>(answer.outcome(), static_cast<std::uint32_t>(Outcome::Rejected)));
  std::string reason = answer.reason();
  std::shared_ptr<Object> parsed;
  if (outcome == Outcome::Ok && answer_rules_) {
    parsed = parse(answers_, object);
    const auto violation = parsed ? answer_rules_->first_violation(*parsed) : "it does not parse";
    if (violation) {
      outcome = Outcome::Rejected;
      reason = "the answer was refused: " + *violation;
      parsed = nullptr;
    }
  }
  reply->answer(outcome, std::move(reason), std::move(parsed));
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::cut(const std::string& reason) {
  std::unordered_map<std::uint64_t, std::shared_ptr<ReplySink>> open;
  std::vector<std::shared_ptr<ReplySink>> served;
  {
    const std::lock_guard lock(mutex_);
    cut_ = true;
    drained_ = nullptr;
    kept_.clear();
    open.swap(open_);
    for (auto& [id, weak] : served_) {
      if (auto reply = weak.lock()) served.push_back(std::move(reply));
    }
    served_.clear();
  }
  for (auto& [id, reply] : open) reply->answer(Outcome::Disconnected, reason, nullptr);
  for (auto& reply : served) reply->abandon();
}

// ---- links ----------------------------------------------------------------------------------------------------

namespace {

/// Lets every n-th put through to a remote wire; the first is the first after subscribing.
class PrescaledSink final : public Sink {
 public:
  PrescaledSink(std::shared_ptr<Sink> inner, std::uint32_t prescale) : inner_(std::move(inner)), prescale_(prescale) {}
  Outcome deliver(Parcel parcel) override {
    if (puts_.fetch_add(1, std::memory_order_relaxed) % prescale_ != 0) return Outcome::Ok;
    return inner_->deliver(std::move(parcel));
  }
  void lease(bool held, const std::string& reason) override { inner_->lease(held, reason); }

 private:
  const std::shared_ptr<Sink> inner_;
  const std::uint32_t prescale_;
  std::atomic<std::uint64_t> puts_{0};
};

}  // namespace

Links::Links(Pool& pool, std::string endpoint, OnLost on_lost)
    : pool_(pool), endpoint_(std::move(endpoint)), on_lost_(std::move(on_lost)) {
  server_ = std::make_unique<LinkSocket>(pool_, context_, zmq::socket_type::router,
                                         [this](const std::string& peer, const wire::Frame& frame,
                                                std::string_view object) { on_server_frame(peer, frame, object); });
  server_->socket().set(zmq::sockopt::router_mandatory, 1);
  server_->socket().bind(endpoint_);
  server_->start();
}

Links::~Links() { stop(); }

void Links::stop() {
  server_->stop();
  for (auto& [endpoint, peer] : peers_) peer.link->stop();
}

void Links::provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  grants_[wire] = Grant{std::move(token), &provider, std::max(1U, prescale), nullptr, nullptr};
}

LinkSocket& Links::connect(const std::string& endpoint) {
  auto& peer = peers_[endpoint];
  if (!peer.link) {
    peer.link = std::make_unique<LinkSocket>(
        pool_, context_, zmq::socket_type::dealer,
        [this](const std::string&, const wire::Frame& frame, std::string_view object) { on_client_frame(frame, object); });
    peer.link->socket().connect(endpoint);
    peer.link->start();
  }
  return *peer.link;
}

void Links::require(std::uint64_t wire_id, const std::string& token, RequiredPort& client,
                    const std::string& provider_name, const std::string& endpoint,
                    const std::function<void()>& switch_over) {
  std::unique_lock lock(mutex_);
  LinkSocket& link = connect(endpoint);
  const auto wire = std::make_shared<RemoteWire>(link, "", wire_id, client);
  requirements_[wire_id] = Requirement{&client, endpoint, provider_name, wire, std::nullopt, false};
  lock.unlock();
  // A client that is being rewired stays connected, with its last value, until the new provider has answered.
  const bool first = client.connection() != Connection::Connected;
  if (first) client.set_connection(Connection::Waiting, "opening the wire to " + provider_name);
  wire::Frame frame = frame_for(wire_id);
  frame.mutable_open()->set_version(wire::VERSION_1);
  frame.mutable_open()->set_wire(wire_id);
  frame.mutable_open()->set_token(token);
  link.send("", frame, nullptr);

  lock.lock();
  const auto has_answer = [&] {
    const auto found = requirements_.find(wire_id);
    return found == requirements_.end() || found->second.refusal;
  };
  answered_.wait_for(lock, kDefaultDeadline, has_answer);
  const auto found = requirements_.find(wire_id);
  const std::string refusal = found == requirements_.end() ? "its process is gone"
                                                           : found->second.refusal.value_or("its process does not answer");
  if (refusal.empty()) {
    lock.unlock();
    if (switch_over) switch_over();
    client.set_target(wire);
    client.set_connection(Connection::Connected, provider_name);
    return wire->admit();
  }
  if (found != requirements_.end()) requirements_.erase(found);
  lock.unlock();
  wire->cut(refusal);
  if (first) client.set_connection(Connection::Unwired, refusal);
  throw Error(ErrorCode::Unreachable, {.what = "the wire to " + provider_name + " did not open: " + refusal,
                                       .where = client.full_name(),
                                       .next = "ls hosts"});
}

void Links::refuse(const std::string& peer, std::uint64_t wire, const std::string& reason) {
  wire::Frame frame = frame_for(wire);
  frame.mutable_refused()->set_reason(reason);
  server_->send(peer, frame, nullptr);
}

void Links::open_for(const std::string& peer, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto grant = grants_.find(frame.wire());
  if (frame.open().version() != wire::VERSION_1) return refuse(peer, frame.wire(), "unknown protocol version");
  if (grant == grants_.end() || grant->second.token != frame.open().token() || grant->second.wire) {
    return refuse(peer, frame.wire(), "the wire was not granted");
  }
  Grant& granted = grant->second;
  granted.wire = std::make_shared<RemoteWire>(*server_, peer, frame.wire(), *granted.provider);
  auto* push = dynamic_cast<detail::PushProvider*>(granted.provider);
  if (push) granted.sink = std::make_shared<PrescaledSink>(granted.wire, granted.prescale);
  granted.wire->open([&] { return push ? push->attach(granted.sink) : 0; });
}

void Links::on_server_frame(const std::string& peer, const wire::Frame& frame, std::string_view object) {
  if (frame.has_open()) return open_for(peer, frame);
  std::shared_ptr<RemoteWire> wire;
  {
    const std::lock_guard lock(mutex_);
    const auto grant = grants_.find(frame.wire());
    // A frame for a wire that was not granted to this peer is dropped.
    if (grant == grants_.end() || !grant->second.wire || grant->second.wire->peer() != peer) return;
    wire = grant->second.wire;
  }
  if (frame.has_closed()) return cut(frame.wire(), frame.closed().reason());
  wire->on_frame(frame, object);
}

void Links::on_client_frame(const wire::Frame& frame, std::string_view object) {
  std::shared_ptr<RemoteWire> wire;
  RequiredPort* client = nullptr;
  bool retired = false;
  {
    const std::lock_guard lock(mutex_);
    const auto requirement = requirements_.find(frame.wire());
    if (requirement == requirements_.end()) return;
    wire = requirement->second.wire;
    client = requirement->second.client;
    retired = requirement->second.retired;
  }
  if (frame.has_opened()) return note_answer(frame.wire(), "");
  if (frame.has_refused()) return note_answer(frame.wire(), frame.refused().reason());
  if (frame.has_closed()) {
    wire->cut(frame.closed().reason());
    if (retired) return;
    client->set_target(nullptr);
    client->set_connection(Connection::Lost, frame.closed().reason());
    return on_lost_(frame.wire(), frame.closed().reason());
  }
  wire->on_frame(frame, object);
}

void Links::note_answer(std::uint64_t wire_id, const std::string& refusal) {
  const std::lock_guard lock(mutex_);
  const auto found = requirements_.find(wire_id);
  if (found == requirements_.end() || found->second.refusal) return;
  found->second.refusal = refusal;
  answered_.notify_all();
}

void Links::cut(std::uint64_t wire_id, const std::string& reason) {
  std::unique_lock lock(mutex_);
  if (const auto found = grants_.find(wire_id); found != grants_.end()) {
    const Grant grant = std::move(found->second);
    grants_.erase(found);
    lock.unlock();
    return end(wire_id, grant, reason);
  }
  const auto found = requirements_.find(wire_id);
  if (found == requirements_.end()) return;
  const Requirement requirement = std::move(found->second);
  requirements_.erase(found);
  lock.unlock();
  end(wire_id, requirement, reason);
  if (requirement.retired) return;
  requirement.client->set_target(nullptr);
  requirement.client->set_connection(Connection::Unwired, reason);
}

void Links::end(std::uint64_t wire_id, const Grant& grant, const std::string& reason) {
  auto* push = dynamic_cast<detail::PushProvider*>(grant.provider);
  if (push && grant.sink) push->detach(*grant.sink);
  if (!grant.wire) return;
  grant.wire->cut(reason);
  wire::Frame frame = frame_for(wire_id);
  frame.mutable_closed()->set_reason(reason);
  server_->send(grant.wire->peer(), frame, nullptr);
}

void Links::end(std::uint64_t wire_id, const Requirement& requirement, const std::string& reason) {
  requirement.wire->cut(reason);
  wire::Frame frame = frame_for(wire_id);
  frame.mutable_closed()->set_reason(reason);
  const std::lock_guard lock(mutex_);
  const auto peer = peers_.find(requirement.endpoint);
  if (peer != peers_.end()) peer->second.link->send("", frame, nullptr);
}

void Links::retire(std::uint64_t wire_id) {
  std::shared_ptr<RemoteWire> wire;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end()) return;
    found->second.retired = true;
    wire = found->second.wire;
  }
  if (is_push(wire->port())) return cut(wire_id, "another provider has taken its place");
  wire->drain([this, wire_id] { cut(wire_id, "another provider has taken its place"); });
}

void Links::release(const Hull& hull) {
  std::vector<std::uint64_t> left;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, grant] : grants_) {
      if (&grant.provider->hull() == &hull) left.push_back(id);
    }
    for (const auto& [id, requirement] : requirements_) {
      if (&requirement.client->hull() == &hull) left.push_back(id);
    }
  }
  for (const std::uint64_t id : left) cut(id, "'" + hull.name() + "' has ended");
}

void Links::peer_lost(const std::string& endpoint, const std::string& reason) {
  std::vector<std::pair<std::uint64_t, Requirement>> lost;
  std::unique_ptr<LinkSocket> link;
  {
    const std::lock_guard lock(mutex_);
    for (auto it = requirements_.begin(); it != requirements_.end();) {
      if (it->second.endpoint == endpoint) {
        lost.emplace_back(it->first, std::move(it->second));
        it = requirements_.erase(it);
      } else {
        ++it;
      }
    }
    if (const auto peer = peers_.find(endpoint); peer != peers_.end()) {
      link = std::move(peer->second.link);
      peers_.erase(peer);
    }
  }
  answered_.notify_all();
  for (auto& [wire, requirement] : lost) {
    requirement.wire->cut(reason);
    if (requirement.retired) continue;
    requirement.client->set_target(nullptr);
    requirement.client->set_connection(Connection::Lost, reason);
  }
  if (link) link->stop();
  // A RemoteWire may still be referenced by a sink list for a moment; it is cut, and no longer touches the link.
  for (auto& [wire, requirement] : lost) {
    if (!requirement.retired) on_lost_(wire, reason);
  }
}

}  // namespace fiona::host
