#include "fiona/clock.hpp"

#include <algorithm>
#include <cassert>

namespace fiona {

void Clock::stage(std::string_view, std::uint64_t, Job delivery) { delivery(); }

// ---- system ---------------------------------------------------------------------------------------------------

SystemClock::SystemClock(Origin origin)
    : steady_start_(std::chrono::nanoseconds(origin.steady_ns)), start_(Duration(origin.start_ns)) {
  if (origin.steady_ns == 0) {
    steady_start_ = std::chrono::steady_clock::now();
    start_ = TimePoint(std::chrono::duration_cast<Duration>(std::chrono::system_clock::now().time_since_epoch()));
  }
  thread_ = std::thread([this] { serve(); });
}

SystemClock::Origin SystemClock::origin() const {
  return {std::chrono::duration_cast<std::chrono::nanoseconds>(steady_start_.time_since_epoch()).count(),
          start_.time_since_epoch().count()};
}

SystemClock::~SystemClock() { SystemClock::stop(); }

void SystemClock::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

TimePoint SystemClock::now() const { return start_ + Duration(std::chrono::steady_clock::now() - steady_start_); }

TimerId SystemClock::schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) {
  const std::lock_guard lock(mutex_);
  const TimerId id = next_id_++;
  const bool earliest = entries_.empty() || at < entries_.begin()->first.first;
  entries_.emplace(Key{at, id}, Entry{strand, std::move(job)});
  times_.emplace(id, at);
  if (earliest) changed_.notify_all();
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
    if (entries_.empty()) {
      changed_.wait(lock);
      continue;
    }
    const auto first = entries_.begin();
    const auto due = steady_start_ + (first->first.first - start_);
    if (std::chrono::steady_clock::now() < due) {
      changed_.wait_until(lock, due);
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

// ---- virtual --------------------------------------------------------------------------------------------------

VirtualClock::~VirtualClock() { VirtualClock::stop(); }

void VirtualClock::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  pacer_changed_.notify_all();
  if (pacer_.joinable()) pacer_.join();
}

TimePoint VirtualClock::now() const {
  const std::lock_guard lock(mutex_);
  return now_;
}

TimerId VirtualClock::schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) {
  TimerId id = 0;
  {
    const std::lock_guard lock(mutex_);
    id = next_id_++;
    const Key key{std::max(at, now_), strand->name(), id};
    entries_.emplace(key, Entry{strand, std::move(job), id});
    keys_.emplace(id, key);
  }
  proceed();
  return id;
}

void VirtualClock::cancel(TimerId timer) {
  Entry dropped;  // destroyed after the lock is released
  const std::lock_guard lock(mutex_);
  const auto found = keys_.find(timer);
  if (found == keys_.end()) return;
  const auto entry = entries_.find(found->second);
  dropped = std::move(entry->second);
  entries_.erase(entry);
  keys_.erase(found);
}

void VirtualClock::stage(std::string_view wire, std::uint64_t sequence, Job delivery) {
  {
    const std::lock_guard lock(mutex_);
    staged_.push_back({wire, sequence, std::move(delivery)});
  }
  proceed();
}

void VirtualClock::strand_busy() {
  const std::lock_guard lock(mutex_);
  ++busy_;
}

void VirtualClock::strand_idle() {
  {
    const std::lock_guard lock(mutex_);
    --busy_;
    assert(busy_ >= 0);
  }
  proceed();
}

void VirtualClock::release() {
  {
    const std::lock_guard lock(mutex_);
    ++releases_;
    pace_virtual_ = now_;
    pace_real_ = std::chrono::steady_clock::now();
  }
  proceed();
}

void VirtualClock::hold() {
  const std::lock_guard lock(mutex_);
  --releases_;
}

TimerId VirtualClock::stop_at(TimePoint at, Job then) {
  TimerId id = 0;
  {
    const std::lock_guard lock(mutex_);
    id = next_id_++;
    stops_.emplace(std::pair(std::max(at, now_), id), std::move(then));
  }
  proceed();
  return id;
}

