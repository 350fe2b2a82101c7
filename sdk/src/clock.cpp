#include "fiona/clock.hpp"

#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <system_error>

namespace fiona {

void Clock::stage(Staged staged) { staged.deliver(); }

SystemClock::SystemClock(Origin origin)
    : steady_start_(std::chrono::nanoseconds(origin.steady_ns)),
      start_(Duration(origin.start_ns)),
      alarm_(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC)) {
  if (alarm_ < 0) throw std::system_error(errno, std::generic_category(), "timerfd_create");
  if (origin.steady_ns == 0) {
    steady_start_ = std::chrono::steady_clock::now();
    start_ = TimePoint(std::chrono::duration_cast<Duration>(std::chrono::system_clock::now().time_since_epoch()));
  }
  try {
    thread_ = std::thread([this] { serve(); });
  } catch (...) {
    ::close(alarm_);
    throw;
  }
}

SystemClock::Origin SystemClock::origin() const {
  return {std::chrono::duration_cast<std::chrono::nanoseconds>(steady_start_.time_since_epoch()).count(),
          start_.time_since_epoch().count()};
}

SystemClock::~SystemClock() {
  SystemClock::stop();
  ::close(alarm_);
}

void SystemClock::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    wake_at(TimePoint::min());
  }
  if (thread_.joinable()) thread_.join();
}

TimePoint SystemClock::now() const { return start_ + Duration(std::chrono::steady_clock::now() - steady_start_); }

TimerId SystemClock::schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) {
  const std::lock_guard lock(mutex_);
  const TimerId id = next_id_++;
  entries_.emplace(Key{at, id}, Entry{strand, std::move(job)});
  times_.emplace(id, at);
  if (at < wakes_at_) wake_at(at);
  return id;
}

void SystemClock::cancel(TimerId timer) {
  Entry dropped;  // destroyed after the lock is released
  const std::lock_guard lock(mutex_);
  const auto found = times_.find(timer);
  if (found == times_.end()) return;
  const auto entry = entries_.find(Key{found->second, timer});
  dropped = std::move(entry->second);
  entries_.erase(entry);
  times_.erase(found);
}

void SystemClock::serve() {
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    const auto first = entries_.begin();
    const TimePoint due = first == entries_.end() ? TimePoint::max() : first->first.first;
    if (now() < due) {
      wake_at(due);
      lock.unlock();
      std::uint64_t times = 0;
      [[maybe_unused]] const auto read = ::read(alarm_, &times, sizeof times);  // early, where a signal comes
      lock.lock();
      continue;
    }
    Entry entry = std::move(first->second);
    times_.erase(first->first.second);
    entries_.erase(first);
    lock.unlock();
    if (const auto strand = entry.strand.lock()) strand->post(std::move(entry.job));
    entry = Entry{};
    lock.lock();
  }
}

/// Sleeps on though a timer is cancelled: most are, as the deadlines of calls that end in time, and the next one is
/// later. Called with the lock held.
void SystemClock::wake_at(TimePoint at) {
  wakes_at_ = at;
  const TimePoint time = now();
  const Duration rest = at > time ? at - time : Duration(0);
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(rest);
  itimerspec once{{0, 0}, {seconds.count(), std::max<std::int64_t>(1, (rest - seconds).count())}};
  if (at == TimePoint::max()) once = {};  // which sets it for never
  ::timerfd_settime(alarm_, 0, &once, nullptr);
}

}  // namespace fiona
