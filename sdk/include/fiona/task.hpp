#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <type_traits>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/clock.hpp"
#include "fiona/own_thread.hpp"
#include "fiona/time.hpp"

namespace fiona {

class ActivityHold;
class Component;
class Hull;
class Inbox;
class Port;
class Task;

/// What starts a task: a period, or one of the four below.
class When {
 public:
  enum class Kind { Periodic, OnPort, AfterTask, FreeRunning };

  /// Once in this time on the instance's clock.
  template <class Rep, class Ratio>
  When(std::chrono::duration<Rep, Ratio> period)
      : kind_(Kind::Periodic), period_(std::chrono::duration_cast<Duration>(period)) {}

  Kind kind() const { return kind_; }
  /// Of a periodic one; zero otherwise.
  Duration period() const { return period_; }
  /// Of one that starts on a port: at each arrival of so many.
  std::uint32_t every() const { return every_; }
  /// The port or task whose name it has; empty for the other kinds.
  std::string of() const;

 private:
  friend class Task;
  friend When on(Port& port, std::uint32_t every);
  friend When after(Task& task);
  explicit When(Kind kind) : kind_(kind) {}

  Kind kind_;
  Duration period_{};
  std::uint32_t every_ = 1;
  Port* port_ = nullptr;
  Task* task_ = nullptr;
};

/// At the first message that arrives at the port and then at each `every`-th; behind its handler, if it has one.
When on(Port& port, std::uint32_t every = 1);
/// Each time that the other task has ended; of a free running one, each time that its work has returned.
When after(Task& task);
/// All the time, in a thread of its own.
struct FreeRunning {};
inline constexpr FreeRunning free_running{};

/// Work that the hull starts while the instance is in a main mode:
///
///     fiona::Task poll_{*this, "poll", 100ms, &Self::poll};
///     fiona::Task filter_{*this, "filter", fiona::on(scans_, 3), &Self::filter};
///     fiona::Task plan_{*this, "plan", fiona::after(filter_), &Self::plan, "drive"};
///     fiona::Task read_{*this, "read", fiona::free_running, &Self::read};  // void read(const fiona::OwnThread& own)
///
/// A task that names an activity runs in the main modes that have it. What should start it while it still runs, or
/// while the strand has not come to it, is an overrun: counted, not made up for; a periodic one keeps to its grid.
///
/// The work runs on the strand, and may be a coroutine (`fiona::Async<> plan()`), which holds the activity while it
/// runs. Only a free running task has a thread; its work is called again as soon as it has returned, and holds the
/// activity from the first call on: when the mode is to be left it is asked to stop, and the change waits until it has
/// returned. A virtual clock cannot wait for such a thread, so there a mode that has it is refused.
class Task {
 public:
  using Work = std::function<std::optional<Async<>>()>;
  using ThreadWork = std::function<void(const OwnThread&)>;
  template <class C>
  Task(C& owner, std::string_view name, When when, void (C::*work)(), std::string_view activity = {})
      : Task(static_cast<Component&>(owner), name, when, Work([&owner, work] { return (owner.*work)(), std::nullopt; }),
             activity) {}
  template <class C>
  Task(C& owner, std::string_view name, When when, Async<> (C::*work)(), std::string_view activity = {})
      : Task(static_cast<Component&>(owner), name, when,
             Work([&owner, work] { return std::optional((owner.*work)()); }), activity) {}
  template <class C>
  Task(C& owner, std::string_view name, FreeRunning, void (C::*work)(const OwnThread&), std::string_view activity = {})
      : Task(static_cast<Component&>(owner), name, When(When::Kind::FreeRunning), nullptr, activity,
             [&owner, work](const OwnThread& own) { (owner.*work)(own); }) {}
  Task(Component& owner, std::string_view name, When when, Work work, std::string_view activity = {},
       ThreadWork thread_work = nullptr);
  ~Task();
  Task(const Task&) = delete;
  Task& operator=(const Task&) = delete;

  const std::string& name() const { return name_; }
  const When& when() const { return when_; }
  const std::string& activity() const { return activity_; }
  std::uint64_t runs() const { return runs_.load(std::memory_order_relaxed); }
  std::uint64_t overruns() const { return overruns_.load(std::memory_order_relaxed); }

  /// [any thread] How long after what started it the last run began.
  Duration late() const { return Duration(late_ns_.load(std::memory_order_relaxed)); }

 private:
  friend class Hull;
  friend class Inbox;
  void attach();
  void attach_to_port();
  void attach_to_task();

  // [strand] The instance enters or leaves a mode that has the activity; again is no harm.
  void start();
  void stop();

  void arm();
  void fire(std::uint64_t start_count);
  void next_due();
  void begin(TimePoint since);
  void run(TimePoint since);
  void has_ended();

  /// [any thread] Whether this arrival is one that starts it.
  bool takes_arrival();
  /// [any thread] True: the caller has `begin_noted` called on the strand. Else that is under way: an overrun.
  bool note();
  void begin_noted(TimePoint since);

  bool is_free_running() const { return when_.kind() == When::Kind::FreeRunning; }
  void launch();
  void resume();
  void ask_to_stop();
  void turn(const OwnThread& own, TimePoint since);
  void thread_has_ended(const std::optional<std::string>& failure);

  Hull& hull_;
  const std::string name_;
  const When when_;
  const Work work_;
  const ThreadWork thread_work_;
  const std::string activity_;
  const std::uint32_t mark_;      ///< of its work
  std::vector<Task*> followers_;  ///< those that start after this one; fixed once the component has been made

  std::shared_ptr<ActivityHold> hold_;  ///< while a coroutine or the thread runs
  bool busy_ = false;
  TimePoint due_{};
  TimerId timer_ = 0;
  std::uint64_t start_count_ = 0;
  std::shared_ptr<OwnThread::Shared> own_;  ///< while the thread runs
  std::thread thread_;
  std::atomic<bool> running_{false};
  std::atomic<bool> noted_{false};
  std::atomic<std::uint64_t> arrivals_{0};
  std::atomic<std::uint64_t> runs_{0};
  std::atomic<std::uint64_t> overruns_{0};
  std::atomic<std::int64_t> late_ns_{0};
};

/// Work at a time of the component's choosing, once for each `at`: `fiona::Timer next_{*this, &Self::play_next};`
/// A new time replaces the old one. Cancelled when the instance leaves its main modes, and by the timer's end; one that
/// comes due outside of them, as when it was set in neutral, does nothing.
class Timer {
 public:
  template <class C>
  Timer(C& owner, void (C::*work)()) : Timer(static_cast<Component&>(owner), [&owner, work] { (owner.*work)(); }) {}
  Timer(Component& owner, std::function<void()> work);
  ~Timer();
  Timer(const Timer&) = delete;
  Timer& operator=(const Timer&) = delete;

  /// [strand]
  void at(TimePoint time);
  void cancel();

 private:
  /// Shared with what has been posted: that may come to the strand when the timer has gone.
  struct State {
    const std::function<void()> work;
    std::uint64_t setting = 0;
  };
  Hull& hull_;
  const std::shared_ptr<State> state_;
  TimerId timer_ = 0;
};

}  // namespace fiona
