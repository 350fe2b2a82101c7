#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>

namespace fiona::console {

/// What started this process as a service and wants to be told how it is: sd_notify(3)'s protocol, datagrams to the
/// socket that $NOTIFY_SOCKET names. Without that, nobody is told anything.
class ServiceManager {
 public:
  /// From the environment.
  ServiceManager();

  /// "READY=1", "STATUS=…", "WATCHDOG=1", "STOPPING=1". Never waits; what cannot be sent is lost.
  void tell(std::string_view state) const;

  /// How often it wants a sign of life: half of what it waits for; nothing where it wants none from this process.
  std::optional<std::chrono::milliseconds> watchdog_period() const { return watchdog_period_; }

 private:
  std::string socket_;
  std::optional<std::chrono::milliseconds> watchdog_period_;
};

}  // namespace fiona::console
