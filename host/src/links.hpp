#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>

#include "fiona/clock.hpp"
#include "in_use.hpp"
#include "remote_wire.hpp"

namespace fiona::host {

/// Where frames come from and go to: a socket, and on one that listens the peer's identity.
struct Hop {
  std::shared_ptr<LinkSocket> link;
  std::string peer;
  bool operator==(const Hop&) const = default;
};

/// The links of one process: its listening endpoint and its connections to peers.
class Links {
 public:
  using OnLost = std::function<void(std::uint64_t wire, const std::string& reason)>;
  /// What the endpoint of another host begins with; alone it is the one that leads this one.
  static constexpr std::string_view kHost = "host:";

  /// Listens at `endpoint` ("ipc:///run/…") for processes that know the key that the host has made of `keys.own` for
  /// them. On a virtual clock, what comes takes its turn there.
  Links(Pool& pool, Clock& clock, std::string endpoint, LinkKeys keys, OnLost on_lost);
  ~Links();

  const std::string& endpoint() const { return endpoint_; }
  /// Closes the sockets: after it returned no message reaches a port any more.
  void stop();
  /// What they have carried and refused since the process started.
  control::LinkStatus status();
  /// Of all links of the process.
  LinkCounters& counters() { return counters_; }
  /// Lets `peer`, a process's name or another host's endpoint, open `wire` to `provider` if it brings `token`.
  /// `attached`: it is no process of a host, and `on_lost` is told when the wire ends.
  void provide(std::uint64_t wire, std::string token, std::string peer, ProvidedPort& provider, std::uint32_t prescale,
               std::string client_name, bool attached = false);
  /// It is not provided after all: who is ahead of its grant is told.
  void deny(std::uint64_t wire, const std::string& reason);
  /// Where a link goes, and what opens it.
  struct Endpoint {
    std::string address;
    std::string name;  ///< of this process towards that one
    std::string key;   ///< of the link
  };
  /// [control thread] Opens `wire` from `client` to the process behind `endpoint`; then calls `switch_over`,
  /// which lets go of the wire that it replaces, and lets messages through. Throws Error Unreachable when the wire is
  /// not open in time, with the peer's reason when it refuses; the client's port is then as before. `ahead`: the
  /// provider may be told of it later than it is asked. `resumes_every` > 0: what the provider has put since the wire
  /// `replaces` was lost is counted as dropped.
  void require(std::uint64_t wire, const std::string& token, const std::shared_ptr<WireEnd>& client,
               const Endpoint& endpoint, bool ahead, std::uint64_t replaces, std::uint32_t resumes_every,
               const std::function<void()>& switch_over);
  /// Passes `wire` on between `peer`, which opens it with `token`, and the process at `endpoint`, unread. What is here
  /// is bounded: a push loses its oldest, and of all else a sender has credit for it only once it has left.
  void relay(std::uint64_t wire, std::string token, std::string peer, Endpoint endpoint);
  /// Ends a wire on this side and tells the peer; `now`: what it is for its client if that is here.
  void cut(std::uint64_t wire, const std::string& reason, Connection now = Connection::Unwired);
  /// Another wire takes this one's place at its client: it goes once its open requests have ended. `drains`, of a push
  /// that still serves: once all that its provider has put has come, which is waited for, but not for one that hangs.
  void retire(std::uint64_t wire, bool drains);
  /// [control thread] The ports of `hull` are going: so does what is left of their wires. After it returned no thread
  /// of a link uses them.
  void release(const Hull& hull, const std::string& reason, Connection now = Connection::Unwired);
  /// A process is gone, known by where it listened and by its name: its wires are lost, at both their ends.
  void peer_lost(const std::string& endpoint, const std::string& name, const std::string& reason);
  /// Of a push that is provided here. Throws Error NotFound if it is not any more.
  void set_prescale(std::uint64_t wire, std::uint32_t prescale);
  /// All ends that are here, other than of wires within the process.
  void add_held(wire::Adopted& adopted);
  /// Ends the wires of processes that are no group's.
  void cut_attached(const std::string& reason);
  /// Of a process on a virtual clock: by where the peer listens, which is its name towards this process too.
  std::map<std::string, FrameCounts> frame_counts();
  /// [any thread] Another host can be reached, at the endpoint "host:…", over a socket that is not owned here.
  void join(const std::string& endpoint, Hop hop);
  /// [any thread] The host behind `endpoint` is gone: the wires that go there are lost.
  void part(const std::string& endpoint, const std::string& reason);
  /// [any thread] What has come from there, or from a peer of a socket of ours.
  std::optional<std::uint64_t> accepts(const Hop& from, const wire::Frame& frame);
  void on_frame(const Hop& from, const wire::Frame& frame, const ObjectBytes& object,
                ArrivingObjects* together = nullptr);

