#include "remote_link.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fmt/format.h>
#include <zmq.hpp>

#include "fiona/control.pb.h"
#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr std::uint32_t kVersion = 1;
constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kSpeakEvery{250};
/// A host that has said nothing for so long has gone: told within 2 s.
constexpr std::chrono::milliseconds kSilence{1500};
constexpr int kHandshake_ms = 3000;
/// How long the last word may take to leave.
constexpr int kFarewell_ms = 100;
constexpr std::size_t kChunk = 32 * 1024;
constexpr std::int64_t kLargest = 64 * 1024;
/// Messages that wait in either direction: with their chunks 2 MiB.
constexpr int kWaiting = 64;
constexpr std::size_t kLongestReason = 500;
constexpr std::size_t kLongestName = 40;

}  // namespace

/// The thread's part.
class RemoteLink::Carrier {
 public:
  Carrier(RemoteLink& link, const RemoteAddress& host, const trust::KeyPair& keys, bool control)
      : link_(link),
        host_(host),
        keys_(keys),
        control_(control),
        socket_(context_, zmq::socket_type::dealer),
        monitor_(context_, zmq::socket_type::pair) {}

  void run() {
    open();
    while (!link_.stopping_ && !over_) {
      wait();
      read_monitor();
      receive();
      carry_to_host();
      speak_and_listen(std::chrono::steady_clock::now());
    }
    control::Carried last;
    last.mutable_ended();
    send(last);
  }

 private:
  void open() {
    socket_.set(zmq::sockopt::curve_serverkey, host_.key.bytes());
    socket_.set(zmq::sockopt::curve_publickey, keys_.open.bytes());
    socket_.set(zmq::sockopt::curve_secretkey, keys_.secret.bytes());
    socket_.set(zmq::sockopt::immediate, true);    // nothing waits for a connection that may never come
    socket_.set(zmq::sockopt::reconnect_ivl, -1);  // each connection is a session; the console connects again
    socket_.set(zmq::sockopt::handshake_ivl, kHandshake_ms);
    socket_.set(zmq::sockopt::maxmsgsize, kLargest);
    socket_.set(zmq::sockopt::sndhwm, kWaiting);
    socket_.set(zmq::sockopt::rcvhwm, kWaiting);
    socket_.set(zmq::sockopt::linger, kFarewell_ms);
    socket_.set(zmq::sockopt::ipv6, host_.address.find('[') != std::string::npos);
    constexpr const char* kMonitor = "inproc://monitor";
    ::zmq_socket_monitor(socket_.handle(), kMonitor,
                         ZMQ_EVENT_CLOSED | ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_SUCCEEDED |
                             ZMQ_EVENT_HANDSHAKE_FAILED_AUTH | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                             ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL);
    monitor_.set(zmq::sockopt::linger, 0);
    monitor_.connect(kMonitor);
    socket_.connect("tcp://" + host_.address);
  }

  void wait() {
    std::array<zmq::pollitem_t, 3> waits{
        {{monitor_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, link_.far_, 0, 0}, {socket_.handle(), 0, ZMQ_POLLIN, 0}}};
    waits[1].events =
        static_cast<short>((welcome_ && unsent_.empty() ? ZMQ_POLLIN : 0) | (unread_.empty() ? 0 : ZMQ_POLLOUT));
    // While the console does not read, nothing is taken from the host, which feels that.
    static_cast<void>(::zmq_poll(waits.data(), unread_.empty() ? 3 : 2, kTick.count()));
  }

