#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "clock_offset.hpp"
#include "fiona/clock.hpp"
#include "fiona/error.hpp"
#include "fiona/trust/host_keys.hpp"
#include "group_subjects.hpp"
#include "links.hpp"
#include "registry.hpp"

namespace fiona::host {

/// Silence of a peer is noticed within 1.5 s over tcp (docs/hosts.md, When something breaks).
inline constexpr std::chrono::milliseconds kBeatEvery{200};
inline constexpr std::chrono::milliseconds kSilence{1000};
/// How long one that led, and went silent, keeps others from leading.
inline constexpr std::chrono::milliseconds kLeadLease{1500};

/// What another host may say, and nobody has come to yet: it costs no credit. Of taps the newest is kept, whatever
/// there is of them.
inline constexpr std::size_t kMostUnread = 64U << 20U;

/// No wire: what hosts say to each other.
inline constexpr std::uint64_t kHostsOwn = 0;
/// How long the proof of the keys may take.
inline constexpr int kHandshake_ms = 3000;

/// What has happened between hosts, for the thread that changes the system.
struct HostChange {
  enum class What { Joined, Lost, Left, GroupEnded, Request };
  What what;
  std::string host;
  std::string reason;
  bool same_run = false;      ///< joined: as before, so that what was there may still be
  std::string group;          ///< that has ended
  std::uint64_t session = 0;  ///< that a request belongs to
  wire::HostRequest request;
};

/// What both sides of a connection between hosts need.
struct HostSurroundings {
  std::string name;   ///< of this host
  std::uint64_t run;  ///< of this host
  trust::KeyPair keys;
  Pool& pool;
  Clock& clock;
  Links& links;
  zmq::context_t& context;
  std::function<void(wire::GroupMessage)> on_event;  ///< [any thread] of instances that another host holds for us
  std::function<void(HostChange)> on_change;         ///< [any thread]
  std::unique_ptr<Registry> registry{};              ///< null: none
};

/// A host that this one leads.
struct PeerAddress {
  std::string name;
  std::string address;  ///< "tcp://HOST:PORT"; empty: as the registry says
  trust::Key key;
  /// "NAME=HOST:PORT=KEY" or "NAME=KEY". Throws Error Usage.
  static PeerAddress from_text(const std::string& text);
};

/// What a Frame says between hosts, which may be its object. One that does not parse is empty.
wire::HostFrame host_frame_of(const wire::Frame& frame, const ObjectBytes& object);

/// The connection to a host that this one leads. It is made anew, with a growing and jittered pause, until it holds;
/// whatever was under way when it broke is told to have ended. Each time it joins is a session of its own.
class PeerLink {
 public:
  PeerLink(const HostSurroundings& around, PeerAddress peer);
  ~PeerLink();

  /// How long it waits, and by how much longer it may, as chance will have it.
  struct Pause {
    unsigned least_ms;
    unsigned spread_ms;
  };

  const PeerAddress& peer() const { return peer_; }
  /// Its name among the links of this host.
  std::string endpoint() const { return std::string(Links::kHost) + peer_.name; }
  /// [the host links' thread] Beats, watches for silence, connects again.
  void tick(std::chrono::steady_clock::time_point now);
  /// For so long the peer could not be heard, by no fault of its own.
  void forgive(std::chrono::steady_clock::duration time);
  /// [the host links' thread, or none any more]
  void stop();

  /// [control thread] Asks the host for something in one of its groups. Throws Error Unreachable when it is not
  /// joined, leaves, or does not answer in time. `meanwhile`: done again and again while it is waited for.
  wire::GroupMessage request(const std::string& group, const wire::GroupRequest& request,
                             std::chrono::milliseconds deadline, const std::function<void()>& meanwhile = nullptr);
  /// [control thread] The same, and nobody waits for the answer. False: it is not joined.
  bool tell(const std::string& group, const wire::GroupRequest& request);
  /// [control thread] What it was told in sessions that have ended, and did not answer.
  std::vector<wire::GroupRequest> take_unanswered(const std::string& group);
  bool joined() const;
  /// "tcp://HOST:PORT"; empty: the registry has not had it so far.
  std::string address() const;
  /// Joined, or the first try to connect to it has ended.
  bool was_tried() const;
  /// [control thread] What it has said so far has been dealt with.
  void was_read() { unread_ = 0; }
  control::HostStatus status() const;

