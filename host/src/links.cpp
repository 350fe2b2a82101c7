#include "links.hpp"

#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/push.hpp"

namespace fiona::host {
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
                                         [this](const std::string& peer, const wire::Frame& frame, std::string_view object) {
                                           on_frame({server_.get(), peer}, frame, object);
                                         });
  server_->socket().set(zmq::sockopt::router_mandatory, 1);
  server_->socket().bind(endpoint_);
  server_->start();
}

Links::~Links() { stop(); }

void Links::stop() {
  server_->stop();
  for (auto& [endpoint, peer] : peers_) {
    if (peer.link) peer.link->stop();
  }
}

void Links::provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  grants_[wire] = Grant{std::move(token), &provider, std::max(1U, prescale), nullptr, nullptr, {}};
}

/// Called with the lock held. Throws Error Unreachable for a host that is not connected.
Hop Links::connect(const std::string& endpoint) {
  auto found = peers_.find(endpoint);
  if (found != peers_.end()) return found->second.hop;
  if (endpoint.starts_with("host:")) {
    throw Error(ErrorCode::Unreachable, {.what = "the other host is not connected", .where = endpoint, .next = "ls hosts"});
  }
  Peer& peer = peers_[endpoint];
  const auto hop = std::make_shared<Hop>();  // the link's, which may outlive the entry for a moment
  peer.link = std::make_unique<LinkSocket>(
      pool_, context_, zmq::socket_type::dealer,
      [this, hop](const std::string&, const wire::Frame& frame, std::string_view object) { on_frame(*hop, frame, object); });
  peer.hop = *hop = {peer.link.get(), ""};
  peer.link->socket().connect(endpoint);
  peer.link->start();
  return peer.hop;
}

void Links::require(std::uint64_t wire_id, const std::string& token, RequiredPort& client,
                    const std::string& provider_name, const std::string& endpoint, std::uint64_t replaces,
                    std::uint32_t resumes_every, const std::function<void()>& switch_over) {
  std::unique_lock lock(mutex_);
  const Hop hop = connect(endpoint);
  const auto wire = std::make_shared<RemoteWire>(*hop.link, hop.peer, wire_id, client);
  requirements_[wire_id] = Requirement{&client, endpoint, provider_name, hop, wire, std::nullopt, 0, false, false};
  // A client that is being rewired stays connected, with its last value, until the new provider has answered.
  const Connection before = client.connection();
  const bool first = before != Connection::Connected;
  if (first) client.set_connection(Connection::Waiting, "opening the wire to " + provider_name);
  wire::Frame frame = frame_for(wire_id);
  frame.mutable_open()->set_version(wire::VERSION_1);
  frame.mutable_open()->set_wire(wire_id);
  frame.mutable_open()->set_token(token);
  hop.link->send(hop.peer, frame, nullptr);

  const auto has_answer = [&] {
    const auto found = requirements_.find(wire_id);
    return found == requirements_.end() || found->second.lost || found->second.refusal;
  };
  answered_.wait_for(lock, kDefaultDeadline, has_answer);
  const auto found = requirements_.find(wire_id);
  const bool gone = found == requirements_.end() || found->second.lost;
  const std::string refusal = gone ? "its process is gone" : found->second.refusal.value_or("its process does not answer");
  if (refusal.empty()) {
    lock.unlock();
    if (resumes_every > 0) count_missed(wire_id, replaces, resumes_every);
    if (switch_over) switch_over();
    client.set_target(wire);
    client.set_connection(Connection::Connected, provider_name);
    return wire->admit();
  }
  if (found != requirements_.end()) requirements_.erase(found);
  lock.unlock();
  wire->cut(refusal);
  if (first) client.set_connection(before == Connection::Lost ? Connection::Lost : Connection::Unwired, refusal);
  throw Error(ErrorCode::Unreachable, {.what = "the wire to " + provider_name + " did not open: " + refusal,
                                       .where = client.full_name(),
                                       .next = "ls hosts"});
}