void VirtualClock::cancel_stop(TimerId stop) {
  Job dropped;  // destroyed after the lock is released
  const std::lock_guard lock(mutex_);
  const auto found =
      std::find_if(stops_.begin(), stops_.end(), [stop](const auto& entry) { return entry.first.second == stop; });
  if (found == stops_.end()) return;
  dropped = std::move(found->second);
  stops_.erase(found);
}

void VirtualClock::set_speed(double speed) {
  {
    const std::lock_guard lock(mutex_);
    speed_ = speed;
    pace_virtual_ = now_;
    pace_real_ = std::chrono::steady_clock::now();
    wake_at_.reset();
    if (speed > 0 && !pacer_.joinable()) pacer_ = std::thread([this] { pace(); });
  }
  proceed();
}

double VirtualClock::speed() const {
  const std::lock_guard lock(mutex_);
  return speed_;
}

/// One thread proceeds at a time; whoever comes meanwhile leaves a note. The loop is left only when a strand is busy
/// (its end calls again), when nothing is due, or while time is held or paced.
void VirtualClock::proceed() {
  std::unique_lock lock(mutex_);
  if (proceeding_) {
    again_ = true;
    return;
  }
  proceeding_ = true;
  do {
    again_ = false;
    while (busy_ == 0 && next_round(lock)) {
    }
  } while (again_);
  proceeding_ = false;
}

/// Starts the next round of this instant, or the next instant. False when there is none to start.
bool VirtualClock::next_round(std::unique_lock<std::mutex>& lock) {
  if (!staged_.empty()) return deliver_staged(lock);
  if (releases_ <= 0) return false;
  const bool stop_first =
      !stops_.empty() && (entries_.empty() || stops_.begin()->first.first < std::get<0>(entries_.begin()->first));
  if (stop_first) return run_stop(lock);
  return !entries_.empty() && fire_timers(lock);
}

bool VirtualClock::deliver_staged(std::unique_lock<std::mutex>& lock) {
  std::vector<Staged> round;
  round.swap(staged_);
  lock.unlock();
  std::stable_sort(round.begin(), round.end(), [](const Staged& a, const Staged& b) {
    return std::tie(a.wire, a.sequence) < std::tie(b.wire, b.sequence);
  });
  for (auto& staged : round) staged.delivery();
  round.clear();
  lock.lock();
  return true;
}

bool VirtualClock::run_stop(std::unique_lock<std::mutex>& lock) {
  const TimePoint at = stops_.begin()->first.first;
  if (paced(at)) return false;
  now_ = at;
  Job then = std::move(stops_.begin()->second);
  stops_.erase(stops_.begin());
  lock.unlock();
  then();
  then = Job();
  lock.lock();
  return true;
}

bool VirtualClock::fire_timers(std::unique_lock<std::mutex>& lock) {
  const TimePoint next = std::get<0>(entries_.begin()->first);
  if (paced(next)) return false;
  now_ = next;
  std::vector<Entry> due;
  while (!entries_.empty() && std::get<0>(entries_.begin()->first) == next) {
    due.push_back(std::move(entries_.begin()->second));
    keys_.erase(due.back().id);
    entries_.erase(entries_.begin());
  }
  lock.unlock();
  for (auto& entry : due) {
    if (const auto strand = entry.strand.lock()) strand->post(std::move(entry.job));
  }
  due.clear();
  lock.lock();
  return true;
}

/// Whether `next` must wait for real time; the pacer then proceeds when it has come.
bool VirtualClock::paced(TimePoint next) {
  if (speed_ <= 0) return false;
  const auto real = std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::nano>(
      static_cast<double>((next - pace_virtual_).count()) / speed_));
  const auto due = pace_real_ + real;
  if (std::chrono::steady_clock::now() >= due) return false;
  wake_at_ = due;
  pacer_changed_.notify_all();
  return true;
}

void VirtualClock::pace() {
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    if (!wake_at_) {
      pacer_changed_.wait(lock);
      continue;
    }
    const auto due = *wake_at_;
    if (std::chrono::steady_clock::now() < due) {
      pacer_changed_.wait_until(lock, due);
      continue;
    }
    wake_at_.reset();
    lock.unlock();
    proceed();
    lock.lock();
  }
}

}  // namespace fiona
