#include "peer_link.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "fiona/readable_text.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

/// Connecting again is done here and not by libzmq, whose pauses would bring 200 hosts back in step. After a session,
/// the first attempt begins after 0.2 to 0.6 s and the next one 0.5 to 1.5 s later, so that a short outage costs 2 s.
/// The third spreads the crowd; from then on there is one every 4.2 to 4.7 s, so that a long outage costs 5 s and 200
/// hosts together make less than 50 attempts a second.
constexpr PeerLink::Pause kAfterSession{200, 400};
constexpr PeerLink::Pause kAfterFirst{500, 1000};
constexpr PeerLink::Pause kAfterSecond{1500, 3200};
constexpr PeerLink::Pause kLater{4200, 500};
/// From one attempt to the next at one that refuses us.
constexpr PeerLink::Pause kAfterRefusal{5000, 1000};
/// An attempt that nobody has answered lives until the next one begins, but so long at least; one that is connected has
/// the time of the handshake, and as much again for the first words.
constexpr std::chrono::milliseconds kConnect{1000};
constexpr std::chrono::milliseconds kHelloEvery{400};
/// What an event costs beside its bytes.
constexpr std::size_t kPerEvent = 256;
/// While an answer is waited for.
constexpr std::chrono::milliseconds kMeanwhileEvery{25};
/// Of what nobody waits for, and is not answered: of more the oldest is not told again after the connection was cut.
constexpr std::size_t kMostTold = 10'000;
/// How long the last word of a host that ends may take to leave.
constexpr std::chrono::milliseconds kFarewell{200};

constexpr const char* kNoHandshake =
    "no handshake: its key is not the one that --peer names, or it is no host of FIONA";

using Steady = std::chrono::steady_clock;

}  // namespace

PeerAddress PeerAddress::from_text(const std::string& text) {
  const std::size_t first = text.find('=');
  const std::size_t last = text.rfind('=');
  const std::string name = text.substr(0, first);
  const bool says_where = first != last;
  const std::string address = says_where ? text.substr(first + 1, last - first - 1) : "";
  const auto key = last == std::string::npos ? std::nullopt : trust::Key::from_text(text.substr(last + 1));
  const std::size_t colon = address.rfind(':');
  const auto fits = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_'; };
  const bool named = !name.empty() && name.size() <= 40 && std::isalpha(static_cast<unsigned char>(name[0])) &&
                     name != "main" && std::all_of(name.begin(), name.end(), fits);
  if (named && key && !says_where) return {name, "", *key};
  if (named && key && colon != std::string::npos && colon > 0 && colon + 1 < address.size()) {
    return {name, "tcp://" + address, *key};
  }
  throw Error(
      ErrorCode::Usage,
      {.what = "--peer does not say which host, where it listens and what its key is",
       .expected = "NAME=HOST:PORT=KEY, or NAME=KEY of one that --registry has; a key of 64 hexadecimal digits; NAME "
                   "begins with a letter and is not 'main'",
       .found = text,
       .next = "on the other host: fiona keys show"});
}

wire::HostFrame host_frame_of(const wire::Frame& frame, const ObjectBytes& object) {
  if (object.size() == 0) return frame.host();
  wire::HostFrame host;
  if (!object.parse_into(host)) host.Clear();
  return host;
}

/// What comes over one of the sockets that were tried.
class PeerLink::Incoming final : public LinkSocket::Receiver {
 public:
  explicit Incoming(PeerLink& peer) : peer_(peer) {}
  void use(const std::shared_ptr<LinkSocket>& link) { link_ = link; }
  std::optional<std::uint64_t> accepts(const std::string&, const wire::Frame& frame) override {
    return peer_.accepts({link_.lock(), ""}, frame);
  }
  void on_frame(const std::string&, const wire::Frame& frame, const ObjectBytes& object) override {
    peer_.on_frame({link_.lock(), ""}, frame, object);
  }
  void on_refused(const std::string&) override {}

 private:
  PeerLink& peer_;
  std::weak_ptr<LinkSocket> link_;
};

PeerLink::PeerLink(const HostSurroundings& around, PeerAddress peer)
    : around_(around),
      peer_(std::move(peer)),
      address_(peer_.address),
      random_(static_cast<std::minstd_rand::result_type>(around.run ^ std::hash<std::string>()(peer_.name))) {}

