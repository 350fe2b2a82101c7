#include "leader_link.hpp"

#include <algorithm>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;

/// Connections that nobody ends: the kernel clears them away. Not libzmq's heartbeat, which aborts the process when a
/// peer has gone of whom more was there than had been read.
constexpr int kAliveEvery_s = 1;
constexpr int kAliveMissed = 3;
constexpr int kUnheard_ms = 3000;

}  // namespace

LeaderLink::LeaderLink(const HostSurroundings& around, trust::KeyDirectory keys, const std::string& address)
    : around_(around), keys_(std::move(keys)) {
  link_ = std::make_shared<LinkSocket>(around_.pool, around_.context, zmq::socket_type::router,
                                       around_.links.counters(), *this);
  auto& socket = link_->socket();
  socket.set(zmq::sockopt::curve_server, true);
  socket.set(zmq::sockopt::curve_secretkey, around_.keys.secret.bytes());
  socket.set(zmq::sockopt::zap_domain, std::string("fiona"));
  socket.set(zmq::sockopt::handshake_ivl, kHandshake_ms);
  socket.set(zmq::sockopt::tcp_keepalive, 1);
  socket.set(zmq::sockopt::tcp_keepalive_idle, kAliveEvery_s);
  socket.set(zmq::sockopt::tcp_keepalive_intvl, kAliveEvery_s);
  socket.set(zmq::sockopt::tcp_keepalive_cnt, kAliveMissed);
  socket.set(zmq::sockopt::tcp_maxrt, kUnheard_ms);
  socket.set(zmq::sockopt::ipv6, address.find('[') != std::string::npos);
  try {
    if (!address.starts_with("tcp://")) throw zmq::error_t(EPROTONOSUPPORT);
    link_->listen_proven(address);
  } catch (const zmq::error_t& error) {
    throw Error(ErrorCode::Failed,
                {.what = "the host cannot listen at " + address,
                 .expected = "tcp://ADDRESS:PORT with an address of this machine; port 0: one that is free",
                 .found = error.what()});
  }
  address_ = link_->endpoint();
}

LeaderLink::~LeaderLink() { stop(); }

void LeaderLink::stop() {
  link_->stop();
  end("the host ends");
}

void LeaderLink::reply(const std::string& peer, const wire::HostFrame& host) {
  wire::Frame frame;
  *frame.mutable_host() = host;
  link_->tell(peer, frame);
}

/// What it is told is the last: nothing is kept of one that does not lead.
void LeaderLink::turn_away(const std::string& peer, const wire::HostFrame& frame) {
  reply(peer, frame);
  link_->drop(peer);
}

/// The wires to the leader are lost; its instances go on.
void LeaderLink::end(const std::string& reason) {
  const std::lock_guard delivering(delivering_);
  std::string name;
  std::string peer;
  {
    const std::lock_guard lock(mutex_);
    if (!session_ || session_->over) return;
    peer = session_->peer;
    session_->over = true;
    session_->lane = {};
    session_->reason = reason;
    session_->since = Steady::now();
    name = session_->name;
  }
  around_.links.part(std::string(Links::kHost), reason);
  link_->drop(peer);
  around_.on_change({.what = HostChange::What::Lost, .host = name, .reason = reason, .group = {}, .request = {}});
}

void LeaderLink::leave(std::uint64_t number) {
  {
    const std::lock_guard lock(mutex_);
    if (!session_ || session_->number != number) return;
  }
  end("host '" + leader() + "' has ended");
  const std::lock_guard lock(mutex_);
  session_.reset();
}

void LeaderLink::keep(const std::vector<trust::AllowedHost>& allowed) {
  std::string name, key;
  {
    const std::lock_guard lock(mutex_);
    if (!session_ || session_->over) return;
    name = session_->name;
    key = session_->key;
  }
  const auto is_it = [&](const auto& host) { return host.name == name && host.key.text() == key; };
  if (std::none_of(allowed.begin(), allowed.end(), is_it)) end("host '" + name + "' is no longer allowed to connect");
}