/// What the provider has put between the last message over the wire that was lost and the first over this one.
void Links::count_missed(std::uint64_t wire, std::uint64_t replaces, std::uint32_t every) {
  const std::lock_guard lock(mutex_);
  const auto now = requirements_.find(wire);
  const auto before = requirements_.find(replaces);
  if (now == requirements_.end() || before == requirements_.end() || !is_push(*now->second.client)) return;
  const std::uint64_t last = std::max(before->second.from_sequence, before->second.wire->last_sequence());
  if (now->second.from_sequence <= last) return;
  now->second.client->counters().dropped.fetch_add((now->second.from_sequence - last) / every, std::memory_order_relaxed);
}

void Links::relay(std::uint64_t wire, std::string token, const std::string& endpoint) {
  const std::lock_guard lock(mutex_);
  relays_[wire] = Relay{std::move(token), endpoint, {}, {}};
}

/// [in on_frame of the peer's link, which therefore lives]
void Links::refuse(const Hop& peer, std::uint64_t wire, const std::string& reason) {
  wire::Frame frame = frame_for(wire);
  frame.mutable_refused()->set_reason(reason);
  peer.link->send(peer.peer, frame, nullptr);
}

void Links::open_for(const Hop& from, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  if (frame.open().version() != wire::VERSION_1) return refuse(from, frame.wire(), "unknown protocol version");
  if (const auto relay = relays_.find(frame.wire()); relay != relays_.end()) return open_relay(from, frame, relay->second);
  const auto grant = grants_.find(frame.wire());
  if (grant == grants_.end() || grant->second.token != frame.open().token() || grant->second.wire) {
    return refuse(from, frame.wire(), "the wire was not granted");
  }
  Grant& granted = grant->second;
  granted.client = from;
  granted.wire = std::make_shared<RemoteWire>(*from.link, from.peer, frame.wire(), *granted.provider);
  auto* push = dynamic_cast<detail::PushProvider*>(granted.provider);
  if (push) granted.sink = std::make_shared<PrescaledSink>(granted.wire, granted.prescale);
  granted.wire->open([&] { return push ? push->attach(granted.sink) : 0; });
}

void Links::open_relay(const Hop& from, const wire::Frame& frame, Relay& relay) {
  if (relay.token != frame.open().token() || relay.client.link) return refuse(from, frame.wire(), "the wire was not granted");
  try {
    relay.provider = connect(relay.endpoint);
  } catch (const Error& error) {
    return refuse(from, frame.wire(), error.text().what);
  }
  relay.client = from;
  relay.provider.link->forward(relay.provider.peer, frame, {});
}

/// Whether the frame is of a wire that is passed on here. Its two ends may use it, each towards the other.
bool Links::relayed(const Hop& from, const wire::Frame& frame, std::string_view object) {
  const std::lock_guard lock(mutex_);
  const auto found = relays_.find(frame.wire());
  if (found == relays_.end()) return false;
  const auto& [token, endpoint, client, provider] = found->second;
  if (!client.link || (from != client && from != provider)) return true;
  const Hop& to = from == client ? provider : client;
  to.link->forward(to.peer, frame, object);
  if (frame.has_closed() || frame.has_refused()) relays_.erase(found);
  return true;
}

void Links::on_frame(const Hop& from, const wire::Frame& frame, std::string_view object) {
  if (frame.has_open()) return open_for(from, frame);
  if (relayed(from, frame, object)) return;
  std::shared_ptr<RemoteWire> wire;
  bool is_client = false;
  {
    // A frame for a wire that was not granted to this peer is dropped.
    const std::lock_guard lock(mutex_);
    const auto requirement = requirements_.find(frame.wire());
    is_client = requirement != requirements_.end() && requirement->second.provider == from;
    const auto grant = grants_.find(frame.wire());
    if (!is_client && grant != grants_.end() && grant->second.client == from) wire = grant->second.wire;
  }
  if (is_client) return on_client_frame(frame, object);
  if (!wire) return;
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
    if (requirement == requirements_.end() || requirement->second.lost) return;
    wire = requirement->second.wire;
    client = requirement->second.client;
    retired = requirement->second.retired;
    if (frame.has_closed()) requirement->second.lost = true;
  }
  if (frame.has_opened()) return note_answer(frame.wire(), "", frame.opened().from_sequence());
  if (frame.has_refused()) return note_answer(frame.wire(), frame.refused().reason(), 0);
  if (frame.has_closed()) {
    answered_.notify_all();
    wire->cut(frame.closed().reason());
    if (retired) return;
    client->set_target(nullptr);
    client->set_connection(Connection::Lost, frame.closed().reason());
    return on_lost_(frame.wire(), frame.closed().reason());
  }
  wire->on_frame(frame, object);
}