PeerLink::~PeerLink() { stop(); }

void PeerLink::stop() {
  if (joined()) {
    wire::HostFrame frame;
    frame.mutable_gone();
    send(frame);
  }
  close(State::Connecting, "the host ends", Steady::now() + std::chrono::hours(1), kFarewell);
}

std::chrono::milliseconds PeerLink::by_chance(const Pause& pause) {
  return std::chrono::milliseconds(pause.least_ms + random_() % pause.spread_ms);
}

/// Where it is now, for one that the registry has. Throws Error that says why not.
void PeerLink::find() {
  if (!peer_.address.empty()) return;
  const std::string found = around_.registry->address_of(peer_.name, peer_.key);
  const std::lock_guard lock(mutex_);
  address_ = found;
}

void PeerLink::try_open(Steady::time_point now) {
  try {
    find();
  } catch (const Error& error) {
    const std::lock_guard lock(mutex_);
    reason_ = error.text().what;
    open_at_ = now + Registry::kLookEvery;
    tried_ = true;
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    const int tries = std::exchange(tries_, std::min(tries_ + 1, 2));
    next_attempt_ = now + by_chance(state_ == State::Refused ? kAfterRefusal
                                    : tries == 0             ? kAfterFirst
                                    : tries == 1             ? kAfterSecond
                                                             : kLater);
    give_up_at_ = std::max(next_attempt_, now + kConnect);
  }
  try {
    open();
  } catch (const zmq::error_t& error) {
    enter(State::Refused, "no connection to " + address_ + " can be made: " + error.what());
    open_at_ = now + by_chance(kAfterRefusal);
  }
}

void PeerLink::open() {
  auto incoming = std::make_unique<Incoming>(*this);
  auto link = std::make_shared<LinkSocket>(around_.pool, around_.context, zmq::socket_type::dealer,
                                           around_.links.counters(), *incoming);
  incoming->use(link);
  auto& socket = link->socket();
  socket.set(zmq::sockopt::curve_serverkey, peer_.key.bytes());
  socket.set(zmq::sockopt::curve_publickey, around_.keys.open.bytes());
  socket.set(zmq::sockopt::curve_secretkey, around_.keys.secret.bytes());
  socket.set(zmq::sockopt::immediate, true);  // nothing waits for a connection that may never come
  socket.set(zmq::sockopt::reconnect_ivl, -1);
  socket.set(zmq::sockopt::handshake_ivl, kHandshake_ms);
  socket.set(zmq::sockopt::ipv6, address_.find('[') != std::string::npos);
  const std::string watch = "inproc://peer-" + peer_.name + "-" + std::to_string(sockets_++);
  zmq_socket_monitor(socket.handle(), watch.c_str(),
                     ZMQ_EVENT_CONNECTED | ZMQ_EVENT_CLOSED | ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_SUCCEEDED |
                         ZMQ_EVENT_HANDSHAKE_FAILED_AUTH | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                         ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL);
  monitor_ = zmq::socket_t(around_.context, zmq::socket_type::pair);
  monitor_.set(zmq::sockopt::linger, 0);
  monitor_.connect(watch);
  link->connect_proven(address_, peer_.name);
  const std::lock_guard lock(mutex_);
  lane_ = link->open_lane("");
  link_ = std::move(link);
  incoming_ = std::move(incoming);
  spoke_ = {};
}

/// Ends the socket, and with it the session: no frame comes from it when its wires are lost.
void PeerLink::close(State next, const std::string& reason, Steady::time_point open_at,
                     std::chrono::milliseconds linger) {
  std::shared_ptr<LinkSocket> ended;
  {
    const std::lock_guard lock(mutex_);
    ended = std::move(link_);
    lane_ = {};
  }
  if (ended) {
    // libzmq's own thread waits for ever where it has something to tell and the monitor is gone.
    zmq_socket_monitor(ended->socket().handle(), nullptr, 0);
    ended->stop(linger);
  }
  monitor_.close();
  bool was_joined = false;
  {
    const std::lock_guard lock(mutex_);
    was_joined = state_ == State::Joined;
    tried_ = true;
    ++session_;
    end_.reset();
    no_handshake_ = false;
    closed_ = false;
    open_at_ = open_at;
  }
  enter(next, reason);
  answered_.notify_all();
  if (!was_joined) return;
  // A welcome may have come until the socket ended: then nobody has said why.
  const std::string& why = reason.empty() ? has_ended() : reason;
  around_.links.part(endpoint(), why);
  around_.on_change({.what = HostChange::What::Lost, .host = peer_.name, .reason = why, .group = {}, .request = {}});
}

