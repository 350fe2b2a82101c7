#include "links.hpp"

#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/push.hpp"

namespace fiona::host {
namespace {

/// Wires that have ended are remembered, so that what was under way is not taken for a stranger's.
constexpr std::size_t kEndedKept = 256;

}  // namespace

class Links::Server final : public LinkSocket::Receiver {
 public:
  explicit Server(Links& links) : links_(links) {}
  bool accepts(const std::string& peer, const wire::Frame& frame) override { return links_.server_accepts(peer, frame); }
  void on_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes& object) override {
    links_.on_server_frame(peer, frame, object);
  }
  void on_refused(const std::string&) override {}

 private:
  Links& links_;
};

class Links::Client final : public LinkSocket::Receiver {
 public:
  Client(Links& links, std::string endpoint) : links_(links), endpoint_(std::move(endpoint)) {}
  bool accepts(const std::string&, const wire::Frame& frame) override { return links_.client_accepts(endpoint_, frame); }
  void on_frame(const std::string&, const wire::Frame& frame, const ObjectBytes& object) override {
    links_.on_client_frame(endpoint_, frame, object);
  }
  void on_refused(const std::string& reason) override { links_.on_client_refused(endpoint_, reason); }

 private:
  Links& links_;
  const std::string endpoint_;
};

Links::Peer::Peer() = default;
Links::Peer::~Peer() = default;
Links::Peer::Peer(Peer&&) noexcept = default;
Links::Peer& Links::Peer::operator=(Peer&&) noexcept = default;

Links::Links(Pool& pool, Clock& clock, std::string endpoint, std::string key, OnLost on_lost)
    : pool_(pool),
      clock_(dynamic_cast<VirtualClock*>(&clock)),
      endpoint_(std::move(endpoint)),
      on_lost_(std::move(on_lost)),
      receiver_(std::make_unique<Server>(*this)) {
  server_ = std::make_unique<LinkSocket>(pool_, context_, zmq::socket_type::router, counters_, *receiver_, on_dealt_with());
  server_->listen(endpoint_, std::move(key));
}

Links::~Links() { stop(); }

void Links::stop() {
  server_->stop();
  for (auto& [endpoint, peer] : peers_) peer.link->stop();
}

control::LinkStatus Links::status() {
  control::LinkStatus status = counters_.status();
  const std::lock_guard lock(mutex_);
  std::size_t peers = server_->peers();
  for (auto& [endpoint, peer] : peers_) peers += peer.link->peers();
  status.set_peers(peers);
  return status;
}

std::function<void()> Links::on_dealt_with() const {
  if (!clock_) return nullptr;
  return [clock = clock_] { clock->reconsider(); };
}

std::map<std::string, FrameCounts> Links::frame_counts() {
  const std::lock_guard lock(mutex_);
  auto all = server_->frame_counts();
  for (const auto& [endpoint, peer] : peers_) {
    const FrameCounts ours = peer.link->frame_counts()[""];
    all[endpoint].sent += ours.sent;
    all[endpoint].received += ours.received;
  }
  return all;
}

void Links::provide(std::uint64_t wire, std::string token, std::string peer, ProvidedPort& provider, std::uint32_t prescale,
                    std::string client_name) {
  const std::lock_guard lock(mutex_);
  grants_[wire] = Grant{std::move(token), std::move(peer), &provider, std::max(1U, prescale), std::move(client_name), nullptr};
}

LinkSocket& Links::connect(const Endpoint& endpoint) {
  auto& peer = peers_[endpoint.address];
  if (!peer.link) {
    peer.client = std::make_unique<Client>(*this, endpoint.address);
    peer.link = std::make_unique<LinkSocket>(pool_, context_, zmq::socket_type::dealer, counters_, *peer.client, on_dealt_with());
    peer.link->connect(endpoint.address, endpoint.name, endpoint.key);
  }
  return *peer.link;
}