 private:
  class Incoming;
  enum class State { Connecting, Joined, Silent, Refused };

  void try_open(std::chrono::steady_clock::time_point now);
  void find();
  void open();
  void close(State next, const std::string& reason, std::chrono::steady_clock::time_point open_at,
             std::chrono::milliseconds linger = {});
  void read_monitor(std::chrono::steady_clock::time_point now);
  std::chrono::milliseconds by_chance(const Pause& pause);
  void say_hello();
  void beat();
  void send(const wire::HostFrame& frame);
  std::optional<std::uint64_t> accepts(const Hop& hop, const wire::Frame& frame);
  void on_frame(const Hop& hop, const wire::Frame& given, const ObjectBytes& object);
  void on_host_frame(const Hop& hop, const wire::HostFrame& host);
  void on_welcome(const Hop& hop, const wire::HostWelcome& welcome);
  std::uint64_t ask(const std::string& group, const wire::GroupRequest& request);
  void on_message(const wire::GroupMessage& message);
  bool believes(const wire::GroupMessage& event);
  bool says_too_much(const wire::GroupMessage& message);
  void enter(State state, const std::string& reason);
  Error unreachable() const;
  std::string has_ended() const { return "the connection to host '" + peer_.name + "' has ended"; }
  std::int64_t now_ns() const { return around_.clock.now().time_since_epoch().count(); }

  const HostSurroundings& around_;
  const PeerAddress peer_;
  std::string address_;  ///< empty: not known so far
  ClockOffset offset_;
  mutable std::mutex mutex_;
  std::condition_variable answered_;
  std::unique_ptr<Incoming> incoming_;  ///< of the newest socket
  std::shared_ptr<LinkSocket> link_;
  LinkSocket::Lane lane_;  ///< of what is asked, in its order
  zmq::socket_t monitor_;
  std::uint64_t sockets_ = 0;
  State state_ = State::Connecting;
  std::string reason_;
  std::chrono::steady_clock::time_point since_ = std::chrono::steady_clock::now();
  std::chrono::steady_clock::time_point heard_{};
  std::chrono::steady_clock::time_point spoke_{};
  std::chrono::steady_clock::time_point open_at_{};
  std::optional<std::string> end_;                        ///< the session is to end, and why
  bool no_handshake_ = false;                             ///< the connection came about, and no more
  bool closed_ = false;                                   ///< the connection has ended, or was not taken
  int tries_ = 0;                                         ///< since it was joined last; counted to two
  bool tried_ = false;                                    ///< a connection has ended
  std::chrono::steady_clock::time_point next_attempt_{};  ///< at the earliest, if this one fails
  std::chrono::steady_clock::time_point give_up_at_{};
  std::optional<std::uint64_t> run_;  ///< of the peer, when it was joined last
  std::string version_;
  std::map<std::uint64_t, std::optional<wire::GroupMessage>> pending_;
  struct Told {
    std::uint64_t session = 0;
    std::string group;
    wire::GroupRequest request;
  };
  std::map<std::uint64_t, Told> told_;             ///< what nobody waits for, until it is answered
  std::map<std::string, GroupSubjects> subjects_;  ///< by the host's group
  Disbelief disbelief_;
  std::uint64_t session_ = 0;
  std::uint64_t next_id_ = 1;
  std::atomic<std::size_t> unread_{0};  ///< bytes
  std::minstd_rand random_;
};

}  // namespace fiona::host