void PeerLink::enter(State state, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (state_ != state) since_ = Steady::now();
  state_ = state;
  reason_ = reason;
}

void PeerLink::forgive(Steady::duration time) {
  const std::lock_guard lock(mutex_);
  heard_ = std::min(heard_ + time, Steady::now());
}

void PeerLink::tick(Steady::time_point now) {
  if (!link_) return now >= open_at_ ? try_open(now) : void();
  read_monitor(now);
  std::unique_lock lock(mutex_);
  const bool joined = state_ == State::Joined;
  if (const auto reason = end_) {
    lock.unlock();
    if (joined) return close(State::Silent, *reason, now + by_chance(kAfterSession));
    return close(State::Refused, *reason, now + by_chance(kAfterRefusal));
  }
  if (joined && closed_) {
    lock.unlock();
    return close(State::Silent, has_ended(), now + by_chance(kAfterSession));
  }
  if (!joined && (closed_ || no_handshake_ || now > give_up_at_)) {
    const State same = state_;
    const std::string reason = no_handshake_ ? kNoHandshake : reason_;
    lock.unlock();
    return close(same, reason, next_attempt_);
  }
  const bool silent = joined && now - heard_ > kSilence;
  const auto quiet = now - spoke_;
  lock.unlock();
  if (!joined) return quiet >= kHelloEvery ? say_hello() : void();
  if (quiet >= kBeatEvery) beat();
  if (!silent) return;
  // The pool's threads may all be busy, and what the peer has said still lie in the socket.
  link_->read_now();
  lock.lock();
  const auto silence = std::chrono::duration_cast<std::chrono::milliseconds>(Steady::now() - heard_);
  lock.unlock();
  if (silence > kSilence)
    close(State::Silent, "host '" + peer_.name + "' has been silent for " + std::to_string(silence.count()) + " ms",
          now + by_chance(kAfterSession));
}

/// How the connection comes about, or why not, as far as libzmq tells.
void PeerLink::read_monitor(Steady::time_point now) {
  zmq::message_t event;
  while (monitor_ && received(monitor_, event)) {
    std::uint16_t kind = 0;
    if (event.size() >= sizeof kind) std::memcpy(&kind, event.data(), sizeof kind);
    zmq::message_t address;
    if (!received(monitor_, address)) return;
    const std::lock_guard lock(mutex_);
    switch (kind) {
      case ZMQ_EVENT_CONNECTED: give_up_at_ = now + 2 * std::chrono::milliseconds(kHandshake_ms); break;
      case ZMQ_EVENT_HANDSHAKE_SUCCEEDED: spoke_ = {}; break;
      case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
        end_ = "it does not let us in: on it, fiona keys allow NAME " + around_.keys.open.text();
        break;
      case ZMQ_EVENT_CLOSED:
      case ZMQ_EVENT_DISCONNECTED: closed_ = true; break;
      default: no_handshake_ = true; break;
    }
  }
}

void PeerLink::send(const wire::HostFrame& host) {
  wire::Frame frame;
  *frame.mutable_host() = host;
  const std::lock_guard lock(mutex_);
  if (link_) link_->tell("", frame);
  spoke_ = Steady::now();
}

void PeerLink::say_hello() {
  wire::HostFrame frame;
  auto& hello = *frame.mutable_hello();
  hello.set_version(wire::VERSION_1);
  hello.set_name(around_.name);
  hello.set_run(around_.run);
  *hello.mutable_beat() = offset_.beat(now_ns());
  send(frame);
}

void PeerLink::beat() {
  wire::HostFrame frame;
  *frame.mutable_beat() = offset_.beat(now_ns());
  send(frame);
}

