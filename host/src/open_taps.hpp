#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include "groups.hpp"

namespace fiona::host {

/// The taps that are open, and in which group each one is: a tap moves with its instance to another process, and ends
/// with its group. All functions [control thread].
class OpenTaps {
 public:
  using OnEvent = std::function<void(const wire::GroupMessage&)>;

  /// `on_event` is given a TapEnded for each tap that ends before it is closed.
  OpenTaps(const Groups& groups, OnEvent on_event) : groups_(groups), on_event_(std::move(on_event)) {}

  /// Throws Error if the group refuses; one of the host's `own` it does not refuse because there are too many.
  void open(Group& group, std::uint64_t tap, const control::Watch& watch, bool is_own = false);
  /// Nobody waits for that.
  void close(std::uint64_t tap);
  /// Another version of the instance serves, in another process: whoever looks at it looks there. `to` may throw Error.
  void move(const std::string& instance, const std::string& from, const std::function<Group&()>& to);
  /// The group has gone.
  void lose(const std::string& group, const std::string& reason);

 private:
  struct Tap {
    std::string group;
    control::Watch watch;
    bool is_own = false;
  };

  void tell_ended(std::uint64_t tap, const Error& why) const;

  const Groups& groups_;
  const OnEvent on_event_;
  std::map<std::uint64_t, Tap> taps_;
  std::uint64_t openings_ = 0;
};

}  // namespace fiona::host
