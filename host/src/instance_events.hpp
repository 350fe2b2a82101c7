#pragma once

#include <functional>
#include <string>

#include "fiona/hull.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// What the instances of a process say, as events for the host.
class InstanceEvents final : public HullEvents {
 public:
  /// [any thread] Called on whichever thread saw it, and must not wait.
  using OnEvent = std::function<void(wire::GroupMessage)>;

  explicit InstanceEvents(OnEvent on_event) : on_event_(std::move(on_event)) {}

  void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) override;
  void run_ended(const std::string& instance, int exit_code, const std::string& reason) override;
  void logged(const std::string& instance, LogLevel level, std::string_view text) override;
  void asked(const std::string& instance, std::uint64_t number, const control::Request& request) override;

 private:
  const OnEvent on_event_;
};

}  // namespace fiona::host
