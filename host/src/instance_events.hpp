#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>

#include "fiona/hull.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// How many lines an instance may say: so many a second, and so many at once.
class LineAllowance {
 public:
  LineAllowance(double a_second, double at_once) : a_second_(a_second), at_once_(at_once), lines_(at_once) {}
  /// One more: how many were refused since the last that was not; none: it is refused, and counted.
  std::optional<std::uint64_t> take();

 private:
  const double a_second_;
  const double at_once_;
  double lines_;
  std::chrono::steady_clock::time_point counted_ = std::chrono::steady_clock::now();
  std::uint64_t refused_ = 0;
};

/// What stands in the place of lines that were refused.
std::string text_of_dropped(std::uint64_t lines);

/// What the instances of a process say, as events for the host.
class InstanceEvents final : public HullEvents {
 public:
  /// [any thread] Called on whichever thread saw it, and must not wait.
  using OnEvent = std::function<void(wire::GroupMessage)>;

  /// Lines of one instance that are passed on a second, and at once; the rest is counted.
  static constexpr std::size_t kLinesPerSecond = 200;
  static constexpr std::size_t kLinesAtOnce = 1000;
  /// Bytes of a line; what is longer is cut off.
  static constexpr std::size_t kLongestLine = 4096;

  explicit InstanceEvents(OnEvent on_event) : on_event_(std::move(on_event)) {}

  void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) override;
  void run_ended(const std::string& instance, int exit_code, const std::string& reason) override;
  void logged(const std::string& instance, LogLevel level, std::string_view text) override;
  void asked(const std::string& instance, std::uint64_t number, const control::Request& request) override;

 private:
  void tell(const std::string& instance, LogLevel level, std::string text);

  const OnEvent on_event_;
  std::mutex mutex_;
  std::map<std::string, LineAllowance> allowances_;  ///< guarded by mutex_; one for each name that an instance has had
};

}  // namespace fiona::host
