#pragma once

#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <tuple>
#include <vector>

#include "fiona/strand.hpp"
#include "fiona/time.hpp"

namespace fiona {

/// Names a scheduled piece of work, for `cancel`. Zero names none.
using TimerId = std::uint64_t;

/// The clock of a running system. All functions [any thread].
class Clock {
 public:
  virtual ~Clock() = default;

  virtual TimePoint now() const = 0;
  /// The time at which the clock began.
  virtual TimePoint start() const = 0;

  /// Posts `job` to `strand` at `at`, or at once if that has passed. A strand that is gone or closed drops it.
  virtual TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) = 0;
  /// The job will not be posted, unless that has happened already.
  virtual void cancel(TimerId timer) = 0;

  /// Whether deliveries go through `stage` so that their order does not depend on threads.
  virtual bool staging() const { return false; }
  /// Performs `delivery` in this instant, ordered among all that are staged by (`wire`, `sequence`).
  /// `wire` must live until `delivery` has run.
  virtual void stage(std::string_view wire, std::uint64_t sequence, Job delivery);
  /// A strand has become busy or idle.
  virtual void strand_busy() {}
  virtual void strand_idle() {}
  /// Ends the clock's own thread: after it nothing is posted any more. Call it before the strands' pool ends; the
  /// clock itself must outlive the pool, whose threads tell it that their strands are idle.
  virtual void stop() {}
};

/// The machine's monotonic time, counted from Unix time at construction.
class SystemClock final : public Clock {
 public:
  /// Ties the timeline to the machine's monotonic clock; given to the other processes of a system, so that they share
  /// one timeline.
  struct Origin {
    std::int64_t steady_ns = 0;  ///< of the monotonic clock
    std::int64_t start_ns = 0;   ///< of the timeline at that moment
  };

  SystemClock() : SystemClock(Origin{}) {}
  /// An origin of zeros: begins now.
  explicit SystemClock(Origin origin);
  Origin origin() const;
  ~SystemClock() override;
  TimePoint now() const override;
  TimePoint start() const override { return start_; }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override;
  void cancel(TimerId timer) override;
  void stop() override;

 private:
  struct Entry {
    std::weak_ptr<Strand> strand;
    Job job;
  };
  using Key = std::pair<TimePoint, TimerId>;
  void serve();

  std::chrono::steady_clock::time_point steady_start_;
  TimePoint start_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::map<Key, Entry> entries_;
  std::map<TimerId, TimePoint> times_;
  TimerId next_id_ = 1;
  bool stopping_ = false;
  std::thread thread_;
};

/// Simulated time: it stands while anything runs, then jumps to the next timer. With the same inputs each instance
/// sees the same messages and timers in the same order, however many threads there are (architecture 7).
///
/// It starts at zero and held: nothing moves until `release`. Within an instant, work proceeds in rounds: all strands
/// run until idle, then what they sent is delivered in the order (wire name, sequence), and so on until nothing is
/// left; only then does time advance.
class VirtualClock final : public Clock {
 public:
  VirtualClock() = default;
  ~VirtualClock() override;
  TimePoint now() const override;
  TimePoint start() const override { return TimePoint{}; }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override;
  void cancel(TimerId timer) override;
  bool staging() const override { return true; }
  void stage(std::string_view wire, std::uint64_t sequence, Job delivery) override;
  void strand_busy() override;
  void strand_idle() override;
  void stop() override;

  /// Lets time advance, once for each call, until `hold` was called as often. Starts at zero releases: held. What holds
  /// may come first, where another thread sees to it that what it was released for has happened.
  void release();
  void hold();
  /// Runs `then`, which must not wait, when everything up to and at `at` has happened and before time goes on: the
  /// place to hold. It runs on whichever thread brought the clock there.
  TimerId stop_at(TimePoint at, Job then);
  void cancel_stop(TimerId stop);

  /// Virtual seconds per real second; 0: as fast as the work allows.
  void set_speed(double speed);
  double speed() const;

 private:
  struct Entry {
    std::weak_ptr<Strand> strand;
    Job job;
    TimerId id = 0;
  };
  struct Staged {
    std::string_view wire;
    std::uint64_t sequence;
    Job delivery;
  };
  /// Ordered by time, then by the name of the strand, then by age: independent of threads within a strand.
  using Key = std::tuple<TimePoint, std::string, TimerId>;

  void proceed();
  bool next_round(std::unique_lock<std::mutex>& lock);
  bool deliver_staged(std::unique_lock<std::mutex>& lock);
  bool run_stop(std::unique_lock<std::mutex>& lock);
  bool fire_timers(std::unique_lock<std::mutex>& lock);
  bool paced(TimePoint next);
  void pace();

  mutable std::mutex mutex_;
  TimePoint now_{};
  std::map<Key, Entry> entries_;
  std::map<TimerId, Key> keys_;
  std::vector<Staged> staged_;
  std::map<std::pair<TimePoint, TimerId>, Job> stops_;
  TimerId next_id_ = 1;
  int busy_ = 0;
  int releases_ = 0;
  bool proceeding_ = false;
  bool again_ = false;

  double speed_ = 0;
  TimePoint pace_virtual_{};
  std::chrono::steady_clock::time_point pace_real_{};
  std::optional<std::chrono::steady_clock::time_point> wake_at_;
  std::condition_variable pacer_changed_;
  std::thread pacer_;
  bool stopping_ = false;
};

}  // namespace fiona
