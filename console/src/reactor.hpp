#pragma once

#include <chrono>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <optional>

namespace fiona::console {

using SteadyTime = std::chrono::steady_clock::time_point;

/// Ctrl-C: what goes on now is to end. Exit code 130, where that is all.
class Interrupted : public std::exception {
 public:
  const char* what() const noexcept override { return "interrupted"; }
};

/// SIGTERM, or a terminal that has been closed: the program is to end, whatever goes on. Exit code 130.
class Terminated : public std::exception {
 public:
  const char* what() const noexcept override { return "terminated"; }
};

/// The one place where the console waits: descriptors, timers and signals, in one thread.
class Reactor {
 public:
  Reactor() = default;
  Reactor(const Reactor&) = delete;
  Reactor& operator=(const Reactor&) = delete;
  ~Reactor();

  /// From here on SIGINT ends a wait with Interrupted, SIGTERM and SIGHUP with Terminated, instead of the process. Once
  /// per process.
  void take_signals();

  /// Calls `ready` whenever `descriptor` is readable or at its end, until remove(). The descriptor stays the caller's.
  void add(int descriptor, std::function<void()> ready);
  /// The same for the terminal's keys. Throws Terminated once the terminal has been closed.
  void add_terminal(std::function<void()> ready);
  void remove(int descriptor);

  /// Calls `expired` once at `when`, within a wait. Returns the number to cancel it.
  std::uint64_t add_timer(SteadyTime when, std::function<void()> expired);
  void cancel_timer(std::uint64_t timer);

  /// Serves descriptors and timers until `done`; false at the deadline. Throws Interrupted, Terminated, and what
  /// callbacks throw.
  bool run_until(const std::function<bool()>& done, std::optional<SteadyTime> deadline = std::nullopt);

  /// Waits until the descriptor can be written; false at the deadline. Serves nothing else meanwhile.
  static bool wait_writable(int descriptor, SteadyTime deadline);

 private:
  void serve_once(std::optional<SteadyTime> deadline);
  void expire_timers();
  void read_signal();

  struct Timer {
    SteadyTime when;
    std::function<void()> expired;
  };
  std::map<int, std::function<void()>> descriptors_;
  std::map<std::uint64_t, Timer> timers_;
  std::uint64_t last_timer_ = 0;
  int signals_ = -1;
};

}  // namespace fiona::console