void LeaderLink::forgive(Steady::duration time) {
  const std::lock_guard lock(mutex_);
  if (session_) session_->heard = std::min(session_->heard + time, Steady::now());
}

void LeaderLink::tick(Steady::time_point now) {
  std::unique_lock lock(mutex_);
  if (!session_ || session_->over) return;
  const std::string peer = session_->peer;
  const bool silent = now - session_->heard > kSilence;
  const bool speak = now - spoke_ >= kBeatEvery;
  if (speak) spoke_ = now;
  wire::HostFrame frame;
  if (speak) *frame.mutable_beat() = offset_->beat(now_ns());
  lock.unlock();
  if (speak) reply(peer, frame);
  if (!silent) return;
  link_->read_now();  // the pool's threads may all be busy
  lock.lock();
  if (!session_ || session_->over || session_->peer != peer) return;
  const auto silence = std::chrono::duration_cast<std::chrono::milliseconds>(Steady::now() - session_->heard);
  const std::string reason =
      "host '" + session_->name + "', which leads, has been silent for " + std::to_string(silence.count()) + " ms";
  lock.unlock();
  if (silence > kSilence) end(reason);
}

std::optional<std::uint64_t> LeaderLink::accepts(const std::string& peer, const wire::Frame& frame) {
  {
    const std::lock_guard lock(mutex_);
    if (!session_ || session_->over || session_->peer != peer) return std::nullopt;
  }
  return frame.has_host() ? kHostsOwn : around_.links.accepts({link_, peer}, frame);
}

void LeaderLink::on_frame(const std::string& peer, const wire::Frame& given, const ObjectBytes& object) {
  if (given.host().has_hello()) return on_hello(peer, given.host().hello());
  const std::lock_guard delivering(delivering_);
  std::uint64_t session = 0;
  {
    const std::lock_guard lock(mutex_);
    if (session_ && !session_->over && session_->peer == peer) {
      session = session_->number;
      session_->heard = Steady::now();
    }
  }
  wire::HostFrame gone;
  gone.mutable_gone();
  if (session == 0) return turn_away(peer, gone);
  if (given.has_host()) return on_host_frame(session, host_frame_of(given, object));
  if (given.wire() == 0) return;
  wire::Frame frame = given;
  offset_->turn(frame);
  around_.links.on_frame({link_, peer}, frame, object);
}

void LeaderLink::on_host_frame(std::uint64_t session, wire::HostFrame host) {
  if (host.has_beat()) return offset_->heard(host.beat(), now_ns());
  HostChange change{
      .what = HostChange::What::Request, .host = {}, .reason = {}, .group = {}, .session = session, .request = {}};
  if (host.has_gone()) change.what = HostChange::What::Left;
  if (host.has_request()) change.request = std::move(*host.mutable_request());
  if (host.has_gone() || host.has_request()) around_.on_change(std::move(change));
}

/// By the list of now: the connection may be older than that. Empty: its key is not there any more.
std::string LeaderLink::name_of(const std::string& peer, const std::string& key) const {
  {
    const std::lock_guard lock(mutex_);
    if (session_ && !session_->over && session_->peer == peer) return session_->name;
  }
  try {
    for (const auto& one : keys_.allowed()) {
      if (one.key.text() == key) return one.name;
    }
  } catch (const Error&) {  // a list that cannot be read lets nobody new in
  }
  return "";
}

