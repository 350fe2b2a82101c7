#include "instance_events.hpp"

#include <algorithm>
#include <utility>

#include "fiona/readable_text.hpp"

namespace fiona::host {

std::optional<std::uint64_t> LineAllowance::take() {
  const auto now = std::chrono::steady_clock::now();
  const std::chrono::duration<double> since = now - std::exchange(counted_, now);
  lines_ = std::min(at_once_, lines_ + since.count() * a_second_);
  if (lines_ < 1) {
    ++refused_;
    return std::nullopt;
  }
  lines_ -= 1;
  return std::exchange(refused_, 0);
}

std::string text_of_dropped(std::uint64_t lines) {
  return "(" + std::to_string(lines) + " lines were dropped: too many)";
}

void InstanceEvents::mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) {
  wire::GroupMessage message;
  auto& changed = *message.mutable_mode_changed();
  changed.set_instance(instance);
  changed.set_mode(mode);
  changed.set_reason(readable_text(reason));
  on_event_(std::move(message));
}

void InstanceEvents::run_ended(const std::string& instance, int exit_code, const std::string& reason) {
  wire::GroupMessage message;
  auto& ended = *message.mutable_run_ended();
  ended.set_instance(instance);
  ended.set_exit_code(exit_code);
  ended.set_reason(readable_text(reason));
  on_event_(std::move(message));
}

void InstanceEvents::asked(const std::string& instance, std::uint64_t number, const control::Request& request) {
  wire::GroupMessage message;
  auto& asked = *message.mutable_asked();
  asked.set_instance(instance);
  asked.set_number(number);
  *asked.mutable_request() = request;
  on_event_(std::move(message));
}

void InstanceEvents::logged(const std::string& instance, LogLevel level, std::string_view text) {
  std::optional<std::uint64_t> dropped;
  {
    const std::lock_guard lock(mutex_);
    dropped = allowances_.try_emplace(instance, kLinesPerSecond, kLinesAtOnce).first->second.take();
  }
  if (!dropped) return;
  if (*dropped > 0) tell(instance, LogLevel::Warning, text_of_dropped(*dropped));
  const bool is_long = text.size() > kLongestLine;
  tell(instance, level, readable_text(text, kLongestLine) + (is_long ? "…" : ""));
}

void InstanceEvents::tell(const std::string& instance, LogLevel level, std::string text) {
  wire::GroupMessage message;
  auto& log = *message.mutable_logged();
  log.set_instance(instance);
  log.set_level(static_cast<std::uint32_t>(level));
  log.set_text(std::move(text));
  on_event_(std::move(message));
}

}  // namespace fiona::host
