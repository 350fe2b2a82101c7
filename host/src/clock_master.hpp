#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "fiona/clock.hpp"
#include "link_socket.hpp"
#include "os/descriptor.hpp"

namespace fiona::host {

/// Leads the virtual clocks of a system's groups, for the host's own.
///
/// Time goes on only when no strand runs in any process and no message is on its way between two of them. A group
/// reports when it is idle, with how many messages it has sent to each peer and received from it. All reports being
/// of idle processes, and each pair's counts equal, nothing runs: the first process to run after its report could only
/// have been woken by a message that its sender has counted and it has not (Mattern 1987, "Algorithms for distributed
/// termination detection", the channel counting method).
class ClockMaster final : public OtherProcesses {
 public:
  using Frames = std::function<std::map<std::string, FrameCounts>()>;

  /// `endpoint` and `frames`: of the host's own process.
  ClockMaster(VirtualClock& clock, std::string endpoint, Frames frames);
  ~ClockMaster() override;

  /// [control thread] A group that is about to start; returns its end of the socket. Time stands until it reports.
  os::Descriptor add(const std::string& name, const std::string& endpoint);
  /// [control thread] The group is gone: nobody waits for it, or for what was on its way to it.
  void remove(const std::string& endpoint);
  /// [control thread] The group has been asked something: it is not idle before it has done that.
  void request_sent(const std::string& endpoint, std::uint64_t request);
  /// [control thread] One more of the group's events has been dealt with.
  void event_seen(const std::string& endpoint);
  /// Where deliveries in the groups are told; null: nowhere.
  void set_recorder(std::shared_ptr<DeliveryRecorder> recorder);

  /// [control thread] Asks the groups that are not idle what runs in them.
  void ask_what_runs();
  /// Why time stands, as far as the groups know: "'nav' in group 'far' runs", "group 'far' is silent". Empty: it is
  /// none of them.
  std::vector<std::string> blockers();
  bool empty() const;
  /// Changes whenever something has happened in a group.
  std::uint64_t progress() const;

  Situation situation() override;
  void deliver(TimePoint at) override;
  void fire(TimePoint at) override;

 private:
  struct Member;
  using Counts = std::map<std::string, FrameCounts>;

  void serve(Member& member);
  void on_report(Member& member, const wire::ClockReport& report);
  void send_step(Member& member, TimePoint at, std::uint64_t deliver);
  const Counts* counts_of(const std::string& endpoint, const Counts& own) const;
  std::vector<std::string> on_their_way(const std::string& endpoint, const std::string& name, const Counts& counts,
                                        const Counts& own) const;

  VirtualClock& clock_;
  const std::string endpoint_;
  const Frames frames_;
  mutable std::mutex mutex_;
  std::map<std::string, std::unique_ptr<Member>> members_;  ///< by endpoint
  std::shared_ptr<DeliveryRecorder> recorder_;
  std::uint64_t reports_ = 0;
};

}  // namespace fiona::host
