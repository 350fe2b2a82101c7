#include "fiona/strand.hpp"

#include <time.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/port.hpp"

namespace fiona {
namespace {

/// Parcels of an inbox that a strand handles before it looks at what else waits.
constexpr std::size_t kTurnLimit = 256;
/// Turns and time after which it lets another one have the thread.
constexpr std::size_t kTurnsOfRun = 8;
constexpr std::int64_t kRunNs = 2'000'000;

constexpr std::uint32_t kRunsPerMeasured = 128;
constexpr double kKeptOfMeasured = 0.98;

constexpr std::uint32_t kWork = Liveness::mark("its work");

thread_local const Strand* current_strand = nullptr;

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

std::int64_t thread_cpu_ns() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

}  // namespace

struct Strand::Turn {
  std::int64_t begin_ns = steady_ns();  ///< of the run that it is part of
  std::int64_t cpu_begin_ns = -1;       ///< the same by the thread's CPU time; negative: that is not measured
  std::size_t taken = 0;                ///< turns of this run
  std::vector<Job> jobs{};
  std::vector<Inbox*> ready{};
};

Strand::Strand(std::string name, Executor& executor, Clock& clock)
    : name_(std::move(name)), executor_(executor), clock_(clock), place_(executor.liveness(), name_) {}

Strand::~Strand() = default;

bool Strand::is_current() const { return current_strand == this; }

std::string_view Strand::current_name() {
  return current_strand ? std::string_view(current_strand->name_) : std::string_view();
}

bool Strand::post(Job job) {
  std::unique_lock lock(mutex_);
  if (closed_) return false;
  jobs_.push_back(std::move(job));
  wake(lock);
  return true;
}

void Strand::wake(std::unique_lock<std::mutex>& lock) {
  if (scheduled_) return;
  scheduled_ = true;
  const bool may_start = clock_.strand_busy(*this);
  lock.unlock();
  if (may_start) start();
}

void Strand::run() {
  const Strand* outer = std::exchange(current_strand, this);
  Turn turn;
  if (is_measured(turn.begin_ns)) turn.cpu_begin_ns = thread_cpu_ns();
  Next next = take_turn(turn);
  for (; next == Next::Turn; next = take_turn(turn)) run_turn(turn);
  current_strand = outer;
  if (next == Next::Run) {
    executor_.submit(shared_from_this());
  } else {
    clock_.strand_idle(*this);
  }
}

// To read a thread's CPU time the kernel is called, which takes longer than to hand over a message. So of a strand that
// runs often only some runs are measured, so few that the hundredth of its messages that waits longest is none of
// theirs: the first of each tenth of a second, and one in kRunsPerMeasured, by chance lest it be always the same one of
// a rhythm.
bool Strand::is_measured(std::int64_t now_ns) {
  if (now_ns - window_ns_ >= 100'000'000) {
    window_ns_ = now_ns;
    return true;
  }
  chance_ = chance_ * 1664525U + 1013904223U;
  return (chance_ >> 16U) % kRunsPerMeasured == 0;
}

// Those that are not measured have waited for as much of their time as those that were.
void Strand::count_time(const Turn& turn) {
  const std::int64_t busy_ns = steady_ns() - turn.begin_ns;
  busy_ns_.fetch_add(busy_ns, std::memory_order_relaxed);
  auto cpu_ns = static_cast<std::int64_t>(static_cast<double>(busy_ns) * cpu_share_);
  if (turn.cpu_begin_ns >= 0 && busy_ns > 0) {
    cpu_ns = std::min(thread_cpu_ns() - turn.cpu_begin_ns, busy_ns);
    measured_busy_ns_ += static_cast<double>(busy_ns);
    measured_cpu_ns_ += static_cast<double>(cpu_ns);
    cpu_share_ = measured_cpu_ns_ / measured_busy_ns_;
    // What was long ago counts less and less.
    measured_busy_ns_ *= kKeptOfMeasured;
    measured_cpu_ns_ *= kKeptOfMeasured;
  }
  cpu_ns_.fetch_add(cpu_ns, std::memory_order_relaxed);
}

Strand::Next Strand::take_turn(Turn& turn) {
  const std::lock_guard lock(mutex_);
  const bool rests = jobs_.empty() && ready_.empty();
  const bool ends = rests || turn.taken == kTurnsOfRun || (turn.taken > 0 && steady_ns() - turn.begin_ns > kRunNs);
  if (ends) {
    count_time(turn);  // before another thread may run it
    place_.rests();
    scheduled_ = !rests;
    return rests ? Next::Rest : Next::Run;
  }
  ++turn.taken;
  turn.jobs.swap(jobs_);
  turn.ready.swap(ready_);
  for (Inbox* inbox : turn.ready) inbox->ready_ = false;
  return Next::Turn;
}

void Strand::run_turn(Turn& turn) {
  // A piece of work may close the strand and destroy what the rest of the turn refers to.
  for (auto& job : turn.jobs) {
    begins(kWork);
    if (!closed_) job();
  }
  turn.jobs.clear();
  for (Inbox* inbox : turn.ready) {
    if (!closed_) inbox->drain(kTurnLimit);
  }
  turn.ready.clear();
}

namespace {

/// A `call` under way, shared by the caller who waits and the job that runs or is dropped.
struct Call {
  enum class Stage { Waiting, Running, Done, Dropped };
  std::mutex mutex;
  std::condition_variable changed;
  Stage stage = Stage::Waiting;
  std::exception_ptr error;
  Job work;

  bool enter(Stage next) {
    const std::lock_guard lock(mutex);
    if (stage == Stage::Dropped || stage == Stage::Done) return false;
    stage = next;
    changed.notify_all();
    return true;
  }
  void run() {
    if (!enter(Stage::Running)) return;
    try {
      work();
    } catch (...) {
      error = std::current_exception();
    }
    work = Job();
    enter(Stage::Done);
  }
};

/// Tells the caller when a closing strand drops the job.
struct CallGuard {
  std::shared_ptr<Call> call;
  explicit CallGuard(std::shared_ptr<Call> c) : call(std::move(c)) {}
  CallGuard(CallGuard&&) = default;
  ~CallGuard() {
    if (call) call->enter(Call::Stage::Dropped);
  }
};

}  // namespace

bool Strand::call(Job work, Duration deadline) {
  auto call = std::make_shared<Call>();
  call->work = std::move(work);
  if (!post([guard = CallGuard(call)] { guard.call->run(); })) return false;
  executor_.help();
  std::unique_lock lock(call->mutex);
  call->changed.wait_for(lock, deadline, [&] { return call->stage >= Call::Stage::Done; });
  if (call->stage == Call::Stage::Waiting) call->stage = Call::Stage::Dropped;
  if (call->stage != Call::Stage::Done) return false;
  // Taken out, so that the caller's thread alone sees the exception's end.
  if (const auto error = std::exchange(call->error, nullptr)) std::rethrow_exception(error);
  return true;
}

void Strand::close() {
  std::vector<Job> dropped;  // destroyed after the lock is released: what a job holds may post again
  const std::lock_guard lock(mutex_);
  closed_ = true;
  dropped.swap(jobs_);
  ready_.clear();
}

std::size_t Strand::waiting_jobs() const {
  const std::lock_guard lock(mutex_);
  return jobs_.size();
}

}  // namespace fiona