void Links::require(std::uint64_t wire_id, const std::string& token, RequiredPort& client,
                    const std::string& provider_name, const Endpoint& endpoint,
                    const std::function<void()>& switch_over) {
  std::unique_lock lock(mutex_);
  LinkSocket& link = connect(endpoint);
  const auto wire = std::make_shared<RemoteWire>(link, "", wire_id, client, client.full_name() + "<" + provider_name);
  requirements_[wire_id] = Requirement{&client, endpoint.address, provider_name, wire, std::nullopt, false};
  // A client that is being rewired stays connected, with its last value, until the new provider has answered.
  const bool first = client.connection() != Connection::Connected;
  if (first) client.set_connection(Connection::Waiting, "opening the wire to " + provider_name);
  wire->ask(token);

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
    // The new one first: a request that is being made has somewhere to go at every moment.
    client.set_target(wire);
    if (switch_over) switch_over();
    client.set_connection(Connection::Connected, provider_name);
    return wire->admit();
  }
  if (found != requirements_.end()) requirements_.erase(found);
  note_ended(wire_id);
  lock.unlock();
  wire->cut(refusal);
  if (first) client.set_connection(Connection::Unwired, refusal);
  throw Error(ErrorCode::Unreachable, {.what = "the wire to " + provider_name + " did not open: " + refusal,
                                       .where = client.full_name(),
                                       .next = "ls hosts"});
}

void Links::refuse(const std::string& peer, std::uint64_t wire, const std::string& reason) {
  ++counters_.not_granted;
  wire::Frame frame = frame_for(wire);
  frame.mutable_refused()->set_reason(reason);
  server_->tell(peer, frame);
}

void Links::open_for(const std::string& peer, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto grant = grants_.find(frame.wire());
  if (frame.open().version() != wire::VERSION_1) return refuse(peer, frame.wire(), "unknown protocol version");
  if (grant == grants_.end() || grant->second.token != frame.open().token() || grant->second.wire ||
      grant->second.peer != server_->process_of(peer)) {
    return refuse(peer, frame.wire(), "the wire was not granted");
  }
  Grant& granted = grant->second;
  granted.wire = wire_for(peer, frame.wire(), granted);
  granted.wire->open(granted.prescale);
}

/// The provider's end of a wire; those of a push port to the same process share what crosses.
std::shared_ptr<RemoteWire> Links::wire_for(const std::string& peer, std::uint64_t wire, const Grant& grant) {
  ProvidedPort& provider = *grant.provider;
  const std::string name = grant.client_name + "<" + provider.full_name();
  auto* push = dynamic_cast<detail::PushProvider*>(&provider);
  if (!push) return std::make_shared<RemoteWire>(*server_, peer, wire, provider, name);
  auto& known = fan_outs_[{peer, &provider}];
  auto fan_out = known.lock();
  if (!fan_out) {
    fan_out = std::make_shared<FanOut>(*server_, server_->open_lane(peer), *push);
    known = fan_out;
    std::erase_if(fan_outs_, [](const auto& entry) { return entry.second.expired(); });
  }
  return std::make_shared<RemoteWire>(std::move(fan_out), *server_, peer, wire, provider, name);
}

// ---- frames ---------------------------------------------------------------------------------------------------

/// Called with the mutex held.
void Links::note_ended(std::uint64_t wire) {
  if (ended_.size() == kEndedKept) ended_.pop_front();
  ended_.push_back(wire);
}

/// A frame for a wire that this peer does not have is dropped, and counted unless the wire has ended just now.
void Links::note_foreign(std::uint64_t wire) {
  if (std::find(ended_.rbegin(), ended_.rend(), wire) == ended_.rend()) ++counters_.not_granted;
}

std::shared_ptr<RemoteWire> Links::granted(const std::string& peer, std::uint64_t wire) {
  const std::lock_guard lock(mutex_);
  const auto grant = grants_.find(wire);
  if (grant != grants_.end() && grant->second.wire && grant->second.wire->peer() == peer) return grant->second.wire;
  note_foreign(wire);
  return nullptr;
}

std::shared_ptr<RemoteWire> Links::required(const std::string& endpoint, std::uint64_t wire) {
  const std::lock_guard lock(mutex_);
  const auto requirement = requirements_.find(wire);
  if (requirement != requirements_.end() && requirement->second.endpoint == endpoint) return requirement->second.wire;
  note_foreign(wire);
  return nullptr;
}

bool Links::server_accepts(const std::string& peer, const wire::Frame& frame) {
  return granted(peer, frame.wire()) != nullptr;
}

void Links::on_server_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes& object) {
  if (frame.has_open()) return open_for(peer, frame);
  const auto wire = granted(peer, frame.wire());
  if (!wire) return;
  if (frame.has_closed()) return cut(frame.wire(), frame.closed().reason());
  wire->on_frame(frame, object);
}

