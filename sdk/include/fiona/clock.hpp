#pragma once

#include <algorithm>
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

#include "fiona/service.hpp"
#include "fiona/strand.hpp"
#include "fiona/time.hpp"

namespace fiona {

/// A delivery that waits for its turn on a virtual clock.
struct Staged {
  std::string_view wire;           ///< must live until `deliver` has run
  std::uint64_t sequence = 0;      ///< on this wire
  const Object* object = nullptr;  ///< what is delivered, kept alive by `deliver`
  /// What is delivered where there is no object: "timeout"; a literal. Neither: no delivery, nobody is told of it.
  std::string_view word = {};
  Job deliver;
};

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
  /// Delivers in this instant, ordered among all that are staged by (wire, sequence).
  virtual void stage(Staged staged);
  /// A strand has become busy. False: the clock keeps it back and calls its `start` later.
  virtual bool strand_busy(Strand&) { return true; }
  virtual void strand_idle(Strand&) {}
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
  void wake_at(TimePoint at);

  std::chrono::steady_clock::time_point steady_start_;
  TimePoint start_;
  const int alarm_;  ///< a timerfd: to set it for an earlier time wakes no thread
  std::mutex mutex_;
  std::map<Key, Entry> entries_;
  std::map<TimerId, TimePoint> times_;
  TimerId next_id_ = 1;
  TimePoint wakes_at_ = TimePoint::max();  ///< what the alarm is set for
  bool stopping_ = false;
  std::thread thread_;
};

/// Hears of every delivery on a virtual clock.
class DeliveryRecorder {
 public:
  virtual ~DeliveryRecorder() = default;
  /// In the order in which they are made. `what`: 16 hexadecimal digits, the hash of the serialised object, or the
  /// word of a delivery that has none.
  virtual void delivered(TimePoint at, std::string_view wire, std::uint64_t sequence, std::string_view what) = 0;
  /// All deliveries made so far, in all processes, have been told; what comes next is at `at`.
  virtual void round(TimePoint /*at*/) {}
};

/// The 64-bit FNV-1a hash (draft-eastlake-fnv) of the object, serialised with its maps in order.
std::uint64_t hash_of(const Object& object);

/// The other processes of a system whose time this process's virtual clock leads.
class OtherProcesses {
 public:
  struct Situation {
    bool quiet = true;                  ///< nothing runs in them, and nothing is on its way between any two processes
    bool staged = false;                ///< something waits for its turn in this instant
    TimePoint next = TimePoint::max();  ///< their earliest timer
  };
  virtual ~OtherProcesses() = default;
  virtual Situation situation() = 0;
  /// Tells those where something is staged to deliver it.
  virtual void deliver(TimePoint at) = 0;
  /// Tells those that have timers at or before `at` to run them.
  virtual void fire(TimePoint at) = 0;
};

/// Simulated time: it stands while anything runs, then jumps to the next timer. With the same inputs each instance
/// sees the same messages and timers in the same order, however many threads there are, and however the instances are
/// spread over processes (docs/architecture.md, Time).
///
/// It starts at zero, or where a recording began that is replayed, and held: nothing moves until `release`. Within an
/// instant, work proceeds in rounds: all strands of all processes run until idle, then what they sent is delivered in
/// the order (wire name, sequence) before any of them runs again, and so on until nothing is left; only then does time
/// advance.
class VirtualClock : public Clock {
 public:
  explicit VirtualClock(TimePoint start = {}) : start_(start), now_(start) {}
  ~VirtualClock() override;
  TimePoint now() const override;
  TimePoint start() const override { return start_; }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override;
  void cancel(TimerId timer) override;
  bool staging() const override { return true; }
  void stage(Staged staged) override;
  bool strand_busy(Strand& strand) override;
  void strand_idle(Strand& strand) override;
  void stop() override;

