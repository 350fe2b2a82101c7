#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <utility>

#include "fiona/async.hpp"
#include "fiona/strand.hpp"
#include "fiona/time.hpp"

namespace fiona {

class Hull;

/// What the work of a free running task is given: when to end, and its ways to the component. The work runs beside the
/// component's strand, so it touches no member but what says [any thread] (`params_.snapshot()`, probes, `now()`):
///
///     void read(const fiona::OwnThread& own) {
///       const Scan scan = device_.wait_for_scan(own.stop_token());
///       own.post([this, scan] { scans_.put(scan); });
///     }
///
/// All functions [the task's thread].
class OwnThread {
 public:
  /// Jobs that may wait for the strand.
  static constexpr std::size_t kMaxPosted = 64;

  /// The mode is about to be left, or the instance ends: return soon. Until then the change waits.
  bool stop_requested() const { return stop_.stop_requested(); }
  /// The same, for what can be called back: a `std::stop_callback` may end a read that blocks. It runs on the strand,
  /// or beside it where a handler hangs there.
  const std::stop_token& stop_token() const { return stop_; }

  /// Runs `job` on the strand, behind those before it; waits while as many wait as may. False, and it does not run,
  /// once the task is to stop.
  bool post(Job job) const;
  /// Waits for so long. False as soon as the task is to stop.
  bool wait_for(Duration duration) const;
  /// Makes a call of a port on the strand and waits for its end: `own.await([this] { return scans_.wait_update(1s);
  /// })`. Nothing once the task is to stop; the call then goes on to its own end without it. Of an Async<> without a
  /// value: whether it has ended.
  template <class F>
  auto await(F call) const {
    return await_value(std::function(std::move(call)));
  }

 private:
  friend class Hull;
  friend class Task;
  struct Shared;
  explicit OwnThread(std::shared_ptr<Shared> shared);

  template <class T>
  static Async<> keep(std::function<Async<T>()> call, std::shared_ptr<std::optional<T>> value) {
    const Async<T> work = call();
    value->emplace(co_await work);
  }
  template <class T>
  std::optional<T> await_value(std::function<Async<T>()> call) const {
    const auto value = std::make_shared<std::optional<T>>();
    if (!await_end([call = std::move(call), value] { return keep<T>(call, value); })) return std::nullopt;
    return std::move(*value);
  }
  static Async<> keep(std::function<Async<>()> call) {
    const Async<> work = call();
    co_await work;
  }
  bool await_value(std::function<Async<>()> call) const {
    return await_end([call = std::move(call)] { return keep(call); });
  }
  bool await_end(std::function<Async<>()> work) const;

  const std::shared_ptr<Shared> shared_;
  const std::stop_token stop_;
};

}  // namespace fiona
