#include "links.hpp"

#include <algorithm>

#include "clock_offset.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/push.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

/// Wires that have ended are remembered, so that what was under way is not taken for a stranger's.
constexpr std::size_t kEndedKept = 256;
/// How long a client that is being rewired waits for the last messages of a provider that may hang: once it is asked
/// for them, and once more when the next one is to take its place.
constexpr std::chrono::milliseconds kEndPatience{100};
/// How long a client waits for its wire whose provider has only just been told: its process does nothing else
/// meanwhile.
constexpr std::chrono::milliseconds kAheadPatience{200};
/// Wires that one peer has asked for ahead of their grants: its host waits for each before the next.
constexpr std::ptrdiff_t kMostEarly = 4;
constexpr const char* kReplaced = "another provider has taken its place";

/// Why a peer says no: what it sends is its own, and may be anything.
std::string said(const std::string& reason) { return reason.empty() ? "no reason was given" : told_reason(reason); }

}  // namespace

class Links::Receiver final : public LinkSocket::Receiver {
 public:
  explicit Receiver(Links& links) : links_(links) {}
  void use(const std::shared_ptr<LinkSocket>& link) { link_ = link; }
  std::optional<std::uint64_t> accepts(const std::string& peer, const wire::Frame& frame) override {
    return links_.accepts(hop(peer), frame);
  }
  void on_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes& object) override {
    if (together_.take(frame, object)) return;
    together_.settle();
    links_.on_frame(hop(peer), frame, object, &together_);
  }
  void settle() override { together_.settle(); }
  void on_refused(const std::string& reason) override { links_.on_refused(hop(""), reason); }

 private:
  /// Made once for many frames of one peer.
  const Hop& hop(const std::string& peer) {
    if (!last_.link || last_.peer != peer) last_ = {link_.lock(), peer};
    return last_;
  }

  Links& links_;
  std::weak_ptr<LinkSocket> link_;
  Hop last_;
  ArrivingObjects together_;
};

Links::Peer::Peer() = default;
Links::Peer::~Peer() = default;
Links::Peer::Peer(Peer&&) noexcept = default;
Links::Peer& Links::Peer::operator=(Peer&&) noexcept = default;

Links::Links(Pool& pool, Clock& clock, std::string endpoint, LinkKeys keys, OnLost on_lost)
    : pool_(pool),
      clock_(dynamic_cast<VirtualClock*>(&clock)),
      endpoint_(std::move(endpoint)),
      memory_key_(keys.memory),
      on_lost_(std::move(on_lost)),
      receiver_(std::make_unique<Receiver>(*this)) {
  server_ =
      std::make_shared<LinkSocket>(pool_, context_, zmq::socket_type::router, counters_, *receiver_, on_dealt_with());
  receiver_->use(server_);
  server_->listen(endpoint_, std::move(keys));
}

Links::~Links() { stop(); }

void Links::stop() {
  server_->stop();
  std::vector<std::shared_ptr<LinkSocket>> own;
  {
    const std::lock_guard lock(mutex_);
    for (auto& [endpoint, peer] : peers_) {
      if (peer.receiver) own.push_back(peer.hop.link);
    }
  }
  for (const auto& link : own) link->stop();
}

control::LinkStatus Links::status() {
  control::LinkStatus status = counters_.status();
  const std::lock_guard lock(mutex_);
  std::size_t peers = server_->peers();
  for (auto& [endpoint, peer] : peers_) peers += peer.receiver ? peer.hop.link->peers() : 1;
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
    const FrameCounts ours = peer.hop.link->frame_counts()[""];
    all[endpoint].sent += ours.sent;
    all[endpoint].received += ours.received;
  }
  return all;
}

void Links::provide(std::uint64_t wire, std::string token, std::string peer, ProvidedPort& provider,
                    std::uint32_t prescale, std::string client_name, bool attached) {
  const InUse::Scope use(ports_in_use_);
  const std::lock_guard lock(mutex_);
  Grant& grant = grants_[wire];
  grant = Grant{std::move(token),       std::move(peer), &provider, std::max(1U, prescale),
                std::move(client_name), attached,        nullptr,   {}};
  while (const auto early = take_early(wire)) open_grant(early->from, early->frame, grant);
}

void Links::deny(std::uint64_t wire, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  note_ended(wire);
  while (const auto early = take_early(wire)) refuse(early->from, wire, reason);
}

