#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "clock_master.hpp"
#include "delivery_log.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

/// A system's virtual time: the host's own clock, those of its groups that follow it, the record of what is delivered
/// on them, and whether they stand. All functions [control thread].
class VirtualTime {
 public:
  /// `endpoint` and `frames`: of the host's own process. `standstill`: of the machine's time.
  VirtualTime(VirtualClock& clock, std::string endpoint, ClockMaster::Frames frames,
              std::chrono::milliseconds standstill);

  VirtualClock& clock() { return clock_; }
  /// The clocks of groups follow the host's own from now on.
  ClockMaster& lead_groups();
  /// The group that listened there has gone.
  void forget(const std::string& endpoint) { master_.remove(endpoint); }

  /// Each delivery from now on; null: none.
  void record_to(std::shared_ptr<DeliveryLog> log);
  /// The file that deliveries are recorded in; empty: none.
  std::string deliveries() const { return log_ ? log_->file().string() : ""; }
  const std::shared_ptr<DeliveryLog>& log() const { return log_; }

  /// While time is held: waits, at most as long as a standstill, until all processes have done what they were told.
  /// `serve` hears what the groups have to say.
  void settle(const std::function<void()>& serve);
  /// Why nothing can be waited for any more, told once: time has stood for too long while it should run, or what is
  /// delivered cannot be recorded. Call it at least once a second.
  std::optional<Error> failure();

 private:
  /// Since when time stands at this progress, by the machine's clock.
  struct Standing {
    std::uint64_t progress = 0;
    std::chrono::steady_clock::time_point since{};
    bool asked = false;
  };
  std::uint64_t progress() const { return clock_.progress() + master_.progress(); }
  /// Since when, by the machine's clock, time is at this instant, and the progress then.
  struct Instant {
    TimePoint at = TimePoint::min();
    std::uint64_t progress = 0;
    std::chrono::steady_clock::time_point since{};
  };
  /// So much is done in no instant of a system that goes on.
  static constexpr std::uint64_t kMostInOneInstant = 1'000'000;

  bool stands_too_long();
  bool turns_in_one_instant();
  Error unwritable();
  Error standstill(bool turns);

  VirtualClock& clock_;
  ClockMaster master_;
  const std::chrono::milliseconds standstill_;
  std::shared_ptr<DeliveryLog> log_;
  Standing standing_{0, std::chrono::steady_clock::now()};
  Instant instant_;
  std::optional<std::uint64_t> unsettled_;  ///< the progress at which `settle` gave up
};

}  // namespace fiona::host
