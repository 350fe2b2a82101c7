#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fiona/liveness.hpp"

namespace fiona::host {

/// What does not come to an end in a process.
struct Hang {
  std::string instance;  ///< empty: the process as a whole
  std::string in;        ///< a port's name, "task 'ticker'", "its destructor"; empty: not known
  std::chrono::milliseconds time;
  const Liveness::Slot* slot{};  ///< of the strand; null: of the process

  /// "stuck in imu for 1.0 s"; of a process "stood still for 0.7 s".
  std::string what() const;
  /// "'steps' was stuck in imu for 1.0 s", "it stood still for 0.7 s".
  std::string text() const;
};

/// Finds pieces of work that do not end, from what the strands of a process write. It counts only time in which it
/// looked itself: after the machine was suspended nothing hangs that did not hang before. And not the time for which a
/// thread of the process, the one that did so longest, waited for a CPU: on a machine that has too much to do work
/// takes longer, and ends.
class HangWatch {
 public:
  using Time = std::chrono::steady_clock::time_point;
  using milliseconds = std::chrono::milliseconds;
  /// A piece of work that takes so long hangs (docs/architecture.md, Supervision), unless a manifest says that it may
  /// take longer.
  static constexpr milliseconds kWork{1000};
  /// What is known of an instance.
  struct Part {
    std::vector<std::string> texts;  ///< of what it might be doing beside its life cycle: its ports, tasks and triggers
    milliseconds work{kWork};        ///< a piece of that which takes so long hangs
  };
  /// None: there is no instance of this name, or not yet.
  using Parts = std::function<std::optional<Part>(const std::string& instance)>;

  /// Opening a library, with all that its static constructors do; making a component, which only declares. The refusal
  /// is due after 2 s, and what is before and after has to fit in: starting the group, looking, ending it.
  static constexpr milliseconds kOpening{1800};
  /// What a component may need time for: opening files and devices, and closing them.
  static constexpr milliseconds kLifeCycle{10'000};
  /// A process that has been stopped has no work to excuse it; its consumers are to be told within a second.
  static constexpr milliseconds kStopped{600};
  /// For no longer than this is waiting for a CPU an excuse.
  static constexpr milliseconds kStarved{10'000};
  /// Of the time since it looked last no more counts.
  static constexpr milliseconds kMostBetween{250};

  HangWatch(const Liveness::Page& page, Parts parts) : page_(page), parts_(std::move(parts)) {}

  /// [one thread] What has come to hang in this process since it was called last, each once. Call it about every 100
  /// ms. `stopped`: the process does not run at all.
  std::vector<Hang> look(Time now, pid_t process, bool stopped = false);

 private:
  struct Seen {
    std::uint64_t work = 0;
    milliseconds stood{0};  ///< without the time for which it may have waited for a CPU
    milliseconds in_all{0};
    bool told = false;
  };
  milliseconds passed(Time now);
  milliseconds waited_for_cpu(pid_t process);
  milliseconds patience_with(const Liveness::Slot& slot, std::uint64_t work) const;
  bool hangs(Seen& seen, const Liveness::Slot& slot, milliseconds step, milliseconds waited) const;
  Hang hang_of(const Liveness::Slot& slot, const Seen& seen) const;

  const Liveness::Page& page_;
  const Parts parts_;
  Time looked_{};
  milliseconds stopped_{0};
  std::optional<std::map<pid_t, std::chrono::nanoseconds>> delays_;  ///< none: nothing was stuck when it looked last
  std::vector<Seen> seen_;
};

/// A library is opened for an instance.
inline constexpr std::string_view kItsLibrary = "its library";

}  // namespace fiona::host