/// It is known soon whether the wire is granted: its host waits for that. Of a peer that asks for more than it can have
/// under way the oldest gives way, and what is left of one that has gone goes. Called with the mutex held.
void Links::keep_early(const Hop& from, const wire::Frame& frame) {
  std::erase_if(early_, [this](const Early& early) {
    return early.from.link == server_ && server_->process_of(early.from.peer).empty();
  });
  const auto is_its = [&from](const Early& early) { return early.from == from; };
  if (std::count_if(early_.begin(), early_.end(), is_its) == kMostEarly) {
    const auto oldest = std::find_if(early_.begin(), early_.end(), is_its);
    refuse(from, oldest->frame.wire(), kNotGranted);
    early_.erase(oldest);
  }
  early_.push_back({from, frame});
}

/// Called with the mutex held.
std::optional<Links::Early> Links::take_early(std::uint64_t wire) {
  const auto found =
      std::find_if(early_.begin(), early_.end(), [wire](const Early& early) { return early.frame.wire() == wire; });
  if (found == early_.end()) return std::nullopt;
  Early early = std::move(*found);
  early_.erase(found);
  return early;
}

/// Called with the lock held. Throws Error Unreachable for a host that is not connected.
Hop Links::connect(const Endpoint& endpoint) {
  const auto known = peers_.find(endpoint.address);
  if (known != peers_.end()) return known->second.hop;
  if (endpoint.address.starts_with(kHost)) {
    throw Error(ErrorCode::Unreachable,
                {.what = "the other host is not connected", .where = endpoint.address, .next = "ls hosts"});
  }
  auto receiver = std::make_unique<Receiver>(*this);
  const auto link =
      std::make_shared<LinkSocket>(pool_, context_, zmq::socket_type::dealer, counters_, *receiver, on_dealt_with());
  receiver->use(link);
  link->connect(endpoint.address, endpoint.name, {endpoint.key, memory_key_});
  Peer& peer = peers_[endpoint.address];
  peer.receiver = std::move(receiver);
  peer.hop.link = link;
  return peer.hop;
}

void Links::require(std::uint64_t wire_id, const std::string& token, const std::shared_ptr<WireEnd>& client,
                    const Endpoint& endpoint, bool ahead, std::uint64_t replaces, std::uint32_t resumes_every,
                    const std::function<void()>& switch_over) {
  RequiredPort& port = client->port();
  const std::string& provider_name = client->provider();
  std::unique_lock lock(mutex_);
  const Hop hop = connect(endpoint);
  const std::string name = port.full_name() + "<" + provider_name;
  const auto wire = std::make_shared<RemoteWire>(hop.link, hop.peer, wire_id, port, name,
                                                 port.service().is_push() ? client : nullptr);
  requirements_[wire_id] =
      Requirement{client, endpoint.address, hop, wire, std::nullopt, 0, false, {}, false, replaces};
  // A client that is being rewired stays connected, with its last value, until the new provider has answered.
  const Connection before = client->connection();
  const bool first = before != Connection::Connected;
  if (first) client->set_connection(Connection::Waiting, "opening the wire to " + provider_name);
  wire->ask(token, ahead);

  const auto has_answer = [&] {
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end() || found->second.lost) return true;
    return found->second.refusal && (found->second.refusal != "" || !to_end(replaces));
  };
  const auto is_open = [&] {
    const auto found = requirements_.find(wire_id);
    return found != requirements_.end() && found->second.refusal == "";
  };
  const auto deadline = std::chrono::steady_clock::now() + (ahead ? kAheadPatience : kDefaultDeadline);
  while (!answered_.wait_for(lock, kEndPatience, has_answer) && !is_open()) {
    if (std::chrono::steady_clock::now() >= deadline) break;
  }
  const auto found = requirements_.find(wire_id);
  // One that is open is taken, though it may be lost by now: the wire before it has been asked for its end.
  const bool gone = !is_open() && (found == requirements_.end() || found->second.lost);
  const std::string refusal =
      gone ? "its process is gone" : found->second.refusal.value_or("its process does not answer");
  if (refusal.empty()) {
    lock.unlock();
    if (resumes_every > 0) count_missed(wire_id, replaces, resumes_every);
    // The new one first: a request that is being made has somewhere to go at every moment.
    if (!port.service().is_push()) client->set_target(wire);
    if (switch_over) switch_over();
    client->set_connection(Connection::Connected, provider_name);
    if (const auto loss = loss_of(wire_id)) {  // and this may have come behind what said so
      client->set_target(nullptr);
      client->set_connection(Connection::Lost, *loss);
    }
    return wire->admit();
  }
  if (found != requirements_.end()) requirements_.erase(found);
  note_ended(wire_id);
  lock.unlock();
  wire->cut(refusal);
  if (first) client->set_connection(before == Connection::Lost ? Connection::Lost : Connection::Unwired, refusal);
  throw Error(ErrorCode::Unreachable, {.what = "the wire to " + provider_name + " did not open: " + refusal,
                                       .where = port.full_name(),
                                       .next = "ls hosts"});
}