void LeaderLink::on_hello(const std::string& peer, const wire::HostHello& hello) {
  const std::string key = link_->process_of(peer);
  const std::string name = name_of(peer, key);
  wire::HostFrame frame;
  bool resumes = false;
  bool again = false;
  bool late = false;
  {
    const std::lock_guard lock(mutex_);
    resumes = session_ && session_->name == name && session_->key == key && session_->run == hello.run();
    again = resumes && !session_->over && session_->peer == peer;
    // Of connections that it has given up: the socket reads them in turn, and not in their order.
    late = resumes && hello.beat().now_ns() < session_->said_hello_ns;
    const auto lease = kLeadLease - (session_ ? Steady::now() - session_->heard : kLeadLease);
    if (name.empty()) {
      frame.mutable_refused()->set_reason("its key is no longer in the list of hosts that may connect");
    } else if (hello.version() != wire::VERSION_1) {
      frame.mutable_refused()->set_reason("it speaks another version of the protocol");
    } else if (session_ && !resumes && lease > Steady::duration::zero()) {
      const std::string which = session_->name == name ? "another run of '" : "'";
      frame.mutable_refused()->set_reason("host '" + around_.name + "' is led by " + which + session_->name +
                                          "': one host leads at a time");
    }
  }
  if (frame.has_refused()) return turn_away(peer, frame);
  if (late) return link_->drop(peer);
  if (!again) {
    end("host '" + name + "' has connected anew");
    const std::lock_guard delivering(delivering_);
    {
      const std::lock_guard lock(mutex_);
      session_ = Session{.number = ++sessions_,
                         .peer = peer,
                         .lane = link_->open_lane(peer),
                         .name = name,
                         .key = key,
                         .run = hello.run(),
                         .said_hello_ns = hello.beat().now_ns(),
                         .heard = Steady::now(),
                         .since = Steady::now(),
                         .reason = {}};
      if (!resumes) offset_ = std::make_unique<ClockOffset>();
    }
    // Without the lock: links have locks of their own, under which ports tell the leader what is tapped.
    around_.links.join(std::string(Links::kHost), {link_, peer});
    around_.on_change({.what = HostChange::What::Joined,
                       .host = name,
                       .reason = {},
                       .same_run = resumes,
                       .group = {},
                       .request = {}});
  }
  offset_->heard(hello.beat(), now_ns());
  auto& welcome = *frame.mutable_welcome();
  welcome.set_name(around_.name);
  welcome.set_run(around_.run);
  welcome.set_version(FIONA_VERSION);
  *welcome.mutable_beat() = offset_->beat(now_ns());
  reply(peer, frame);
}

void LeaderLink::answer(std::uint64_t session, const wire::GroupMessage& message) { say(message, session); }

void LeaderLink::tell(const wire::GroupMessage& event) {
  wire::GroupMessage message = event;
  message.set_id(0);
  say(message, 0);
}

/// To the leader of this session; 0: whoever leads. Of what is tapped the oldest goes when the leader is slow.
void LeaderLink::say(const wire::GroupMessage& message, std::uint64_t session) {
  const auto host = std::make_shared<wire::HostFrame>();
  *host->mutable_message() = message;
  wire::Frame frame;
  frame.mutable_host();
  const auto rule =
      message.has_tapped() && message.id() == 0 ? LinkSocket::Rule::DropOldest : LinkSocket::Rule::Control;
  const std::lock_guard lock(mutex_);
  if (!session_ || session_->over || (session != 0 && session_->number != session)) return;
  link_->send(session_->lane, frame, host, rule);
}

std::string LeaderLink::leader() const {
  const std::lock_guard lock(mutex_);
  return session_ && !session_->over ? session_->name : "";
}

std::optional<control::HostStatus> LeaderLink::status() const {
  const std::lock_guard lock(mutex_);
  if (!session_) return std::nullopt;
  control::HostStatus status;
  status.set_name(session_->name);
  status.set_state(session_->over ? "silent" : "leads");
  status.set_reason(session_->reason);
  status.set_since_s(to_seconds(Steady::now() - session_->since));
  status.set_clock_offset_ms(static_cast<double>(offset_->ahead_ns()) / 1e6);
  return status;
}

}  // namespace fiona::host
