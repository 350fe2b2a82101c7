#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace fiona::host {

/// When a group whose process has ended is started again: soon, then later and later, and no more once it ends as soon
/// as it has been started.
class Supervision {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr std::size_t kRestarts = 3;  ///< within kWithin; the next end is the last
  static constexpr std::chrono::seconds kWithin{30};
  static constexpr std::chrono::milliseconds kPause{100};  ///< before the first; each other one is four times as long

  /// When it is due; none: it has been started again too often, and is left.
  std::optional<Time> ended(const std::string& group, Time now, std::string reason = {});
  /// The groups that are due: started again from now on.
  std::vector<std::string> take_due(Time now);
  /// Nobody wants it any more.
  void forget(const std::string& group) { groups_.erase(group); }
  bool waits(const std::string& group) const;
  bool any_waits() const;
  /// How often it has been started again since it was made.
  std::uint64_t restarts(const std::string& group) const;
  struct Restart {
    Time at;
    std::string reason;  ///< how it had ended
  };
  std::optional<Restart> last_restart(const std::string& group) const;

 private:
  struct Kept {
    std::deque<Time> recent;  ///< at most kRestarts
    std::optional<Time> due;
    std::string reason;  ///< of the last end
    std::uint64_t restarts = 0;
    std::optional<Restart> last;
  };
  std::map<std::string, Kept> groups_;
};

}  // namespace fiona::host
