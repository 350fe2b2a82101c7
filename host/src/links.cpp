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

Links::Links(Pool& pool, Clock& clock, std::string endpoint, OnLost on_lost)
    : pool_(pool),
      clock_(dynamic_cast<VirtualClock*>(&clock)),
      endpoint_(std::move(endpoint)),
      on_lost_(std::move(on_lost)) {
  server_ = std::make_unique<LinkSocket>(pool_, context_, zmq::socket_type::router,
                                         [this](const std::string& peer, const wire::Frame& frame,
                                                std::string_view object) { on_server_frame(peer, frame, object); },
                                         on_counted());
  server_->socket().set(zmq::sockopt::router_mandatory, 1);
  server_->socket().set(zmq::sockopt::router_handover, clock_ ? 1 : 0);
  server_->socket().bind(endpoint_);
  server_->start();
}

Links::~Links() { stop(); }

void Links::stop() {
  server_->stop();
  for (auto& [endpoint, peer] : peers_) peer.link->stop();
}

std::function<void()> Links::on_counted() const {
  if (!clock_) return nullptr;
  return [clock = clock_] { clock->reconsider(); };
}

std::map<std::string, FrameCounts> Links::frame_counts() {
  const std::lock_guard lock(mutex_);
  auto all = server_->counts();
  for (const auto& [endpoint, peer] : peers_) {
    const FrameCounts ours = peer.link->counts()[""];
    all[endpoint].sent += ours.sent;
    all[endpoint].received += ours.received;
  }
  return all;
}

void Links::provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale,
                    std::string client_name) {
  const std::lock_guard lock(mutex_);
  grants_[wire] = Grant{std::move(token), &provider, std::max(1U, prescale), std::move(client_name), nullptr, nullptr};
}

LinkSocket& Links::connect(const std::string& endpoint) {
  auto& peer = peers_[endpoint];
  if (!peer.link) {
    peer.link = std::make_unique<LinkSocket>(
        pool_, context_, zmq::socket_type::dealer,
        [this](const std::string&, const wire::Frame& frame, std::string_view object) { on_client_frame(frame, object); },
        on_counted());
    // Named, so that what is counted at both ends can be compared.
    if (clock_) peer.link->socket().set(zmq::sockopt::routing_id, endpoint_);
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
  const auto wire = std::make_shared<RemoteWire>(link, "", wire_id, client, client.full_name() + "<" + provider_name);
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
  granted.wire = std::make_shared<RemoteWire>(*server_, peer, frame.wire(), *granted.provider,
                                              granted.client_name + "<" + granted.provider->full_name());
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
