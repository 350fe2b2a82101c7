#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/async.hpp"
#include "fiona/clock.hpp"
#include "fiona/time.hpp"

namespace fiona {

class ActivityHold;
class Component;
class Hull;

/// Work that the hull starts on the strand once a period while the instance is in a main mode:
/// `fiona::Task ticker_{*this, "ticker", 100ms, &Self::tick};`
///
/// The work may be a coroutine (`fiona::Async<> tick()`). Runs keep to the grid of periods; a period that passes while
/// the work still runs or the strand is busy is an overrun: counted, not made up for. A task that names an activity runs
/// in the main modes that have it; a coroutine of it holds that activity while it runs.
class Task {
 public:
  using Work = std::function<std::optional<Async<>>()>;
  template <class C>
  Task(C& owner, std::string_view name, Duration period, void (C::*work)(), std::string_view activity = {})
      : Task(static_cast<Component&>(owner), name, period,
             Work([&owner, work] { return (owner.*work)(), std::nullopt; }), activity) {}
  template <class C>
  Task(C& owner, std::string_view name, Duration period, Async<> (C::*work)(), std::string_view activity = {})
      : Task(static_cast<Component&>(owner), name, period,
             Work([&owner, work] { return std::optional((owner.*work)()); }), activity) {}
  Task(Component& owner, std::string_view name, Duration period, Work work, std::string_view activity = {});
  Task(const Task&) = delete;
  Task& operator=(const Task&) = delete;

  const std::string& name() const { return name_; }
  Duration period() const { return period_; }
  const std::string& activity() const { return activity_; }
  std::uint64_t runs() const { return runs_.load(std::memory_order_relaxed); }
  std::uint64_t overruns() const { return overruns_.load(std::memory_order_relaxed); }

  /// [any thread] How long after its time the last run began.
  Duration late() const { return Duration(late_ns_.load(std::memory_order_relaxed)); }

  /// [strand] Called by the hull when the instance enters or leaves a mode that has the activity; again is no harm.
  void start();
  void stop();

 private:
  void arm();
  void fire(std::uint64_t start_count);
  void run();
  void next_due();

  Hull& hull_;
  const std::string name_;
  const Duration period_;
  const Work work_;
  const std::string activity_;
  std::shared_ptr<ActivityHold> hold_;  ///< while a coroutine runs
  bool busy_ = false;
  TimePoint due_{};
  TimerId timer_ = 0;
  std::uint64_t start_count_ = 0;
  bool running_ = false;
  std::atomic<std::uint64_t> runs_{0};
  std::atomic<std::uint64_t> overruns_{0};
  std::atomic<std::int64_t> late_ns_{0};
};

/// Work at a time of the component's choosing, once for each `at`: `fiona::Timer next_{*this, &Self::play_next};`
/// A new time replaces the old one. Cancelled when the instance leaves its main modes.
class Timer {
 public:
  template <class C>
  Timer(C& owner, void (C::*work)()) : Timer(static_cast<Component&>(owner), [&owner, work] { (owner.*work)(); }) {}
  Timer(Component& owner, std::function<void()> work);
  Timer(const Timer&) = delete;
  Timer& operator=(const Timer&) = delete;

  /// [strand]
  void at(TimePoint time);
  void cancel();

 private:
  Hull& hull_;
  const std::function<void()> work_;
  TimerId timer_ = 0;
  std::uint64_t setting_ = 0;
};

}  // namespace fiona