  void read_monitor() {
    zmq::message_t event;
    while (monitor_.recv(event, zmq::recv_flags::dontwait)) {
      std::uint16_t kind = 0;
      if (event.size() >= sizeof kind) std::memcpy(&kind, event.data(), sizeof kind);
      zmq::message_t address;
      if (!monitor_.recv(address, zmq::recv_flags::dontwait)) return;
      if (kind == ZMQ_EVENT_HANDSHAKE_SUCCEEDED) {
        shaken_ = true;
        continue;
      }
      closed_ = true;
      if (kind == ZMQ_EVENT_HANDSHAKE_FAILED_AUTH) refused_by_key();
      if (kind == ZMQ_EVENT_CLOSED)
        fail({.what = "no host serves consoles there", .next = "on that machine: fiona run FILE --serve ADDRESS:PORT"});
      if (!shaken_)
        fail({.what = "no handshake: the key of that host is another one, or it is no host of FIONA",
              .next = "on that machine: fiona keys show"});
    }
  }

  void refused_by_key() {
    fail({.what = "the host does not let this console in: its key is not in the list there",
          .next = fmt::format("on that machine: fiona keys allow NAME {} as observe", keys_.open.text())},
         ErrorCode::NotAllowed);
  }

  void fail(ErrorText text, ErrorCode code = ErrorCode::Unreachable) {
    text.where = "tcp://" + host_.address;
    link_.settle(std::pair(code, std::move(text)));
  }

  void receive() {
    zmq::message_t message;
    while (unread_.empty() && socket_.recv(message, zmq::recv_flags::dontwait)) {
      silent_ = {};
      control::Carried carried;
      if (message.more() || !carried.ParseFromArray(message.data(), static_cast<int>(message.size())))
        return end("it does not speak as a host does");
      if (carried.has_welcome() && !welcome_) be_welcome(carried.welcome());
      if (carried.has_stream()) hand_to_console(carried.stream());
      if (carried.has_ended()) return end(carried.ended().reason());
    }
    if (!unread_.empty()) hand_to_console("");
    if (!closed_ || !unread_.empty()) return;
    fail({.what = "the connection has ended", .next = "see whether the host still runs, on its machine: ls hosts"});
    end("the connection has ended");
  }

  void be_welcome(const control::ConsoleWelcome& welcome) {
    welcome_ = true;
    // Not written again: whoever has seen that it is settled reads it without the lock.
    link_.host_ = inert(welcome.host().substr(0, kLongestName));
    link_.level_ = trust::access_text(static_cast<trust::Access>(std::min(welcome.level(), 10U)));
    link_.settle(std::nullopt);
  }

  void hand_to_console(const std::string& bytes) {
    unread_ += bytes;
    while (!unread_.empty()) {
      const ssize_t size = ::send(link_.far_, unread_.data(), unread_.size(), MSG_NOSIGNAL);
      if (size < 0) return;
      unread_.erase(0, static_cast<std::size_t>(size));
    }
  }

  void carry_to_host() {
    while (welcome_ && !over_) {
      if (unsent_.empty()) {
        std::array<char, kChunk> chunk;
        const ssize_t size = ::recv(link_.far_, chunk.data(), chunk.size(), 0);
        if (size == 0) over_ = true;  // the console has closed it
        if (size <= 0) return;
        unsent_.assign(chunk.data(), static_cast<std::size_t>(size));
      }
      control::Carried carried;
      carried.set_stream(unsent_);
      if (!send(carried)) return;
      unsent_.clear();
    }
  }

  /// Silence is counted by the time for which this thread was there to listen.
  void speak_and_listen(SteadyTime now) {
    const auto passed = std::min<SteadyTime::duration>(now - std::exchange(now_, now), 4 * kTick);
    if (now - spoke_ >= kSpeakEvery) {
      control::Carried carried;
      if (!said_hello_) {
        carried.mutable_hello()->set_version(kVersion);
        carried.mutable_hello()->set_control(control_);
      }
      if (send(carried)) {
        said_hello_ = true;
        spoke_ = now;
      }
    }
    silent_ = welcome_ && unread_.empty() ? silent_ + passed : SteadyTime::duration{};
    if (silent_ > kSilence) end("it has been silent for 1.5 s");
  }

  bool send(const control::Carried& carried) {
    const std::string body = carried.SerializeAsString();
    return socket_.send(zmq::buffer(body), zmq::send_flags::dontwait).has_value();
  }