void Links::note_answer(std::uint64_t wire_id, const std::string& refusal, std::uint64_t from_sequence) {
  const std::lock_guard lock(mutex_);
  const auto found = requirements_.find(wire_id);
  if (found == requirements_.end() || found->second.refusal) return;
  found->second.refusal = refusal;
  found->second.from_sequence = from_sequence;
  answered_.notify_all();
}

void Links::cut(std::uint64_t wire_id, const std::string& reason) {
  std::unique_lock lock(mutex_);
  if (const auto relay = relays_.find(wire_id); relay != relays_.end()) {
    const Relay ending = std::move(relay->second);
    relays_.erase(relay);
    lock.unlock();
    tell_closed(ending.client, wire_id, reason);
    return tell_closed(ending.provider, wire_id, reason);
  }
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
  tell_closed(grant.client, wire_id, reason);
}

void Links::end(std::uint64_t wire_id, const Requirement& requirement, const std::string& reason) {
  requirement.wire->cut(reason);
  if (!requirement.lost) tell_closed(requirement.provider, wire_id, reason);
}

/// Unless the peer's link is gone, or never was.
void Links::tell_closed(const Hop& peer, std::uint64_t wire_id, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  const bool alive = peer.link == server_.get() || std::any_of(peers_.begin(), peers_.end(), [&peer](const auto& entry) {
                       return entry.second.hop == peer;
                     });
  if (!peer.link || !alive) return;
  wire::Frame frame = frame_for(wire_id);
  frame.mutable_closed()->set_reason(reason);
  peer.link->send(peer.peer, frame, nullptr);
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

void Links::join(const std::string& endpoint, Hop hop) {
  const std::lock_guard lock(mutex_);
  peers_[endpoint] = Peer{nullptr, std::move(hop)};
}

void Links::lose_relays(const Hop& gone, const std::string& reason) {
  for (auto it = relays_.begin(); it != relays_.end();) {
    auto& [wire, relay] = *it;
    const bool provider_gone = relay.provider == gone;
    if (!provider_gone && relay.client != gone) {
      ++it;
      continue;
    }
    const Hop& left = provider_gone ? relay.client : relay.provider;
    wire::Frame frame = frame_for(wire);
    frame.mutable_closed()->set_reason(reason);
    left.link->send(left.peer, frame, nullptr);
    it = relays_.erase(it);
  }
}

void Links::part(const std::string& endpoint, const std::string& reason) {
  std::vector<std::pair<std::uint64_t, Requirement>> lost;
  std::vector<std::pair<std::uint64_t, Grant>> deserted;
  Peer gone;
  {
    const std::lock_guard lock(mutex_);
    const auto peer = peers_.find(endpoint);
    if (peer == peers_.end()) return;
    gone = std::move(peer->second);
    peers_.erase(peer);
    for (auto& [id, requirement] : requirements_) {
      if (requirement.provider != gone.hop || std::exchange(requirement.lost, true)) continue;
      lost.emplace_back(id, requirement);
    }
    std::erase_if(requirements_, [](const auto& entry) { return entry.second.lost && entry.second.retired; });
    for (auto it = grants_.begin(); it != grants_.end();) {
      const bool used = it->second.wire && it->second.client == gone.hop;
      if (used) deserted.emplace_back(it->first, std::move(it->second));
      it = used ? grants_.erase(it) : std::next(it);
    }
    lose_relays(gone.hop, reason);
  }
  answered_.notify_all();
  for (auto& [wire, grant] : deserted) end(wire, grant, reason);
  for (auto& [wire, requirement] : lost) {
    requirement.wire->cut(reason);
    if (requirement.retired || requirement.refusal != "") continue;
    requirement.client->set_target(nullptr);
    requirement.client->set_connection(Connection::Lost, reason);
  }
  if (gone.link) gone.link->stop();
  // A RemoteWire may still be referenced by a sink list for a moment; it is cut, and no longer touches the link.
  for (auto& [wire, requirement] : lost) {
    if (!requirement.retired && requirement.refusal == "") on_lost_(wire, reason);
  }
}

}  // namespace fiona::host