  /// Counted: time runs while `release` has been called more often than `hold`. A `hold` may come before its `release`.
  void release();
  void hold();
  /// Runs `then`, which must not wait, when everything up to and at `at` has happened and before time goes on: the
  /// place to hold. It runs on whichever thread brought the clock there.
  TimerId stop_at(TimePoint at, Job then);
  void cancel_stop(TimerId stop);

  /// Virtual seconds per real second; 0: as fast as the work allows.
  void set_speed(double speed);
  double speed() const;

  /// From now on; null: nobody.
  void set_recorder(std::shared_ptr<DeliveryRecorder> recorder);

  /// Leads these processes too; they must live until `stop`. From then on what reaches this process from another thread
  /// than a strand's is looked at when `reconsider` is called.
  void lead(OtherProcesses& others);
  /// [any thread, holding no lock] Something has changed that the clock does not see by itself. It may deliver and let
  /// time go on before it returns.
  void reconsider() { proceed(); }
  /// [any thread] Waits, at most `most` of the machine's time, until nothing is left to do in this instant. False if
  /// that did not come about.
  bool settle(Duration most);
  /// Changes whenever something happens: a clock that stands still shows the same number.
  std::uint64_t progress() const;
  bool released() const;
  /// The strands that run now, or have work to do: what time waits for.
  std::vector<std::string> busy_strands() const;

 protected:
  using Lock = std::unique_lock<std::mutex>;

  /// Starts the next round of this instant, or the next instant. False when there is none to start. Called with the
  /// lock, by one thread at a time, while all strands are idle.
  virtual bool next_round(Lock& lock);
  /// The `count` oldest.
  bool deliver_staged(Lock& lock, std::size_t count);
  bool fire_timers(Lock& lock, TimePoint at);
  /// Who takes the lock after what `next_round` did without it finds a strand running: then it is not idle any more.
  bool idle() const { return busy_.empty(); }
  std::size_t staged() const { return staged_.size(); }
  TimePoint next_timer() const { return entries_.empty() ? TimePoint::max() : std::get<0>(entries_.begin()->first); }
  /// Without turning back.
  void advance_to(TimePoint at) { now_ = std::max(now_, at); }
  void note_settled();
  void proceed();

  mutable std::mutex mutex_;
  bool shared_ = false;  ///< with other processes: see `lead`
  std::shared_ptr<DeliveryRecorder> recorder_;

 private:
  struct Entry {
    std::weak_ptr<Strand> strand;
    Job job;
    TimerId id = 0;
  };
  /// Ordered by time, then by the name of the strand, then by age: independent of threads within a strand.
  using Key = std::tuple<TimePoint, std::string, TimerId>;

  void start_held_back(Lock& lock);
  bool run_stop(Lock& lock);
  bool paced(TimePoint next);
  void pace();

  const TimePoint start_;
  TimePoint now_;
  std::map<Key, Entry> entries_;
  std::map<TimerId, Key> keys_;
  std::vector<Staged> staged_;
  std::vector<Staged> round_;  ///< being delivered; of the thread that proceeds
  std::map<std::pair<TimePoint, TimerId>, Job> stops_;
  TimerId next_id_ = 1;
  std::vector<Strand*> busy_;  ///< each knows its place in it
  bool holding_back_ = false;  ///< a round is being handed out: no strand starts before all have theirs
  std::vector<std::shared_ptr<Strand>> held_back_;
  int releases_ = 0;
  bool proceeding_ = false;
  bool again_ = false;
  OtherProcesses* others_ = nullptr;
  std::uint64_t progress_ = 0;
  std::uint64_t settled_ = 0;
  std::condition_variable settled_changed_;

  double speed_ = 0;
  TimePoint pace_virtual_{};
  std::chrono::steady_clock::time_point pace_real_{};
  std::optional<std::chrono::steady_clock::time_point> wake_at_;
  std::condition_variable pacer_changed_;
  std::thread pacer_;
  bool stopping_ = false;
  std::condition_variable proceeded_;  ///< of a clock that stops
};

}  // namespace fiona