/// Why the link of a wire that is required here is lost; none: it is not.
std::optional<std::string> Links::loss_of(std::uint64_t wire) {
  const std::lock_guard lock(mutex_);
  const auto found = requirements_.find(wire);
  return found == requirements_.end() ? std::nullopt : found->second.lost;
}

/// What the provider has put between the last message over the wire that was lost and the first over this one.
void Links::count_missed(std::uint64_t wire, std::uint64_t replaces, std::uint32_t every) {
  const std::lock_guard lock(mutex_);
  const auto now = requirements_.find(wire);
  const auto before = requirements_.find(replaces);
  if (now == requirements_.end() || before == requirements_.end() || !now->second.client->port().service().is_push())
    return;
  const std::uint64_t last = std::max(before->second.from_sequence, before->second.wire->last_sequence());
  if (now->second.from_sequence <= last) return;
  now->second.client->port().counters().dropped.fetch_add((now->second.from_sequence - last) / every,
                                                          std::memory_order_relaxed);
}

void Links::refuse(const Hop& from, std::uint64_t wire, const std::string& reason) {
  ++counters_.not_granted;
  wire::Frame frame = frame_for(wire);
  frame.mutable_refused()->set_reason(told_reason(reason));
  from.link->tell(from.peer, frame);
}

/// Whether who sends it is the process of this name, or the host at this endpoint.
bool Links::may_open(const Hop& from, const std::string& peer) {
  if (from.link == server_) return server_->process_of(from.peer) == peer;
  const auto host = peers_.find(peer);
  return host != peers_.end() && peer.starts_with(kHost) && host->second.hop == from;
}

void Links::open_for(const Hop& from, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  if (frame.open().version() != wire::VERSION_1) return refuse(from, frame.wire(), kUnknownVersion);
  if (const auto relay = relays_.find(frame.wire()); relay != relays_.end())
    return open_relay(from, frame, relay->second);
  if (const auto grant = grants_.find(frame.wire()); grant != grants_.end())
    return open_grant(from, frame, grant->second);
  if (frame.open().ahead() && !has_ended(frame.wire())) return keep_early(from, frame);
  refuse(from, frame.wire(), kNotGranted);
}

/// Called with the mutex held.
void Links::open_grant(const Hop& from, const wire::Frame& frame, Grant& grant) {
  if (grant.token != frame.open().token() || grant.wire || !may_open(from, grant.peer)) {
    return refuse(from, frame.wire(), kNotGranted);
  }
  grant.client = from;
  grant.wire = wire_for(from, frame.wire(), grant);
  grant.wire->open(grant.prescale, frame.open().each());
}

/// The provider's end of a wire; those of a push port to the same process share what crosses.
std::shared_ptr<RemoteWire> Links::wire_for(const Hop& from, std::uint64_t wire, const Grant& grant) {
  ProvidedPort& provider = *grant.provider;
  const std::string name = grant.client_name + "<" + provider.full_name();
  auto* push = dynamic_cast<detail::PushProvider*>(&provider);
  if (!push) return std::make_shared<RemoteWire>(from.link, from.peer, wire, provider, name);
  auto& known = fan_outs_[{from.link.get(), from.peer, &provider}];
  auto fan_out = known.lock();
  if (!fan_out || !fan_out->take_on()) {
    known = fan_out = std::make_shared<FanOut>(from.link, from.link->open_lane(from.peer), *push);
    fan_out->take_on();
    std::erase_if(fan_outs_, [](const auto& entry) { return entry.second.expired(); });
  }
  return std::make_shared<RemoteWire>(std::move(fan_out), from.link, from.peer, wire, provider, name);
}

// ---- frames ---------------------------------------------------------------------------------------------------

/// Called with the mutex held.
void Links::note_ended(std::uint64_t wire) {
  if (ended_.size() == kEndedKept) ended_.pop_front();
  ended_.push_back(wire);
}

