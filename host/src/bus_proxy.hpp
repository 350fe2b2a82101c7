#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fiona/wire.pb.h"
#include "group_output.hpp"
#include "os/process.hpp"
#include "supervision.hpp"

namespace fiona::host {

/// How a sandboxed group reaches the services on D-Bus that it was granted, and nobody else there: xdg-dbus-proxy(1), a
/// process of the host's, which passes on what is meant for them and comes from them. It ends with the host, is started
/// again when it ends by itself, and is left when it does so as often as a group may. All functions [control thread].
class BusProxy {
 public:
  using Time = std::chrono::steady_clock::time_point;

  /// Starts it for this group. Throws Error if there is no such program, or no such bus.
  BusProxy(std::string group, const wire::Confinement& confinement);
  /// Leaves nothing behind.
  ~BusProxy();
  BusProxy(const BusProxy&) = delete;
  BusProxy& operator=(const BusProxy&) = delete;

  /// Throws Error if nobody can connect to it by then.
  void require_ready(Time deadline);
  /// Passes on what it writes; starts it again when that is due.
  void watch(Time now);
  /// Why it is not started again; empty: it runs, or will.
  const std::string& end() const { return end_; }
  pid_t process() const { return child_->id(); }

 private:
  void start();
  void pass_on(Time now);
  std::string how_it_ended();

  const std::string group_;
  const std::string folder_;
  std::vector<std::string> arguments_;
  std::unique_ptr<os::ChildProcess> child_;
  std::unique_ptr<GroupOutput> output_;
  os::Descriptor ready_;  ///< readable once it takes connections; it ends when this is closed
  Supervision supervision_;
  bool waits_ = false;  ///< to be started again
  std::string told_;    ///< the last that it wrote: it says the same again and again
  std::string end_;
};

}  // namespace fiona::host
