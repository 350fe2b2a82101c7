#include "fiona/task.hpp"

#include <cxxabi.h>

#include <algorithm>
#include <system_error>

#include "fiona/hull.hpp"
#include "own_thread.hpp"

namespace fiona {

When on(Port& port, std::uint32_t every) {
  When when(When::Kind::OnPort);
  when.port_ = &port;
  when.every_ = every;
  return when;
}

When after(Task& task) {
  When when(When::Kind::AfterTask);
  when.task_ = &task;
  return when;
}

std::string When::of() const { return port_ ? port_->name() : task_ ? task_->name() : ""; }

Task::Task(Component& owner, std::string_view name, When when, Work work, std::string_view activity,
           ThreadWork thread_work)
    : hull_(owner.hull()),
      name_(name),
      when_(when),
      work_(std::move(work)),
      thread_work_(std::move(thread_work)),
      activity_(activity),
      mark_(Liveness::mark("task '" + name_ + "'")) {
  if (when_.kind() == When::Kind::Periodic && when_.period() <= Duration::zero()) {
    throw Error(ErrorCode::Usage, {.what = "task '" + name_ + "' has no period",
                                   .expected = "a period above zero",
                                   .next = "give the task, or the service's contract, a period"});
  }
  if (when_.every() == 0) {
    throw Error(ErrorCode::Usage,
                {.what = "task '" + name_ + "' is to start at each 0th arrival", .expected = "1 or more"});
  }
  hull_.add(*this);
}

Task::~Task() {
  // Only of a hull that was never shut down: the thread has nothing of this one left to touch, or never comes back.
  if (thread_.joinable()) thread_.detach();
}

// ---- what starts it -------------------------------------------------------------------------------------------

/// Once all members of the component are there, so that their order does not matter.
void Task::attach() {
  if (when_.kind() == When::Kind::OnPort) attach_to_port();
  if (when_.kind() == When::Kind::AfterTask) attach_to_task();
}

void Task::attach_to_port() {
  const auto& ports = hull_.ports_;
  const bool ours = std::find(ports.begin(), ports.end(), when_.port_) != ports.end();
  Inbox* inbox = ours ? when_.port_->inbox() : nullptr;
  if (inbox) return inbox->start_on_arrival(*this);
  const std::string port = ours ? "port '" + when_.of() + "', at which nothing arrives" : "a port of another component";
  throw Error(ErrorCode::Usage, {.what = "task '" + name_ + "' is to start on " + port,
                                 .where = hull_.name(),
                                 .expected = "a port that requires a push, or provides a send, query or event",
                                 .next = "name such a port, or a period"});
}

void Task::attach_to_task() {
  const auto& tasks = hull_.tasks_;
  if (std::find(tasks.begin(), tasks.end(), when_.task_) == tasks.end()) {
    throw Error(ErrorCode::Usage, {.what = "task '" + name_ + "' is to start after one of another component",
                                   .where = hull_.name(),
                                   .expected = "a task of its own component"});
  }
  std::size_t steps = 0;
  for (const Task* one = this; one && steps <= tasks.size(); one = one->when_.task_) ++steps;
  if (steps > tasks.size()) {
    throw Error(ErrorCode::Usage,
                {.what = "task '" + name_ + "' is to start after itself, by way of '" + when_.of() + "'",
                 .where = hull_.name(),
                 .expected = "a chain that begins with a period, a port or a thread"});
  }
  when_.task_->followers_.push_back(this);
}

void Task::start() {
  if (running_.exchange(true)) return;
  ++start_count_;
  arrivals_ = 0;
  if (is_free_running()) return launch();
  if (when_.kind() != When::Kind::Periodic) return;
  due_ = hull_.clock().now() + when_.period();
  arm();
}

void Task::stop() {
  running_ = false;
  ++start_count_;
  hull_.clock().cancel(timer_);
  ask_to_stop();
}

void Task::arm() {
  timer_ = hull_.clock().schedule(due_, hull_.shared_strand(), [this, count = start_count_] { fire(count); });
}

void Task::fire(std::uint64_t start_count) {
  if (!running_ || start_count != start_count_) return;
  begin(due_);
  if (!running_ || start_count != start_count_) return;
  next_due();
  arm();
}

/// The next time on the grid that has not passed.
void Task::next_due() {
  due_ += when_.period();
  const TimePoint now = hull_.clock().now();
  if (due_ >= now) return;
  const auto missed = (now - due_) / when_.period() + 1;
  overruns_.fetch_add(static_cast<std::uint64_t>(missed), std::memory_order_relaxed);
  due_ += missed * when_.period();
}

bool Task::takes_arrival() {
  return running_ && arrivals_.fetch_add(1, std::memory_order_relaxed) % when_.every() == 0;
}

bool Task::note() {
  if (!noted_.exchange(true)) return true;
  overruns_.fetch_add(1, std::memory_order_relaxed);
  return false;
}

void Task::begin_noted(TimePoint since) {
  noted_ = false;
  begin(since);
}

// ---- a run on the strand --------------------------------------------------------------------------------------

void Task::begin(TimePoint since) {
  if (!running_ || !hull_.is_active()) return;
  if (busy_) {
    overruns_.fetch_add(1, std::memory_order_relaxed);
  } else if (!hull_.is_leaving(activity_)) {
    run(since);
  }
}

void Task::run(TimePoint since) {
  runs_.fetch_add(1, std::memory_order_relaxed);
  late_ns_.store((hull_.clock().now() - since).count(), std::memory_order_relaxed);
  std::optional<Async<>> coroutine;
  hull_.strand().begins(mark_);
  hull_.guarded([&] { coroutine = work_(); });
  if (!coroutine) return has_ended();
  busy_ = true;
  if (auto hold = hull_.acquire(activity_, "task '" + name_ + "'"))
    hold_ = std::make_shared<ActivityHold>(std::move(*hold));
  hull_.spawn(std::move(*coroutine), [this] {
    busy_ = false;
    hold_.reset();
    has_ended();
  });
}

void Task::has_ended() {
  for (Task* follower : followers_) follower->begin(hull_.clock().now());
}

// ---- a thread of its own --------------------------------------------------------------------------------------

/// Not while a change waits that leaves its activity: if that is withdrawn, `resume` comes.
void Task::launch() {
  auto hold = hull_.acquire(activity_, "task '" + name_ + "'");
  if (!hold) return;
  auto own = std::make_shared<OwnThread::Shared>(hull_, hull_.shared_strand());
  try {
    thread_ = std::thread([this, own = OwnThread(own), since = hull_.clock().now()] { turn(own, since); });
  } catch (const std::system_error& error) {
    return hull_.fail("task '" + name_ + "' gets no thread: " + error.code().message());
  }
  own_ = std::move(own);  // only of one that runs: a shutdown waits for its end
  hull_.note_thread(*this, own_->stop);
  hold_ = std::make_shared<ActivityHold>(std::move(*hold));
}

/// [its thread]
void Task::turn(const OwnThread& own, TimePoint since) {
  late_ns_.store((hull_.clock().now() - since).count(), std::memory_order_relaxed);
  const auto end = [&](std::optional<std::string> failure) {
    own.shared_->strand->post([this, failure = std::move(failure)] { thread_has_ended(failure); });
    own.shared_->end();
  };
  std::optional<std::string> failure;
  try {
    do {
      runs_.fetch_add(1, std::memory_order_relaxed);
      thread_work_(own);
      for (Task* follower : followers_) {
        const auto begin = [follower, now = hull_.clock().now()] { follower->begin_noted(now); };
        if (follower->note()) own.shared_->strand->post(begin);
      }
    } while (!own.stop_requested());
  } catch (const abi::__forced_unwind&) {  // which nobody may stop; the thread is this task's alone
    end("task '" + name_ + "' has ended its thread (pthread_exit, or a cancellation)");
    throw;
  } catch (...) {
    failure = detail::reason_of_exception();
  }
  end(std::move(failure));
}

void Task::thread_has_ended(const std::optional<std::string>& failure) {
  thread_.join();
  hull_.note_thread(*this, std::nullopt);
  own_.reset();
  if (failure) hull_.fail(*failure);
  hold_.reset();
  resume();
}

void Task::resume() {
  if (is_free_running() && running_ && !thread_.joinable() && hull_.is_active()) launch();
}

void Task::ask_to_stop() {
  if (own_) own_->stop.request_stop();
}

// ---- timers ---------------------------------------------------------------------------------------------------

Timer::Timer(Component& owner, std::function<void()> work)
    : hull_(owner.hull()), state_(std::make_shared<State>(State{std::move(work)})) {
  hull_.timers_.insert(this);
}

Timer::~Timer() {
  cancel();
  hull_.timers_.erase(this);
}

void Timer::at(TimePoint time) {
  cancel();
  const auto work = [&hull = hull_, state = state_, setting = state_->setting] {
    if (setting == state->setting && hull.is_active()) hull.guarded(state->work);
  };
  timer_ = hull_.clock().schedule(time, hull_.shared_strand(), work);
}

void Timer::cancel() {
  ++state_->setting;
  hull_.clock().cancel(timer_);
}

}  // namespace fiona