/// A frame for a wire that this peer does not have is dropped, and counted: of a wire that has ended, a message. Called
/// with the mutex held.
void Links::note_foreign(std::uint64_t wire, const wire::Frame& frame) {
  if (!has_ended(wire)) {
    ++counters_.not_granted;
  } else if (frame.has_object() || frame.fired().sequence() > 0) {
    ++counters_.late;
  }
}

bool Links::has_ended(std::uint64_t wire) const {
  return std::find(ended_.rbegin(), ended_.rend(), wire) != ended_.rend();
}

Links::End Links::end_of(const Hop& from, std::uint64_t wire, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  return end_of_locked(from, wire, frame);
}

Links::End Links::end_of_locked(const Hop& from, std::uint64_t wire, const wire::Frame& frame) {
  const End end = find_end(from, wire);
  if (!end.wire) note_foreign(wire, frame);
  return end;
}

/// Called with the mutex held.
Links::End Links::find_end(const Hop& from, std::uint64_t wire) const {
  const auto grant = grants_.find(wire);
  if (grant != grants_.end() && grant->second.wire && grant->second.client == from) return {grant->second.wire, true};
  const auto requirement = requirements_.find(wire);
  const bool ours =
      requirement != requirements_.end() && !requirement->second.lost && requirement->second.provider == from;
  return ours ? End{requirement->second.wire, false} : End{};
}

/// What nobody here takes is counted now: nothing more comes of it.
std::optional<std::uint64_t> Links::accepts(const Hop& from, const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto is_ours = [&](std::uint64_t wire) {
    const auto relay = relays_.find(wire);
    const bool open = relay != relays_.end() && relay->second.client.hop.link;
    if (open && (relay->second.client.hop == from || relay->second.provider.hop == from)) return true;
    return find_end(from, wire).wire != nullptr;
  };
  if (is_ours(frame.wire())) return frame.wire();
  const auto other = std::find_if(frame.also().begin(), frame.also().end(), is_ours);
  if (other != frame.also().end()) return *other;
  note_foreign(frame.wire(), frame);
  for (const std::uint64_t wire : frame.also()) note_foreign(wire, frame);
  return std::nullopt;
}

void Links::on_frame(const Hop& from, const wire::Frame& frame, const ObjectBytes& object, ArrivingObjects* together) {
  const InUse::Scope use(ports_in_use_);
  if (frame.has_open()) return open_for(from, frame);
  std::optional<wire::Frame> some;  // to make one takes time, and there are few relays
  const wire::Frame* rest = &frame;
  End end;
  std::shared_ptr<const Payload> payload;  // made before the lock is taken: to copy it takes time
  if (object.size() > kInlineBytes && is_relayed(frame)) payload = std::make_shared<const Payload>(object);
  {
    const std::lock_guard lock(mutex_);
    if (!relays_.empty()) rest = pass_on(from, frame, object, payload, some.emplace());
    if (!rest) return;
    end = end_of_locked(from, rest->wire(), *rest);
  }
  if (!end.wire && rest->also().empty()) return;
  if (!end.provides) return on_client_frame(from, *rest, end.wire, object, together);
  if (rest->has_closed()) return cut(rest->wire(), rest->closed().reason());
  end.wire->on_frame(*rest, object);
}

void Links::on_client_frame(const Hop& from, const wire::Frame& frame, std::shared_ptr<RemoteWire> wire,
                            const ObjectBytes& object, ArrivingObjects* together) {
  const auto required = [&](std::uint64_t number) {
    const End end = end_of(from, number, frame);
    return end.provides ? nullptr : end.wire;
  };
  if (wire && frame.has_opened()) return note_answer(frame.wire(), "", frame.opened());
  if (wire && frame.has_refused()) return note_answer(frame.wire(), said(frame.refused().reason()));
  if (wire && frame.has_closed()) return on_closed(frame.wire(), said(frame.closed().reason()));
  if (frame.also().empty() || !frame.has_object()) {
    const bool kept = wire && together && frame.also().empty() && together->begin(wire, ports_in_use_, frame, object);
    if (wire && !kept) wire->on_frame(frame, object);
    for (const std::uint64_t other : frame.also()) {
      if ((wire = required(other))) wire->on_frame(frame, object);
    }
    return;
  }
  // One crossing, one parse, for all the subscribers here. They are of one port, and so of one type: else a provider
  // could have an object of one type taken for one of another.
  std::optional<ParsedObject> parsed;
  const google::protobuf::Descriptor* type = nullptr;
  const auto take = [&](const std::shared_ptr<RemoteWire>& one) {
    if (!one) return;
    const auto& its_type = one->port().service().object();
    if (!parsed) {
      parsed = one->parse_object(object);
      type = &its_type;
    }
    if (type != &its_type) return void(++counters_.not_granted);
    one->on_object(frame, *parsed);
  };
  take(wire);
  for (const std::uint64_t other : frame.also()) take(required(other));
}