bool Links::client_accepts(const std::string& endpoint, const wire::Frame& frame) {
  if (required(endpoint, frame.wire())) return true;
  return std::any_of(frame.also().begin(), frame.also().end(),
                     [&](std::uint64_t wire) { return required(endpoint, wire) != nullptr; });
}

void Links::on_client_frame(const std::string& endpoint, const wire::Frame& frame, const ObjectBytes& object) {
  auto wire = required(endpoint, frame.wire());
  if (wire && frame.has_opened()) return note_answer(frame.wire(), "");
  if (wire && frame.has_refused()) return note_answer(frame.wire(), frame.refused().reason());
  if (wire && frame.has_closed()) return on_closed(frame.wire(), frame.closed().reason());
  if (frame.also().empty() || !frame.has_object()) {
    if (wire) wire->on_frame(frame, object);
    for (const std::uint64_t other : frame.also()) {
      if ((wire = required(endpoint, other))) wire->on_frame(frame, object);
    }
    return;
  }
  // One crossing, one parse, for all the subscribers here.
  std::optional<ParsedObject> parsed;
  const auto take = [&](const std::shared_ptr<RemoteWire>& one) {
    if (!one) return;
    if (!parsed) parsed = one->parse_object(object);
    one->on_object(frame, *parsed);
  };
  take(wire);
  for (const std::uint64_t other : frame.also()) take(required(endpoint, other));
}

/// The provider has ended the wire.
void Links::on_closed(std::uint64_t wire_id, const std::string& reason) {
  std::shared_ptr<RemoteWire> wire;
  RequiredPort* client = nullptr;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end()) return;
    wire = found->second.wire;
    if (!found->second.retired) client = found->second.client;
  }
  wire->cut(reason);
  if (!client) return;
  client->set_target(nullptr);
  client->set_connection(Connection::Lost, reason);
  on_lost_(wire_id, reason);
}

void Links::on_client_refused(const std::string& endpoint, const std::string& reason) {
  std::vector<std::uint64_t> waiting;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [wire, requirement] : requirements_) {
      if (requirement.endpoint == endpoint) waiting.push_back(wire);
    }
  }
  for (const std::uint64_t wire : waiting) note_answer(wire, reason);
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
    const auto wire = found->second.wire;
    grants_.erase(found);
    note_ended(wire_id);
    lock.unlock();
    if (wire) wire->cut(reason, true);
    return;
  }
  const auto found = requirements_.find(wire_id);
  if (found == requirements_.end()) return;
  const Requirement requirement = std::move(found->second);
  requirements_.erase(found);
  note_ended(wire_id);
  lock.unlock();
  requirement.wire->cut(reason, true);
  if (requirement.retired) return;
  requirement.client->set_target(nullptr);
  requirement.client->set_connection(Connection::Unwired, reason);
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

void Links::peer_lost(const std::string& endpoint, const std::string& name, const std::string& reason) {
  std::vector<std::pair<std::uint64_t, Requirement>> lost;
  std::vector<std::shared_ptr<RemoteWire>> served;
  Peer gone;
  {
    const std::lock_guard lock(mutex_);
    for (auto it = requirements_.begin(); it != requirements_.end();) {
      const bool ours = it->second.endpoint == endpoint;
      if (ours) note_ended(it->first);
      if (ours) lost.emplace_back(it->first, std::move(it->second));
      it = ours ? requirements_.erase(it) : std::next(it);
    }
    for (auto it = grants_.begin(); it != grants_.end();) {
      const bool ours = it->second.peer == name;
      if (ours && it->second.wire) served.push_back(std::move(it->second.wire));
      it = ours ? grants_.erase(it) : std::next(it);
    }
    if (const auto peer = peers_.find(endpoint); peer != peers_.end()) {
      gone = std::move(peer->second);
      peers_.erase(peer);
    }
  }
  answered_.notify_all();
  for (const auto& wire : served) wire->cut(reason);
  server_->forget(name);
  for (auto& [wire, requirement] : lost) {
    requirement.wire->cut(reason);
    if (requirement.retired) continue;
    requirement.client->set_target(nullptr);
    requirement.client->set_connection(Connection::Lost, reason);
  }
  if (gone.link) gone.link->stop();
  // A RemoteWire may still be referenced by a sink list for a moment; it is cut, and no longer touches the link.
  for (auto& [wire, requirement] : lost) {
    if (!requirement.retired) on_lost_(wire, reason);
  }
}

}  // namespace fiona::host