std::optional<std::uint64_t> PeerLink::accepts(const Hop& hop, const wire::Frame& frame) {
  if (!joined()) return std::nullopt;
  return frame.has_host() ? kHostsOwn : around_.links.accepts(hop, frame);
}

void PeerLink::on_frame(const Hop& hop, const wire::Frame& given, const ObjectBytes& object) {
  bool joined = false;
  {
    const std::lock_guard lock(mutex_);
    heard_ = Steady::now();
    joined = state_ == State::Joined;
  }
  if (given.has_host()) return on_host_frame(hop, host_frame_of(given, object));
  if (given.wire() == 0 || !joined) return;  // a Lost of taps: their numbers have the gap
  wire::Frame frame = given;
  offset_.turn(frame);
  around_.links.on_frame(hop, frame, object);
}

void PeerLink::on_host_frame(const Hop& hop, const wire::HostFrame& host) {
  const bool joined = this->joined();
  if (host.has_welcome() && !joined) return on_welcome(hop, host.welcome());
  if (host.has_beat()) return offset_.heard(host.beat(), now_ns());
  if (host.has_message() && joined) return on_message(host.message());
  const std::lock_guard lock(mutex_);
  if (host.has_refused() && !joined) end_ = readable_text(host.refused().reason(), 500);
  if (host.has_gone() && joined) end_ = "host '" + peer_.name + "' has not heard us";
}

void PeerLink::on_welcome(const Hop& hop, const wire::HostWelcome& welcome) {
  offset_.heard(welcome.beat(), now_ns());
  bool same_run = false;
  {
    const std::lock_guard lock(mutex_);
    same_run = !run_ || run_ == welcome.run();  // at first nothing is there that could be of another run
    if (!same_run) subjects_.clear();
    if (!same_run) told_.clear();
    for (auto& [group, subjects] : subjects_) subjects.answers_no_more();
    run_ = welcome.run();
    tries_ = 0;
    version_ = readable_text(welcome.version(), 40);
  }
  around_.links.join(endpoint(), hop);
  beat();  // before any wire: its times need what this tells
  enter(State::Joined, "");
  around_.on_change({.what = HostChange::What::Joined,
                     .host = peer_.name,
                     .reason = {},
                     .same_run = same_run,
                     .group = {},
                     .request = {}});
}

void PeerLink::on_message(const wire::GroupMessage& given) {
  wire::GroupMessage message = given;
  if (message.has_tapped()) {
    auto& tapped = *message.mutable_tapped();
    tapped.set_origin_ns(offset_.to_ours(tapped.origin_ns()));
    tapped.set_told_ns(offset_.to_ours(tapped.told_ns()));
  }
  if (message.id() != 0) {
    const std::lock_guard lock(mutex_);
    for (auto& [group, subjects] : subjects_) subjects.answered(message);
    std::erase_if(subjects_, [](const auto& one) { return one.second.is_empty(); });
    told_.erase(message.id());
    const auto pending = pending_.find(message.id());
    if (pending != pending_.end()) pending->second = std::move(message);
    return answered_.notify_all();
  }
  if (!believes(message) || says_too_much(message)) return;
  if (message.has_group_ended()) {
    return around_.on_change({.what = HostChange::What::GroupEnded,
                              .host = peer_.name,
                              .reason = message.group_ended().reason(),
                              .group = message.group_ended().group(),
                              .request = {}});
  }
  around_.on_event(std::move(message));
}

/// Of its groups it is believed all: what they may say it has looked at itself.
bool PeerLink::believes(const wire::GroupMessage& event) {
  const std::lock_guard lock(mutex_);
  if (event.has_group_ended()) {
    // What it was asked for and has not answered is done by the process after it.
    const auto ended = subjects_.find(event.group_ended().group());
    if (ended != subjects_.end() && !ended->second.awaits_answers()) subjects_.erase(ended);
    return true;
  }
  const bool is_theirs = std::ranges::any_of(subjects_, [&](auto& one) { return one.second.take(event); });
  if (!is_theirs) disbelief_.tell(fmt::format("host '{}'", peer_.name), event);
  return is_theirs;
}

