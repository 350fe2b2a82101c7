#pragma once

#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "remote_wire.hpp"

namespace fiona::host {

/// Where frames come from and go to: a socket, and on one that listens the peer's identity.
struct Hop {
  LinkSocket* link = nullptr;
  std::string peer;
  bool operator==(const Hop&) const = default;
};

/// The links of one process: its listening endpoint and its connections to peers.
class Links {
 public:
  using OnLost = std::function<void(std::uint64_t wire, const std::string& reason)>;

  /// Listens at `endpoint` ("ipc:///run/…").
  Links(Pool& pool, std::string endpoint, OnLost on_lost);
  ~Links();

  const std::string& endpoint() const { return endpoint_; }
  /// Closes the sockets: after it returned no message reaches a port any more.
  void stop();
  /// Lets a peer open `wire` to `provider` if it brings `token`.
  void provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale);
  /// [control thread] Opens `wire` from `client` to the process that listens at `endpoint`; then calls `switch_over`,
  /// which lets go of the wire that it replaces, and lets messages through. Throws Error Unreachable when the wire is
  /// not open in time, with the peer's reason when it refuses; the client's port is then as before.
  void require(std::uint64_t wire, const std::string& token, RequiredPort& client, const std::string& provider_name,
               const std::string& endpoint, std::uint64_t replaces, std::uint32_t resumes_every,
               const std::function<void()>& switch_over);
  /// Passes `wire` on between whoever opens it with `token` and the process at `endpoint`, frame by frame: its credit,
  /// which both ends keep, bounds what is here.
  void relay(std::uint64_t wire, std::string token, const std::string& endpoint);
  /// Ends a wire on this side and tells the peer.
  void cut(std::uint64_t wire, const std::string& reason);
  /// Another wire has taken this one's place at its client: it goes once its open requests have ended.
  void retire(std::uint64_t wire);
  /// The ports of `hull` are going: so does what is left of their wires.
  void release(const Hull& hull);
  /// [any thread] Another host can be reached, at the endpoint "host:…", over a socket that is not owned here.
  void join(const std::string& endpoint, Hop hop);
  /// [any thread] The process or host behind `endpoint` is gone: the wires that go there are lost. A host's socket is
  /// not used any more afterwards.
  void part(const std::string& endpoint, const std::string& reason);
  /// [any thread] What has come from there, or from a peer of a socket of ours.
  void on_frame(const Hop& from, const wire::Frame& frame, std::string_view object);

 private:
  struct Grant {
    std::string token;
    ProvidedPort* provider = nullptr;
    std::uint32_t prescale = 1;
    std::shared_ptr<RemoteWire> wire;  ///< once opened
    std::shared_ptr<Sink> sink;        ///< what the provider puts into: the wire, behind a prescale
    Hop client;                        ///< once opened
  };
  struct Relay {
    std::string token;
    std::string endpoint;
    Hop client;    ///< once opened
    Hop provider;
  };
  struct Requirement {
    RequiredPort* client = nullptr;
    std::string endpoint;
    std::string provider_name;
    Hop provider;
    std::shared_ptr<RemoteWire> wire;
    std::optional<std::string> refusal;  ///< once the peer has answered; empty: open
    std::uint64_t from_sequence = 0;     ///< once open: what was put after this comes
    bool retired = false;
    bool lost = false;                   ///< its link is; kept until another wire takes its place, or it is cut
  };
  struct Peer {
    std::unique_ptr<LinkSocket> link;  ///< none: another host's, which is not ours
    Hop hop;
  };

  void on_client_frame(const wire::Frame& frame, std::string_view object);
  void open_for(const Hop& from, const wire::Frame& frame);
  void open_relay(const Hop& from, const wire::Frame& frame, Relay& relay);
  bool relayed(const Hop& from, const wire::Frame& frame, std::string_view object);
  static void refuse(const Hop& peer, std::uint64_t wire, const std::string& reason);
  void note_answer(std::uint64_t wire, const std::string& refusal, std::uint64_t from_sequence);
  void count_missed(std::uint64_t wire, std::uint64_t replaces, std::uint32_t every);
  void tell_closed(const Hop& peer, std::uint64_t wire, const std::string& reason);
  void lose_relays(const Hop& gone, const std::string& reason);
  void end(std::uint64_t wire, const Grant& grant, const std::string& reason);
  void end(std::uint64_t wire, const Requirement& requirement, const std::string& reason);
  Hop connect(const std::string& endpoint);

  Pool& pool_;
  zmq::context_t context_;
  const std::string endpoint_;
  const OnLost on_lost_;
  std::mutex mutex_;
  std::condition_variable answered_;  ///< a requirement has its answer
  std::map<std::uint64_t, Grant> grants_;
  std::map<std::uint64_t, Requirement> requirements_;
  std::map<std::uint64_t, Relay> relays_;
  std::map<std::string, Peer> peers_;
  std::unique_ptr<LinkSocket> server_;
};

}  // namespace fiona::host