/// The provider has ended the wire.
void Links::on_closed(std::uint64_t wire_id, const std::string& reason) {
  std::shared_ptr<RemoteWire> wire;
  std::shared_ptr<WireEnd> client;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end()) return;
    found->second.lost = reason;
    wire = found->second.wire;
    if (!found->second.retired && found->second.refusal == "") client = found->second.client;
    const bool is_over = found->second.retired && !wire->port().service().is_push();  // a push is waited for
    if (is_over || found->second.passed_over) {
      note_ended(wire_id);
      requirements_.erase(found);
    }
  }
  answered_.notify_all();
  wire->cut(reason);
  if (!client) return;
  client->set_target(nullptr);
  client->set_connection(Connection::Lost, reason);
  on_lost_(wire_id, reason);
}

void Links::on_refused(const Hop& from, const std::string& reason) {
  std::vector<std::uint64_t> waiting;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [wire, requirement] : requirements_) {
      if (requirement.provider == from) waiting.push_back(wire);
    }
  }
  for (const std::uint64_t wire : waiting) note_answer(wire, reason);
}

void Links::note_answer(std::uint64_t wire_id, const std::string& refusal, const wire::Opened& opened) {
  std::shared_ptr<RemoteWire> replaced;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end() || found->second.refusal) return;
    found->second.refusal = refusal;
    found->second.from_sequence = opened.from_sequence();
    found->second.client->set_cycle(Duration(told_ns(opened.cycle_ns())));
    if (refusal.empty()) replaced = to_end(found->second.replaces);
    if (replaced) requirements_.at(found->second.replaces).retired = true;
  }
  if (replaced) return replaced->ask_for_end(kReplaced);  // which ends the wait: nobody is woken before
  answered_.notify_all();
}

void Links::cut(std::uint64_t wire_id, const std::string& reason, Connection now) {
  const InUse::Scope use(ports_in_use_);
  std::unique_lock lock(mutex_);
  if (relays_.contains(wire_id)) return cut_relay(wire_id, reason);
  if (const auto found = grants_.find(wire_id); found != grants_.end()) {
    const auto wire = found->second.wire;
    const bool attached = found->second.attached;
    grants_.erase(found);
    note_ended(wire_id);
    lock.unlock();
    if (wire) wire->cut(reason, true);
    if (attached) on_lost_(wire_id, reason);
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
  requirement.client->set_connection(now, reason);
  if (now == Connection::Lost) on_lost_(wire_id, reason);
}

/// A push whose provider still serves it, and can be asked for its end: all that it has put until then comes first.
/// None in virtual time, where a put takes until the next round: there the cut is between two of them, whatever the
/// transport. Called with the mutex held.
std::shared_ptr<RemoteWire> Links::to_end(std::uint64_t wire) const {
  const auto found = requirements_.find(wire);
  if (clock_ || found == requirements_.end() || found->second.lost) return nullptr;
  const WireEnd& client = *found->second.client;
  const bool serves = client.port().service().is_push() && client.connection() == Connection::Connected;
  return serves ? found->second.wire : nullptr;
}

/// False: it does not come. What comes of it later is counted.
bool Links::await_end(std::uint64_t wire) {
  std::unique_lock lock(mutex_);
  const auto asked = to_end(wire);
  if (!asked) return true;
  lock.unlock();
  asked->ask_for_end(kReplaced);
  lock.lock();
  if (answered_.wait_for(lock, kEndPatience, [&] { return !to_end(wire); })) return true;
  requirements_.at(wire).passed_over = true;
  asked->pass_over();
  return false;
}

void Links::retire(std::uint64_t wire_id, bool drains) {
  std::shared_ptr<RemoteWire> wire;
  {
    const std::lock_guard lock(mutex_);
    const auto found = requirements_.find(wire_id);
    if (found == requirements_.end()) return;
    found->second.retired = true;
    wire = found->second.wire;
  }
  if (wire->port().service().is_push()) {
    if (!drains || await_end(wire_id)) cut(wire_id, kReplaced);
    return;
  }
  wire->drain([this, wire_id] { cut(wire_id, kReplaced); });
}

void Links::release(const Hull& hull, const std::string& reason, Connection now) {
  std::vector<std::uint64_t> left;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, grant] : grants_) {
      if (&grant.provider->hull() == &hull) left.push_back(id);
    }
    for (const auto& [id, requirement] : requirements_) {
      if (&requirement.client->port().hull() == &hull) left.push_back(id);
    }
  }
  for (const std::uint64_t id : left) cut(id, reason, now);
  // Another thread may have taken one of its wires out of reach just before, and not yet be done with the port.
  ports_in_use_.wait_for_end();
}

