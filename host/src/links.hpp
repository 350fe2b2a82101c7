#pragma once

#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "fiona/clock.hpp"
#include "remote_wire.hpp"

namespace fiona::host {

/// The links of one process: its listening endpoint and its connections to peers.
class Links {
 public:
  using OnLost = std::function<void(std::uint64_t wire, const std::string& reason)>;

  /// Listens at `endpoint` ("ipc:///run/…") for processes that know `key`, or one that the host has made of it for them.
  /// On a virtual clock, what comes takes its turn there.
  Links(Pool& pool, Clock& clock, std::string endpoint, std::string key, OnLost on_lost);
  ~Links();

  const std::string& endpoint() const { return endpoint_; }
  /// Closes the sockets: after it returned no message reaches a port any more.
  void stop();
  /// What they have carried and refused since the process started.
  control::LinkStatus status();
  /// Lets `peer` open `wire` to `provider` if it brings `token`.
  void provide(std::uint64_t wire, std::string token, std::string peer, ProvidedPort& provider, std::uint32_t prescale,
               std::string client_name);
  /// Where a link goes, and what opens it.
  struct Endpoint {
    std::string address;
    std::string name;  ///< of this process towards that one
    std::string key;   ///< of the link
  };
  /// [control thread] Opens `wire` from `client` to the process behind `endpoint`; then calls `switch_over`,
  /// which lets go of the wire that it replaces, and lets messages through. Throws Error Unreachable when the wire is
  /// not open in time, with the peer's reason when it refuses; the client's port is then as before.
  void require(std::uint64_t wire, const std::string& token, RequiredPort& client, const std::string& provider_name,
               const Endpoint& endpoint, const std::function<void()>& switch_over);
  /// Ends a wire on this side and tells the peer.
  void cut(std::uint64_t wire, const std::string& reason);
  /// Another wire has taken this one's place at its client: it goes once its open requests have ended.
  void retire(std::uint64_t wire);
  /// The ports of `hull` are going: so does what is left of their wires.
  void release(const Hull& hull);
  /// A process is gone, known by where it listened and by its name: its wires are lost, at both their ends.
  void peer_lost(const std::string& endpoint, const std::string& name, const std::string& reason);
  /// Of a process on a virtual clock: by where the peer listens, which is its name towards this process too.
  std::map<std::string, FrameCounts> frame_counts();

 private:
  struct Grant {
    std::string token;
    std::string peer;
    ProvidedPort* provider = nullptr;
    std::uint32_t prescale = 1;
    std::string client_name;
    std::shared_ptr<RemoteWire> wire;  ///< once opened
  };
  struct Requirement {
    RequiredPort* client = nullptr;
    std::string endpoint;
    std::string provider_name;
    std::shared_ptr<RemoteWire> wire;
    std::optional<std::string> refusal;  ///< once the peer has answered; empty: open
    bool retired = false;
  };
  class Server;
  class Client;
  struct Peer {
    std::unique_ptr<Client> client;
    std::unique_ptr<LinkSocket> link;
    ~Peer();
    Peer();
    Peer(Peer&&) noexcept;
    Peer& operator=(Peer&&) noexcept;
  };

  bool server_accepts(const std::string& peer, const wire::Frame& frame);
  void on_server_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes& object);
  bool client_accepts(const std::string& endpoint, const wire::Frame& frame);
  void on_client_frame(const std::string& endpoint, const wire::Frame& frame, const ObjectBytes& object);
  void on_client_refused(const std::string& endpoint, const std::string& reason);
  void on_closed(std::uint64_t wire, const std::string& reason);
  std::shared_ptr<RemoteWire> granted(const std::string& peer, std::uint64_t wire);
  std::shared_ptr<RemoteWire> required(const std::string& endpoint, std::uint64_t wire);
  void note_foreign(std::uint64_t wire);
  void note_ended(std::uint64_t wire);
  void open_for(const std::string& peer, const wire::Frame& frame);
  std::shared_ptr<RemoteWire> wire_for(const std::string& peer, std::uint64_t wire, const Grant& grant);
  void refuse(const std::string& peer, std::uint64_t wire, const std::string& reason);
  void note_answer(std::uint64_t wire, const std::string& refusal);
  LinkSocket& connect(const Endpoint& endpoint);
  std::function<void()> on_dealt_with() const;

  Pool& pool_;
  VirtualClock* const clock_;  ///< null: the system's
  zmq::context_t context_;
  const std::string endpoint_;
  const OnLost on_lost_;
  std::mutex mutex_;
  std::condition_variable answered_;  ///< a requirement has its answer
  std::map<std::uint64_t, Grant> grants_;
  std::map<std::uint64_t, Requirement> requirements_;
  std::map<std::string, Peer> peers_;  ///< by endpoint
  std::map<std::pair<std::string, const Port*>, std::weak_ptr<FanOut>> fan_outs_;  ///< by client process and provider
  std::deque<std::uint64_t> ended_;  ///< wires whose last frames may still come
  LinkCounters counters_;
  std::unique_ptr<Server> receiver_;
  std::unique_ptr<LinkSocket> server_;
};

}  // namespace fiona::host
