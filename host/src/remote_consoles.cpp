#include "remote_consoles.hpp"

#include <fcntl.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <tuple>

#include "fiona/error.hpp"
#include "fiona/time.hpp"
#include "os/message_stream.hpp"
#include "os/unix_socket.hpp"
#include "peer_link.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;
using trust::Access;

constexpr std::uint32_t kCarriedVersion = 1;
/// How exactly silence is noticed, and how long what a slow console could not take waits before it is tried again.
constexpr std::chrono::milliseconds kLookEvery{50};
constexpr std::chrono::milliseconds kSpeakEvery{250};
constexpr std::chrono::seconds kCheckLevelsEvery{1};
/// How long the last words may take to leave.
constexpr int kCarriedFarewell_ms = 1000;
/// Of the stream in one message, and of a message.
constexpr std::size_t kCarriedChunk = 32 * 1024;
constexpr std::int64_t kLargestCarried = 64 * 1024;
/// Messages that wait for one console, or of one: with its chunks 2 MiB.
constexpr int kCarriedWaiting = 64;
/// Bytes of a console that the host has not read: a request, and the beginning of the next.
constexpr std::size_t kUnread = os::MessageStream::kMaxMessage + kLargestCarried;
/// Messages that are read before the others have their turn.
constexpr int kTurn = 256;

}  // namespace

struct RemoteConsoles::Console {
  os::Descriptor socket;  ///< its stream; the server has the other end
  control::ConsoleStatus status;
  Rights rights;
  std::string unread;  ///< what the server's end has not taken
  std::string unsent;  ///< what libzmq has not taken; a chunk
  Steady::duration silent{};
  Steady::time_point since = Steady::now();
};

RemoteConsoles::RemoteConsoles(const std::string& address, const trust::KeyDirectory& keys, const std::string& name,
                               OnConsole on_console, OnLog on_log)
    : keys_(keys),
      name_(name),
      on_console_(std::move(on_console)),
      zap_(context_, Zap::consoles(keys), std::move(on_log)),
      socket_(context_, zmq::socket_type::router) {
  const trust::KeyPair pair = keys_.pair();
  key_ = pair.open.text();
  socket_.set(zmq::sockopt::curve_server, true);
  socket_.set(zmq::sockopt::curve_secretkey, pair.secret.bytes());
  socket_.set(zmq::sockopt::zap_domain, std::string("fiona"));
  socket_.set(zmq::sockopt::handshake_ivl, kHandshake_ms);
  socket_.set(zmq::sockopt::router_mandatory, true);
  socket_.set(zmq::sockopt::maxmsgsize, kLargestCarried);
  socket_.set(zmq::sockopt::sndhwm, kCarriedWaiting);
  socket_.set(zmq::sockopt::rcvhwm, kCarriedWaiting);
  socket_.set(zmq::sockopt::linger, kCarriedFarewell_ms);
  // The kernel clears away who never says a word; not libzmq's heartbeat (decision 8).
  socket_.set(zmq::sockopt::tcp_keepalive, 1);
  socket_.set(zmq::sockopt::tcp_keepalive_idle, 5);
  socket_.set(zmq::sockopt::tcp_keepalive_intvl, 1);
  socket_.set(zmq::sockopt::tcp_keepalive_cnt, 3);
  socket_.set(zmq::sockopt::ipv6, address.find('[') != std::string::npos);
  try {
    if (!address.starts_with("tcp://")) throw zmq::error_t(EPROTONOSUPPORT);
    socket_.bind(address);
  } catch (const zmq::error_t& error) {
    throw Error(ErrorCode::Failed,
                {.what = "the host cannot serve consoles at " + address,
                 .expected = "tcp://ADDRESS:PORT with an address of this machine; port 0: one that is free",
                 .found = error.what()});
  }
  address_ = socket_.get(zmq::sockopt::last_endpoint);
  thread_ = std::thread([this] { serve(); });
}

RemoteConsoles::~RemoteConsoles() {
  stopping_ = true;
  thread_.join();
}

void RemoteConsoles::serve() {
  while (!stopping_) {
    wait();
    zap_.serve();
    receive();
    std::vector<std::string> gone;
    for (auto& [id, console] : consoles_) {
      if (!carry_from_server(id, console)) gone.push_back(id);
    }
    for (const auto& id : gone) end(id, "the host has closed the connection");
    tick(Steady::now());
  }
  while (!consoles_.empty()) {
    const std::string id = consoles_.begin()->first;
    carry_from_server(id, consoles_.begin()->second);  // the answer to `quit`
    end(id, "the host has ended");
  }
  socket_.close();
}

