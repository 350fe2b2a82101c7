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

  /// Listens at `endpoint` ("ipc:///run/…").
  /// On a virtual clock, what comes takes its turn there.
  Links(Pool& pool, Clock& clock, std::string endpoint, OnLost on_lost);
  ~Links();

  const std::string& endpoint() const { return endpoint_; }
  /// Closes the sockets: after it returned no message reaches a port any more.
  void stop();
  /// Lets a peer open `wire` to `provider` if it brings `token`.
  void provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale,
               std::string client_name);
  /// [control thread] Opens `wire` from `client` to the process that listens at `endpoint`; then calls `switch_over`,
  /// which lets go of the wire that it replaces, and lets messages through. Throws Error Unreachable when the wire is
  /// not open in time, with the peer's reason when it refuses; the client's port is then as before.
  void require(std::uint64_t wire, const std::string& token, RequiredPort& client, const std::string& provider_name,
               const std::string& endpoint, const std::function<void()>& switch_over);
  /// Ends a wire on this side and tells the peer.
  void cut(std::uint64_t wire, const std::string& reason);
  /// Another wire has taken this one's place at its client: it goes once its open requests have ended.
  void retire(std::uint64_t wire);
  /// The ports of `hull` are going: so does what is left of their wires.
  void release(const Hull& hull);
  /// The process behind `endpoint` is gone: its wires are lost.
  void peer_lost(const std::string& endpoint, const std::string& reason);
  /// Of a process on a virtual clock: by the endpoint of the peer.
  std::map<std::string, FrameCounts> frame_counts();

 private:
  struct Grant {
    std::string token;
    ProvidedPort* provider = nullptr;
    std::uint32_t prescale = 1;
    std::string client_name;
    std::shared_ptr<RemoteWire> wire;  ///< once opened
    std::shared_ptr<Sink> sink;        ///< what the provider puts into: the wire, behind a prescale
  };
  struct Requirement {
    RequiredPort* client = nullptr;
    std::string endpoint;
    std::string provider_name;
    std::shared_ptr<RemoteWire> wire;
    std::optional<std::string> refusal;  ///< once the peer has answered; empty: open
    bool retired = false;
  };
  struct Peer {
    std::unique_ptr<LinkSocket> link;
  };

  void on_server_frame(const std::string& peer, const wire::Frame& frame, std::string_view object);
  void on_client_frame(const wire::Frame& frame, std::string_view object);
  void open_for(const std::string& peer, const wire::Frame& frame);
  void refuse(const std::string& peer, std::uint64_t wire, const std::string& reason);
  void note_answer(std::uint64_t wire, const std::string& refusal);
  void end(std::uint64_t wire, const Grant& grant, const std::string& reason);
  void end(std::uint64_t wire, const Requirement& requirement, const std::string& reason);
  LinkSocket& connect(const std::string& endpoint);
  std::function<void()> on_counted() const;

  Pool& pool_;
  VirtualClock* const clock_;  ///< null: the system's
  zmq::context_t context_;
  const std::string endpoint_;
  const OnLost on_lost_;
  std::mutex mutex_;
  std::condition_variable answered_;  ///< a requirement has its answer
  std::map<std::uint64_t, Grant> grants_;
  std::map<std::uint64_t, Requirement> requirements_;
  std::map<std::string, Peer> peers_;
  std::unique_ptr<LinkSocket> server_;
};

}  // namespace fiona::host