void Links::peer_lost(const std::string& endpoint, const std::string& name, const std::string& reason) {
  lose(endpoint, name, reason);
  server_->forget(name);
}

void Links::set_prescale(std::uint64_t wire, std::uint32_t prescale) {
  const std::lock_guard lock(mutex_);
  const auto found = grants_.find(wire);
  if (found == grants_.end()) {
    throw Error(ErrorCode::NotFound, {.what = "the wire is not provided here any more", .next = "ls wires"});
  }
  found->second.prescale = std::max(1U, prescale);
  if (found->second.wire) found->second.wire->set_prescale(found->second.prescale);
}

void Links::add_held(wire::Adopted& adopted) {
  const std::lock_guard lock(mutex_);
  for (const auto& [id, grant] : grants_) {
    auto& held = *adopted.add_wires();
    held.set_wire(id);
    *held.mutable_client() = port_named(grant.client_name);
    *held.mutable_provider() = port_named(grant.provider->full_name());
    held.set_prescale(grant.prescale);
    held.set_provider_end(true);
    held.set_open(grant.wire != nullptr);
  }
  for (const auto& [id, requirement] : requirements_) {
    auto& held = *adopted.add_wires();
    held.set_wire(id);
    *held.mutable_client() = port_named(requirement.client->port().full_name());
    *held.mutable_provider() = port_named(requirement.client->provider());
    held.set_client_end(true);
    held.set_open(!requirement.lost && requirement.refusal == "");
    held.set_retired(requirement.retired);
  }
}

void Links::cut_attached(const std::string& reason) {
  std::vector<std::uint64_t> left;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, grant] : grants_) {
      if (grant.attached) left.push_back(id);
    }
  }
  for (const std::uint64_t id : left) cut(id, reason);
}

void Links::join(const std::string& endpoint, Hop hop) {
  const std::lock_guard lock(mutex_);
  peers_[endpoint].hop = std::move(hop);
}

void Links::part(const std::string& endpoint, const std::string& reason) { lose(endpoint, endpoint, reason); }

void Links::lose(const std::string& endpoint, const std::string& name, const std::string& reason) {
  std::vector<std::pair<std::uint64_t, Requirement>> lost;
  std::vector<std::shared_ptr<RemoteWire>> served;
  Peer gone;
  const InUse::Scope use(ports_in_use_);
  {
    const std::lock_guard lock(mutex_);
    for (auto& [id, requirement] : requirements_) {
      if (requirement.endpoint != endpoint || requirement.lost) continue;
      requirement.lost = reason;
      note_ended(id);
      lost.emplace_back(id, requirement);
    }
    std::erase_if(requirements_, [](const auto& entry) { return entry.second.lost && entry.second.retired; });
    for (auto it = grants_.begin(); it != grants_.end();) {
      const bool ours = it->second.peer == name;
      if (ours && it->second.wire) served.push_back(std::move(it->second.wire));
      if (ours) note_ended(it->first);
      it = ours ? grants_.erase(it) : std::next(it);
    }
    lose_relays(endpoint, name, reason);
    if (const auto peer = peers_.find(endpoint); peer != peers_.end()) {
      gone = std::move(peer->second);
      peers_.erase(peer);
    }
  }
  answered_.notify_all();
  for (const auto& wire : served) wire->cut(reason);
  for (auto& [wire, requirement] : lost) requirement.wire->cut(reason);
  // One that is being opened is told by who waits for it.
  std::erase_if(lost, [](const auto& entry) { return entry.second.retired || entry.second.refusal != ""; });
  for (auto& [wire, requirement] : lost) {
    requirement.client->set_target(nullptr);
    requirement.client->set_connection(Connection::Lost, reason);
  }
  if (gone.receiver) gone.hop.link->stop();
  for (auto& [wire, requirement] : lost) on_lost_(wire, reason);
}

}  // namespace fiona::host