void RemoteConsoles::wait() {
  std::vector<zmq::pollitem_t> waits{{zap_.socket().handle(), 0, ZMQ_POLLIN, 0}, {socket_.handle(), 0, ZMQ_POLLIN, 0}};
  for (const auto& [id, console] : consoles_) {
    const bool more = console.unsent.empty();
    const bool writing = !console.unread.empty();
    const int events = (more ? ZMQ_POLLIN : 0) | (writing ? ZMQ_POLLOUT : 0);
    if (events != 0) waits.push_back({nullptr, console.socket.get(), static_cast<short>(events), 0});
  }
  static_cast<void>(::zmq_poll(waits.data(), static_cast<int>(waits.size()),
                               kLookEvery.count()));  // interrupted or not: all is looked at
}

void RemoteConsoles::receive() {
  for (int i = 0; i < kTurn; ++i) {
    zmq::message_t id;
    if (!received(socket_, id)) return;
    zmq::message_t message;
    bool whole = id.more() && received(socket_, message);
    for (bool more = whole && message.more(); more;) {  // no console sends a second frame
      zmq::message_t rest;
      more = received(socket_, rest) && rest.more();
      whole = false;
    }
    if (whole) take(id.to_string(), message);
    if (!whole && consoles_.contains(id.to_string())) end(id.to_string(), "this is not how a console speaks", true);
  }
}

void RemoteConsoles::take(const std::string& id, const zmq::message_t& message) {
  control::Carried carried;
  const bool readable = carried.ParseFromArray(message.data(), static_cast<int>(message.size()));
  const auto known = consoles_.find(id);
  if (known == consoles_.end()) {
    if (readable && carried.has_hello()) return begin(id, carried.hello(), message);
    return refuse(id, "the host has ended this connection");
  }
  known->second.silent = {};
  if (!readable || carried.has_hello() || carried.has_welcome())
    return end(id, "this is not how a console speaks", true);
  if (carried.has_ended()) return end(id, "");
  if (carried.has_stream() && !hand_to_server(known->second, carried.stream()))
    end(id, "this is more than the host reads", true);
}

void RemoteConsoles::begin(const std::string& id, const control::ConsoleHello& hello, const zmq::message_t& message) {
  const auto property = [&message](const char* name) {
    const char* value = ::zmq_msg_gets(const_cast<zmq_msg_t*>(message.handle()), name);
    return std::string(value ? value : "");
  };
  if (hello.version() != kCarriedVersion)
    return refuse(id, "it speaks another version of the protocol: are both of one version?  fiona version");
  if (consoles_.size() >= kMost) {
    ++turned_away_;
    return refuse(id, "host '" + name_ + "' has " + std::to_string(kMost) + " consoles over tcp already");
  }
  Console console;
  try {
    for (const auto& one : keys_.consoles()) {
      if (one.key.text() != property("User-Id")) continue;
      console.rights = {hello.control() ? one.level : std::min(one.level, Access::Observe), one.level, one.name,
                        one.key.text()};
    }
  } catch (const Error&) {
    console.rights = {};
  }
  if (!console.rights.is_remote()) return refuse(id, "its key is no longer in the list of consoles that may connect");
  os::Descriptor ours, theirs;
  try {
    std::tie(ours, theirs) = os::socket_pair();
  } catch (const Error& error) {
    ++turned_away_;
    return refuse(id, "host '" + name_ + "' cannot serve one more: " + error.text().what + ": " + error.text().found);
  }
  ::fcntl(ours.get(), F_SETFL, ::fcntl(ours.get(), F_GETFL) | O_NONBLOCK);
  console.socket = std::move(ours);
  console.status.set_name(console.rights.name);
  console.status.set_key(console.rights.key);
  console.status.set_address(property("Peer-Address"));
  console.status.set_level(static_cast<std::uint32_t>(console.rights.level));
  control::Carried answer;
  answer.mutable_welcome()->set_host(name_);
  answer.mutable_welcome()->set_level(console.status.level());
  if (send(id, answer) != Sent::Yes) return;
  const Rights rights = consoles_.emplace(id, std::move(console)).first->second.rights;
  tell(Steady::now());  // whoever asks who is connected is
  on_console_(std::move(theirs), rights);
}

