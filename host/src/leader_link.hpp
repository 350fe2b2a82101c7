#pragma once

#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "peer_link.hpp"

namespace fiona::host {

/// Where a host listens for the one that leads it. One leads; another is refused until the first has been silent for
/// `kLeadLease`. What keys may connect, the ZAP handler decides; who of them leads, this.
class LeaderLink final : public LinkSocket::Receiver {
 public:
  /// Listens at "tcp://ADDRESS:PORT"; port 0: one that is free. Throws Error with the system's reason.
  LeaderLink(const HostSurroundings& around, trust::KeyDirectory keys, const std::string& address);
  ~LeaderLink() override;

  /// With the port that was chosen.
  const std::string& address() const { return address_; }
  /// [the host links' thread] Beats, watches for silence.
  void tick(std::chrono::steady_clock::time_point now);
  /// For so long the leader could not be heard, by no fault of its own.
  void forgive(std::chrono::steady_clock::duration time);
  /// [the host links' thread, or none any more]
  void stop();
  /// [the host links' thread] Ends the session of a leader who is not among these any more.
  void keep(const std::vector<trust::AllowedHost>& allowed);

  /// [control thread] The leader has said that it ends: another may lead at once.
  void leave(std::uint64_t session);
  /// [any thread] Answers a request of this session.
  void answer(std::uint64_t session, const wire::GroupMessage& message);
  /// [any thread] Tells the leader, if one is connected.
  void tell(const wire::GroupMessage& event);
  /// [any thread] Who leads now; empty: nobody.
  std::string leader() const;
  /// One that leads, or did last; none if nobody ever has.
  std::optional<control::HostStatus> status() const;

 private:
  struct Session {
    std::uint64_t number = 0;
    std::string peer;       ///< on the socket
    LinkSocket::Lane lane;  ///< of answers and events, in their order
    std::string name;       ///< in the allow-list
    std::string key;        ///< and its key there
    std::uint64_t run = 0;
    std::int64_t said_hello_ns = 0;  ///< on its own timeline
    std::chrono::steady_clock::time_point heard{};
    std::chrono::steady_clock::time_point since{};
    bool over = false;  ///< kept for whoever resumes
    std::string reason;
  };

  std::optional<std::uint64_t> accepts(const std::string& peer, const wire::Frame& frame) override;
  void on_frame(const std::string& peer, const wire::Frame& given, const ObjectBytes& object) override;
  void on_refused(const std::string&) override {}
  void on_host_frame(std::uint64_t session, wire::HostFrame host);
  std::string name_of(const std::string& peer, const std::string& key) const;
  void on_hello(const std::string& peer, const wire::HostHello& hello);
  void turn_away(const std::string& peer, const wire::HostFrame& frame);
  void say(const wire::GroupMessage& message, std::uint64_t session);
  void end(const std::string& reason);
  void reply(const std::string& peer, const wire::HostFrame& frame);
  std::int64_t now_ns() const { return around_.clock.now().time_since_epoch().count(); }

  const HostSurroundings& around_;
  const trust::KeyDirectory keys_;
  std::string address_;
  std::shared_ptr<LinkSocket> link_;
  std::unique_ptr<ClockOffset> offset_ = std::make_unique<ClockOffset>();
  std::mutex delivering_;  ///< while a frame is: a session ends between two, so that none opens a wire behind its back
  mutable std::mutex mutex_;
  std::optional<Session> session_;
  std::uint64_t sessions_ = 0;
  std::chrono::steady_clock::time_point spoke_{};
};

}  // namespace fiona::host
