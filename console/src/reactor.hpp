#pragma once

#include <chrono>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>

namespace fiona::console {

using SteadyTime = std::chrono::steady_clock::time_point;

/// Ctrl-C: what goes on now is to end. Exit code 130, where that is all.
class Interrupted : public std::exception {
 public:
  /// `goes_on`: the host cannot let go of what it has begun.
  explicit Interrupted(bool goes_on = false) : goes_on_(goes_on) {}
  bool goes_on() const { return goes_on_; }
  const char* what() const noexcept override {
    return goes_on_ ? "interrupted; the host goes on with it: journal" : "interrupted";
  }

 private:
  bool goes_on_;
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

  /// Waits until the descriptor can be written; false at the deadline. Serves nothing but signals meanwhile.
  bool wait_writable(int descriptor, std::optional<SteadyTime> deadline = std::nullopt);
  /// Writes all, however slow the reader, unless a signal comes; false with errno.
  bool write_all(int descriptor, std::string_view bytes);
  /// All that a descriptor has until its end, at most so many bytes; less with errno.
  bool read_all(int descriptor, std::size_t most, std::string& bytes);
  /// Called in a wait after the process has been stopped and goes on; nullptr: not any more.
  void on_continued(std::function<void()> continued) { continued_ = std::move(continued); }
  /// Throws Interrupted or Terminated where a signal has come and nobody has waited since.
  void take_signal();

 private:
  void serve_once(std::optional<SteadyTime> deadline);
  void expire_timers();

  struct Timer {
    SteadyTime when;
    std::function<void()> expired;
  };
  std::map<int, std::function<void()>> descriptors_;
  std::map<std::uint64_t, Timer> timers_;
  std::uint64_t last_timer_ = 0;
  int signals_ = -1;
  std::function<void()> continued_;
};

}  // namespace fiona::console
