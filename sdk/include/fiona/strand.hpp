#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "fiona/liveness.hpp"
#include "fiona/time.hpp"

namespace fiona {

class Clock;
class Inbox;

/// A move-only piece of work without argument or result.
class Job {
 public:
  Job() = default;
  template <class F>
  requires(!std::is_same_v<std::remove_cvref_t<F>, Job>) Job(F&& work)
      : work_(std::make_unique<Holder<std::remove_cvref_t<F>>>(std::forward<F>(work))) {}
  void operator()() { work_->run(); }
  explicit operator bool() const { return work_ != nullptr; }

 private:
  struct Base {
    virtual ~Base() = default;
    virtual void run() = 0;
  };
  template <class F>
  struct Holder final : Base {
    explicit Holder(F&& f) : work(std::move(f)) {}
    explicit Holder(const F& f) : work(f) {}
    void run() override { work(); }
    F work;
  };
  std::unique_ptr<Base> work_;
};

/// Something that an executor runs once for each time it was submitted.
class Runnable {
 public:
  virtual ~Runnable() = default;
  virtual void run() = 0;

 private:
  friend class Pool;
  std::atomic<std::int64_t> usual_rest_ns_ = 0;  ///< how long its runs of late went on after what they submitted first
};

/// Where strands get their threads from: a pool in a host, the caller's own thread on a test bench.
class Executor {
 public:
  virtual ~Executor() = default;
  /// [any thread] Runs `runnable` soon, never on the caller's stack. The executor shares it until it has run.
  virtual void submit(std::shared_ptr<Runnable> runnable) = 0;
  /// Runs what waits, where the executor has no threads of its own; a caller is about to wait for it.
  virtual void help() {}
  /// Where its strands write what they are busy with; none: nobody watches them.
  virtual std::shared_ptr<Liveness> liveness() const { return nullptr; }
};

/// Runs the work of one instance, one piece after the other, on whichever thread the executor lends: handlers,
/// tasks and life-cycle calls never overlap, so a component needs no lock.
///
/// It holds at most one wake-up at a time: messages wait in bounded inboxes and are drained in batches.
class Strand final : public Runnable, public std::enable_shared_from_this<Strand> {
 public:
  Strand(std::string name, Executor& executor, Clock& clock);
  ~Strand() override;

  const std::string& name() const { return name_; }
  Clock& clock() const { return clock_; }

  /// [any thread] Queues `job`; false, and the job is destroyed, once the strand is closed.
  bool post(Job job);

  /// [any thread] Whether the calling thread is running this strand now.
  bool is_current() const;
  /// [any thread, signal handler] The name of the one that this thread works for, as long as it does; empty: none.
  static std::string_view current_name();

  /// [any thread, not this strand] Runs `work` on the strand and waits for its end, at most `deadline` of the
  /// machine's own time. False if it did not end by then (it is then skipped, or runs to its end unattended) or the
  /// strand is closed. What `work` throws is thrown here.
  bool call(Job work, Duration deadline);

  /// [any thread] Refuses new work and drops what is queued. What runs goes on; `call` waiters return false.
  void close();

  /// [any thread] Jobs that wait; what waits in inboxes is counted there.
  std::size_t waiting_jobs() const;
  /// [any thread] Time spent running, by the machine's steady clock.
  Duration busy_time() const { return Duration(busy_ns_.load(std::memory_order_relaxed)); }
  /// [any thread] CPU time that its work took: exact for a strand that runs at most ten times a second. Of more runs
  /// than that, some are measured, and the others taken to have waited for as much of their time.
  Duration cpu_time() const { return Duration(cpu_ns_.load(std::memory_order_relaxed)); }

  /// [strand] What the piece of work that runs is doing from here on, as `Liveness::mark` of a text.
  void begins(std::uint32_t mark) { place_.begins(mark); }

  void run() override;
  /// [clock] Lends it the thread that was kept back when it became busy.
  void start() { executor_.submit(shared_from_this()); }

 private:
  friend class Inbox;
  friend class VirtualClock;
  struct Turn;
  /// What comes after a turn: another one, a run after those of other strands, or nothing.
  enum class Next { Turn, Run, Rest };

  void wake(std::unique_lock<std::mutex>& lock);
  Next take_turn(Turn& turn);
  void run_turn(Turn& turn);
  bool is_measured(std::int64_t now_ns);
  void count_time(const Turn& turn);

  const std::string name_;
  Executor& executor_;
  Clock& clock_;
  Liveness::Place place_;
  mutable std::mutex mutex_;
  std::vector<Job> jobs_;
  std::vector<Inbox*> ready_;
  bool scheduled_ = false;
  std::atomic<bool> closed_{false};  ///< written under the mutex
  std::atomic<std::int64_t> busy_ns_{0};
  std::atomic<std::int64_t> cpu_ns_{0};
  // Of the thread that runs it: which runs have their CPU time measured, and what came of it.
  std::int64_t window_ns_ = 0;
  std::uint32_t chance_ = 1;
  double measured_busy_ns_ = 0;
  double measured_cpu_ns_ = 0;
  double cpu_share_ = 1;
  int busy_count_ = 0;          ///< the virtual clock's
  std::size_t busy_place_ = 0;  ///< the virtual clock's, among those that are busy
};

}  // namespace fiona
