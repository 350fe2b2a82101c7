#pragma once

#include <atomic>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "leader_link.hpp"
#include "mailbox.hpp"
#include "peer_link.hpp"
#include "zap.hpp"

namespace fiona::host {

/// Over tcp with other hosts: not at all, listening for one that leads, or leading others.
struct HostOptions {
  std::filesystem::path keys;  ///< the directory; empty: the user's
  std::string listen;          ///< "tcp://ADDRESS:PORT"; empty: at nothing
  std::vector<PeerAddress> peers;
  std::string serve{};     ///< "tcp://ADDRESS:PORT" for consoles; empty: none over tcp
  std::string registry{};  ///< "http://HOST:PORT" of an etcd; empty: none
  /// Whether it works with other hosts.
  bool any() const { return !listen.empty() || !peers.empty(); }
};

/// The connections of a host with other hosts, and the thread that watches them. It neither reads nor sends what goes
/// over wires, unless the pool's threads are all busy.
class HostLinks {
 public:
  using OnEvent = std::function<void(wire::GroupMessage)>;
  using OnLog = std::function<void(const std::string&)>;

  /// Throws Error: without keys, where it cannot listen, when it is to listen and to lead.
  HostLinks(const HostOptions& options, const std::string& name, Pool& pool, Clock& clock, Links& links,
            OnEvent on_event, OnLog on_log);
  ~HostLinks();

  /// Ends the connections: no frame comes any more, and none goes.
  void stop();
  /// Readable when `changes` is to be called.
  int descriptor() const { return changes_.descriptor(); }
  /// Also that what has been said by then has been dealt with.
  std::deque<HostChange> changes();
  /// Null where there is none of that name.
  PeerLink* peer(const std::string& name);
  const std::vector<std::unique_ptr<PeerLink>>& peers() const { return peers_; }
  /// Null unless this host listens.
  LeaderLink* leader() { return leader_.get(); }
  std::uint64_t refused() const { return zap_ ? zap_->refused() : 0; }
  std::string key() const { return around_->keys.open.text(); }

 private:
  void serve();
  void forgive(std::chrono::steady_clock::time_point now);
  void check_leader(std::chrono::steady_clock::time_point now);

  const trust::KeyDirectory keys_;
  zmq::context_t context_;
  Mailbox<HostChange> changes_;
  std::atomic<std::size_t> unread_{0};  ///< bytes of a leader's requests
  std::unique_ptr<HostSurroundings> around_;
  std::unique_ptr<Zap> zap_;
  std::unique_ptr<LeaderLink> leader_;
  std::vector<std::unique_ptr<PeerLink>> peers_;
  std::chrono::steady_clock::time_point checked_{};
  std::chrono::steady_clock::time_point ticked_{};
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace fiona::host
