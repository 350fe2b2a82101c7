#pragma once

#include <functional>
#include <string>
#include <vector>

#include "group.hpp"
#include "orders.hpp"
#include "peer_link.hpp"

namespace fiona::host {

/// A group of another host that this one leads: "HOST" is its own process, "HOST/GROUP" a child of it.
class RemoteGroup final : public Group {
 public:
  /// `meanwhile`: what is done again and again while it is waited for; null: nothing.
  RemoteGroup(const std::string& name, PeerLink& peer, std::string group, std::function<void()> meanwhile)
      : Group(name), peer_(peer), group_(std::move(group)), meanwhile_(std::move(meanwhile)) {}

  PeerLink& peer() const { return peer_; }
  const std::string& host() const { return peer_.peer().name; }
  /// On its host.
  const std::string& group() const { return group_; }
  /// As its own host knows it; for others there is the host's.
  std::string endpoint() const override { return std::string(kGroupEndpoint) + group_; }
  std::string link_name() const override { return endpoint(); }
  pid_t process() const override { return 0; }
  bool alive() const override { return end_.empty() && peer_.joined(); }
  void peer_lost(const wire::PeerLost&) override {}
  /// What a silent host could not be told is owed to it.
  void tell(wire::GroupRequest request) override;
  std::optional<wire::GroupStatusReply> status(std::chrono::milliseconds patience) override;
  std::optional<std::chrono::steady_clock::time_point> silent_since() const override { return silent_since_; }

  /// [control thread] Why it is gone for good; empty: its host may be silent, but it is thought to live.
  const std::string& end() const { return end_; }
  void end(std::string reason) { end_ = std::move(reason); }
  /// [control thread] When what it has is compared with what it is meant to have; none: nothing is in doubt.
  std::optional<std::chrono::steady_clock::time_point> compares_at() const { return compares_at_; }
  void compare_at(std::chrono::steady_clock::time_point when) { compares_at_ = when; }
  void is_compared();
  /// [control thread] To be done when the host is back.
  void owe(wire::GroupRequest request) { owed_.push_back(std::move(request)); }
  std::vector<wire::GroupRequest> take_owed();

 private:
  wire::GroupMessage perform(const wire::GroupRequest& request, std::chrono::milliseconds deadline) override;
  void doubt();
  wire::GroupMessage ask(const wire::GroupRequest& request, std::chrono::milliseconds patience);

  PeerLink& peer_;
  const std::string group_;
  const std::function<void()> meanwhile_;
  std::string end_;
  std::optional<std::chrono::steady_clock::time_point> silent_since_;  ///< it was asked for its status
  std::chrono::steady_clock::time_point ask_again_{};
  std::optional<std::chrono::steady_clock::time_point> compares_at_;
  std::chrono::steady_clock::time_point compared_{};
  std::vector<wire::GroupRequest>
      owed_;  ///< at most what there was of instances, wires and taps when the host fell silent
};

}  // namespace fiona::host