/// Then the session ends.
bool PeerLink::says_too_much(const wire::GroupMessage& message) {
  if (message.has_tapped() || (unread_ += message.ByteSizeLong() + kPerEvent) <= kMostUnread) return false;
  const std::lock_guard lock(mutex_);
  end_ = "host '" + peer_.name + "' has said more than " + std::to_string(kMostUnread >> 20U) +
         " MiB that nobody had asked for, faster than it could be read";
  return true;
}

bool PeerLink::was_tried() const {
  const std::lock_guard lock(mutex_);
  return state_ != State::Connecting || tried_;
}

Error PeerLink::unreachable() const {
  return Error(
      ErrorCode::Unreachable,
      {.what = "host '" + peer_.name + "' is not connected", .where = address_, .found = reason_, .next = "ls hosts"});
}

/// Called with the mutex held. Returns the number that its answer will have.
std::uint64_t PeerLink::ask(const std::string& group, const wire::GroupRequest& request) {
  if (state_ != State::Joined || !link_) throw unreachable();
  wire::Frame frame;
  frame.mutable_host();
  const auto host = std::make_shared<wire::HostFrame>();
  auto& asked = *host->mutable_request();
  asked.set_group(group);
  *asked.mutable_request() = request;
  const std::uint64_t id = next_id_++;
  asked.mutable_request()->set_id(id);
  subjects_[group].ask(asked.request());
  link_->send(lane_, frame, host);
  return id;
}

wire::GroupMessage PeerLink::request(const std::string& group, const wire::GroupRequest& request,
                                     std::chrono::milliseconds deadline, const std::function<void()>& meanwhile) {
  std::unique_lock lock(mutex_);
  const std::uint64_t id = ask(group, request);
  const std::uint64_t session = session_;
  pending_[id] = std::nullopt;
  const auto ends = [&] { return pending_[id] || session_ != session; };
  const auto until = Steady::now() + deadline;
  while (!answered_.wait_until(lock, std::min(until, Steady::now() + kMeanwhileEvery), ends) && Steady::now() < until) {
    if (!meanwhile) continue;
    lock.unlock();
    meanwhile();
    lock.lock();
  }
  auto answer = std::move(pending_[id]);
  pending_.erase(id);
  if (answer && answer->has_adopted()) subjects_[group].keep(answer->adopted());
  if (answer) return std::move(*answer);
  if (session_ != session) throw unreachable();
  throw Error(
      ErrorCode::Unreachable,
      {.what = "host '" + peer_.name + "' does not answer", .found = "connected, but silent", .next = "ls hosts"});
}

bool PeerLink::tell(const std::string& group, const wire::GroupRequest& request) {
  const std::lock_guard lock(mutex_);
  if (state_ != State::Joined || !link_) return false;
  const std::uint64_t id = ask(group, request);
  if (told_.size() >= kMostTold) told_.erase(told_.begin());
  told_[id] = {session_, group, request};
  return true;
}

std::vector<wire::GroupRequest> PeerLink::take_unanswered(const std::string& group) {
  const std::lock_guard lock(mutex_);
  std::vector<wire::GroupRequest> left;
  std::erase_if(told_, [&](auto& one) {
    const bool is_left = one.second.group == group && one.second.session != session_;
    if (is_left) left.push_back(std::move(one.second.request));
    return is_left;
  });
  return left;
}

std::string PeerLink::address() const {
  const std::lock_guard lock(mutex_);
  return address_;
}

bool PeerLink::joined() const {
  const std::lock_guard lock(mutex_);
  return state_ == State::Joined;
}

control::HostStatus PeerLink::status() const {
  static constexpr const char* kStates[] = {"connecting", "joined", "silent", "refused"};
  const std::lock_guard lock(mutex_);
  control::HostStatus status;
  status.set_name(peer_.name);
  status.set_address(address_);
  status.set_key(peer_.key.text());
  status.set_state(kStates[static_cast<std::size_t>(state_)]);
  status.set_reason(reason_);
  status.set_since_s(to_seconds(Steady::now() - since_));
  status.set_version(version_);
  status.set_clock_offset_ms(static_cast<double>(offset_.ahead_ns()) / 1e6);
  return status;
}

}  // namespace fiona::host
