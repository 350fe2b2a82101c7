#include "fiona/task.hpp"

#include "fiona/hull.hpp"

namespace fiona {

Task::Task(Component& owner, std::string_view name, Duration period, Work work, std::string_view activity)
    : hull_(owner.hull()), name_(name), period_(period), work_(std::move(work)), activity_(activity) {
  if (period_ <= Duration::zero()) {
    throw Error(ErrorCode::Usage, {.what = "task '" + name_ + "' has no period",
                                   .expected = "a period above zero",
                                   .next = "give the task, or the service's contract, a period"});
  }
  hull_.tasks_.push_back(this);
}

void Task::start() {
  if (running_) return;
  running_ = true;
  ++start_count_;
  due_ = hull_.clock().now() + period_;
  arm();
}

void Task::stop() {
  running_ = false;
  ++start_count_;
  hull_.clock().cancel(timer_);
}

void Task::arm() {
  timer_ = hull_.clock().schedule(due_, hull_.shared_strand(), [this, count = start_count_] { fire(count); });
}

void Task::fire(std::uint64_t start_count) {
  if (!running_ || start_count != start_count_) return;
  if (busy_) {
    overruns_.fetch_add(1, std::memory_order_relaxed);
  } else if (!hull_.is_leaving(activity_)) {
    run();
  }
  if (!running_ || start_count != start_count_) return;
  next_due();
  arm();
}

void Task::run() {
  runs_.fetch_add(1, std::memory_order_relaxed);
  late_ns_.store((hull_.clock().now() - due_).count(), std::memory_order_relaxed);
  std::optional<Async<>> coroutine;
  hull_.guarded([&] { coroutine = work_(); });
  if (!coroutine) return;
  busy_ = true;
  if (auto hold = hull_.acquire(activity_, "task '" + name_ + "'")) hold_ = std::make_shared<ActivityHold>(std::move(*hold));
  hull_.spawn(std::move(*coroutine), [this] {
    busy_ = false;
    hold_.reset();
  });
}

/// The next time on the grid that has not passed.
void Task::next_due() {
  due_ += period_;
  const TimePoint now = hull_.clock().now();
  if (due_ >= now) return;
  const auto missed = (now - due_) / period_ + 1;
  overruns_.fetch_add(static_cast<std::uint64_t>(missed), std::memory_order_relaxed);
  due_ += missed * period_;
}

Timer::Timer(Component& owner, std::function<void()> work) : hull_(owner.hull()), work_(std::move(work)) {
  hull_.timers_.insert(this);
}

void Timer::at(TimePoint time) {
  cancel();
  timer_ = hull_.clock().schedule(time, hull_.shared_strand(), [this, setting = setting_] {
    if (setting == setting_) hull_.guarded(work_);
  });
}

void Timer::cancel() {
  ++setting_;
  hull_.clock().cancel(timer_);
}

}  // namespace fiona