/// False when too much waits there.
bool RemoteConsoles::hand_to_server(Console& console, const std::string& bytes) {
  console.unread += bytes;
  while (!console.unread.empty()) {
    const auto size = ::send(console.socket.get(), console.unread.data(), console.unread.size(), MSG_NOSIGNAL);
    if (size < 0) break;  // full, or closed: then reading tells
    console.unread.erase(0, static_cast<std::size_t>(size));
  }
  return console.unread.size() <= kUnread;
}

/// False when the server has closed its end, or the console is not there any more.
bool RemoteConsoles::carry_from_server(const std::string& id, Console& console) {
  if (!console.unread.empty()) hand_to_server(console, "");
  for (int i = 0; i < kTurn; ++i) {
    if (console.unsent.empty()) {
      char chunk[kCarriedChunk];
      const auto size = ::recv(console.socket.get(), chunk, sizeof chunk, 0);
      if (size == 0) return false;
      if (size < 0) return errno == EAGAIN || errno == EINTR;
      console.unsent.assign(chunk, static_cast<std::size_t>(size));
    }
    control::Carried carried;
    carried.set_stream(console.unsent);
    const Sent sent = send(id, carried);
    if (sent == Sent::Gone) return false;
    if (sent == Sent::Full) return true;
    console.unsent.clear();
  }
  return true;
}

/// Silence is counted by the time for which this thread was there to listen: a machine that stood still ends no
/// session.
void RemoteConsoles::tick(Steady::time_point now) {
  const auto passed = std::min<Steady::duration>(now - std::exchange(now_, now), 4 * kLookEvery);
  std::vector<std::pair<std::string, bool>> gone;
  const bool speak = now - spoke_ >= kSpeakEvery;
  if (speak) spoke_ = now;
  for (auto& [id, console] : consoles_) {
    console.silent += passed;
    const bool silent = console.silent > kSilence;
    if (silent || (speak && send(id, {}) == Sent::Gone)) gone.emplace_back(id, silent);
  }
  for (const auto& [id, silent] : gone) end(id, "it has been silent for too long", silent);
  if (now - checked_ >= kCheckLevelsEvery) check_levels();
  tell(now);
}

void RemoteConsoles::tell(Steady::time_point now) {
  std::vector<control::ConsoleStatus> told;
  for (auto& [id, console] : consoles_) {
    console.status.set_since_s(to_seconds(now - console.since));
    told.push_back(console.status);
  }
  const std::lock_guard lock(mutex_);
  told_ = std::move(told);
}

/// `keys forget` and another level end a session that is open. A list that cannot be read throws nobody out.
void RemoteConsoles::check_levels() {
  checked_ = Steady::now();
  if (consoles_.empty()) return;
  std::vector<trust::AllowedConsole> allowed;
  try {
    allowed = keys_.consoles();
  } catch (const Error&) {
    return;
  }
  std::vector<std::string> gone;
  for (const auto& [id, console] : consoles_) {
    const auto same = [&rights = console.rights](const auto& one) {
      return one.name == rights.name && one.key.text() == rights.key && one.level == rights.of_key;
    };
    if (std::none_of(allowed.begin(), allowed.end(), same)) gone.push_back(id);
  }
  for (const auto& id : gone) end(id, "what its key may do has been changed");
}

void RemoteConsoles::refuse(const std::string& id, const std::string& reason) {
  control::Carried last;
  last.mutable_ended()->set_reason(reason);
  send(id, last);
}

/// The server notices by the end of the stream.
void RemoteConsoles::end(const std::string& id, const std::string& reason, bool at_fault) {
  if (at_fault) ++ended_;
  if (!reason.empty()) refuse(id, reason);
  consoles_.erase(id);
}

RemoteConsoles::Sent RemoteConsoles::send(const std::string& id, const control::Carried& carried) {
  const std::string body = carried.SerializeAsString();
  try {
    if (!sent(socket_, zmq::buffer(id), zmq::send_flags::sndmore)) return Sent::Full;
    sent(socket_, zmq::buffer(body));
    return Sent::Yes;
  } catch (const zmq::error_t&) {
    return Sent::Gone;  // no such connection any more
  }
}

void RemoteConsoles::describe(control::System& system) const {
  system.set_serves(address_);
  system.set_key(key_);
  system.set_refused_consoles(zap_.refused() + turned_away_);
  system.set_ended_consoles(ended_);
  const std::lock_guard lock(mutex_);
  system.mutable_consoles()->Assign(told_.begin(), told_.end());
}

}  // namespace fiona::host