  void end(const std::string& reason) {
    over_ = true;
    if (reason_.empty()) reason_ = inert(reason.substr(0, kLongestReason));
    fail({.what = "the host refuses this console: " + reason_, .next = "ask whoever runs it"}, ErrorCode::NotAllowed);
    const std::lock_guard lock(link_.mutex_);
    link_.reason_ = reason_;
  }

  RemoteLink& link_;
  const RemoteAddress& host_;
  const trust::KeyPair& keys_;
  const bool control_;
  zmq::context_t context_;
  zmq::socket_t socket_;
  zmq::socket_t monitor_;
  std::string unread_;  ///< what the console has not taken
  std::string unsent_;  ///< what libzmq has not taken; a chunk
  std::string reason_;
  bool shaken_ = false;
  bool said_hello_ = false;
  bool welcome_ = false;
  bool closed_ = false;  ///< the connection; what has come may still lie here
  bool over_ = false;
  SteadyTime now_ = std::chrono::steady_clock::now();
  SteadyTime spoke_{};
  SteadyTime::duration silent_{};
};

RemoteLink::RemoteLink(const RemoteAddress& host, bool control) : address_(host.address) {
  const trust::KeyPair keys = trust::KeyDirectory().pair();
  std::array<int, 2> ends{};
  settled_ = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (settled_ < 0 || ::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends.data()) != 0)
    throw Error(ErrorCode::Failed, {.what = fmt::format("no sockets can be made: {}", std::strerror(errno)),
                                    .next = "raise the limit of descriptors: ulimit -n"});
  near_ = ends[0];
  far_ = ends[1];
  thread_ = std::thread([this, host, keys, control] { carry(host, keys, control); });
}

RemoteLink::~RemoteLink() {
  stopping_ = true;
  ::shutdown(near_, SHUT_RDWR);
  thread_.join();
  for (const int descriptor : {near_, far_, settled_}) ::close(descriptor);
}

void RemoteLink::await_welcome(Reactor& reactor, std::chrono::milliseconds timeout) const {
  struct Watching {
    Reactor& reactor;
    const int descriptor;
    ~Watching() { reactor.remove(descriptor); }
  } const watching{reactor, settled_};
  bool settled = false;
  reactor.add(settled_, [&settled] { settled = true; });
  reactor.run_until([&settled] { return settled; }, std::chrono::steady_clock::now() + timeout);
  const std::lock_guard lock(mutex_);
  if (problem_) throw Error(problem_->first, problem_->second);
  if (welcome_) return;
  throw Error(ErrorCode::Unreachable, ErrorText{.what = "no host answers in time",
                                                .where = "tcp://" + address_,
                                                .next = "is the address right?  more time: --timeout 10s"});
}

void RemoteLink::carry(const RemoteAddress& host, const trust::KeyPair& keys, bool control) {
  try {
    Carrier(*this, host, keys, control).run();
  } catch (const zmq::error_t& error) {
    settle(std::pair(ErrorCode::Unreachable,
                     ErrorText{.what = fmt::format("no connection can be made: {}", error.what()),
                               .where = "tcp://" + host.address,
                               .next = "see whether that is an address, and the limits: ulimit -a"}));
  }
  ::shutdown(far_, SHUT_RDWR);  // what has been handed over can still be read
}

/// Welcome, or why not; the first word counts.
void RemoteLink::settle(std::optional<std::pair<ErrorCode, ErrorText>> problem) {
  const std::lock_guard lock(mutex_);
  if (welcome_ || problem_) return;
  welcome_ = !problem;
  problem_ = std::move(problem);
  const std::uint64_t one = 1;
  static_cast<void>(::write(settled_, &one, sizeof one));
}

std::string RemoteLink::reason() const {
  const std::lock_guard lock(mutex_);
  return reason_;
}

}  // namespace fiona::console