 private:
  struct Grant {
    std::string token;
    std::string peer;
    ProvidedPort* provider = nullptr;
    std::uint32_t prescale = 1;
    std::string client_name;
    bool attached = false;
    std::shared_ptr<RemoteWire> wire;  ///< once opened
    Hop client;                        ///< once opened
  };
  struct Requirement {
    std::shared_ptr<WireEnd> client;
    std::string endpoint;
    Hop provider;
    std::shared_ptr<RemoteWire> wire;
    std::optional<std::string> refusal;  ///< once the peer has answered; empty: open
    std::uint64_t from_sequence = 0;     ///< once open: what was put after this comes
    bool retired = false;
    std::optional<std::string> lost{};  ///< why its link is; kept until another wire takes its place, or it is cut
    bool passed_over = false;           ///< retired, and its end was not waited for: it goes when that comes
    std::uint64_t replaces = 0;         ///< a push's: asked for its end as soon as this one is open; 0: none
  };
  /// What comes from one side in one lane leaves in one, so that its order stays.
  class RelayLane;
  struct Relay {
    struct Side {
      Hop hop;
      std::shared_ptr<RelayLane> lane;  ///< towards it, once an object has gone there
      /// Bytes that wait for it without costing credit.
      std::shared_ptr<std::atomic<std::size_t>> free = std::make_shared<std::atomic<std::size_t>>(0);
    };
    std::string token;
    std::string peer;
    Endpoint endpoint;
    Side client;  ///< once opened, as is the other
    Side provider;
  };
  /// Of one lane of the hop where it comes from, to the other.
  using RelayWay = std::tuple<LinkSocket*, std::string, std::uint64_t, LinkSocket*, std::string>;
  /// What asks for a wire that nobody has granted yet.
  struct Early {
    Hop from;
    wire::Frame frame;
  };
  class Receiver;
  struct Peer {
    std::unique_ptr<Receiver> receiver;  ///< none: another host's, which is not ours
    Hop hop;
    ~Peer();
    Peer();
    Peer(Peer&&) noexcept;
    Peer& operator=(Peer&&) noexcept;
  };

  /// The end of a wire that is here, as that peer may use it.
  struct End {
    std::shared_ptr<RemoteWire> wire;
    bool provides = false;
  };
  void on_client_frame(const Hop& from, const wire::Frame& frame, std::shared_ptr<RemoteWire> wire,
                       const ObjectBytes& object, ArrivingObjects* together);
  void on_refused(const Hop& from, const std::string& reason);
  void on_closed(std::uint64_t wire, const std::string& reason);
  End end_of(const Hop& from, std::uint64_t wire, const wire::Frame& frame);
  End end_of_locked(const Hop& from, std::uint64_t wire, const wire::Frame& frame);
  End find_end(const Hop& from, std::uint64_t wire) const;
  bool may_open(const Hop& from, const std::string& peer);
  void open_relay(const Hop& from, const wire::Frame& frame, Relay& relay);
  bool is_relayed(const wire::Frame& frame);
  const wire::Frame* pass_on(const Hop& from, const wire::Frame& frame, const ObjectBytes& object,
                             const std::shared_ptr<const Payload>& payload, wire::Frame& rest);
  void cut_relay(std::uint64_t wire, const std::string& reason);
  bool forward(const Hop& from, Relay::Side& to, const wire::Frame& frame, const ObjectBytes& object,
               const std::shared_ptr<const Payload>& payload);
  std::shared_ptr<RemoteWire> to_end(std::uint64_t wire) const;
  bool await_end(std::uint64_t wire);
  std::optional<std::string> loss_of(std::uint64_t wire);
  void count_missed(std::uint64_t wire, std::uint64_t replaces, std::uint32_t every);
  void lose(const std::string& endpoint, const std::string& name, const std::string& reason);
  static void tell_lost(const Hop& to, std::uint64_t wire, std::size_t messages);
  void lose_relays(const std::string& endpoint, const std::string& name, const std::string& reason);
  void note_foreign(std::uint64_t wire, const wire::Frame& frame);
  void note_ended(std::uint64_t wire);
  void open_for(const Hop& from, const wire::Frame& frame);
  void open_grant(const Hop& from, const wire::Frame& frame, Grant& grant);
  void keep_early(const Hop& from, const wire::Frame& frame);
  std::optional<Early> take_early(std::uint64_t wire);
  bool has_ended(std::uint64_t wire) const;
  std::shared_ptr<RemoteWire> wire_for(const Hop& from, std::uint64_t wire, const Grant& grant);
  void refuse(const Hop& from, std::uint64_t wire, const std::string& reason);
  void note_answer(std::uint64_t wire, const std::string& refusal, const wire::Opened& opened = {});
  Hop connect(const Endpoint& endpoint);
  std::function<void()> on_dealt_with() const;

  Pool& pool_;
  VirtualClock* const clock_;  ///< null: the system's
  zmq::context_t context_;
  const std::string endpoint_;
  const std::string memory_key_;
  const OnLost on_lost_;
  InUse ports_in_use_;  ///< by threads of links, and by who cuts
  std::mutex mutex_;
  std::condition_variable answered_;  ///< a requirement has its answer
  std::map<std::uint64_t, Grant> grants_;
  std::map<std::uint64_t, Requirement> requirements_;
  LinkCounters counters_;
  std::map<std::uint64_t, Relay> relays_;
  std::map<RelayWay, std::weak_ptr<RelayLane>> relay_lanes_;
  std::map<std::string, Peer> peers_;  ///< by endpoint
  /// By client process and provider.
  std::map<std::tuple<LinkSocket*, std::string, const Port*>, std::weak_ptr<FanOut>> fan_outs_;
  std::deque<Early> early_;          ///< a few of each peer, the oldest first
  std::deque<std::uint64_t> ended_;  ///< wires whose last frames may still come
  std::unique_ptr<Receiver> receiver_;
  std::shared_ptr<LinkSocket> server_;
};

}  // namespace fiona::host
