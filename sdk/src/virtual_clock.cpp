#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>

#include <algorithm>
#include <array>
#include <cassert>

#include "fiona/clock.hpp"
#include "fiona/secrets.hpp"

namespace fiona {
namespace {

constexpr std::uint64_t kFnvOffset = 0xcbf29ce484222325;
constexpr std::uint64_t kFnvPrime = 0x100000001b3;

/// What a delivery log says of one delivery. Nothing of a password, whose hash would tell whether a guess is right.
std::string_view what_of(const Staged& staged, std::array<char, 16>& digits) {
  if (!staged.object) return staged.word;
  std::uint64_t hash = hash_of(*WithoutSecrets(*staged.object));
  for (auto digit = digits.rbegin(); digit != digits.rend(); ++digit, hash >>= 4)
    *digit = "0123456789abcdef"[hash & 0xf];
  return {digits.data(), digits.size()};
}

}  // namespace

std::uint64_t hash_of(const Object& object) {
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::io::CodedOutputStream coded(&stream);
    coded.SetSerializationDeterministic(true);
    object.SerializeToCodedStream(&coded);
  }
  std::uint64_t hash = kFnvOffset;
  for (const char byte : bytes) hash = (hash ^ static_cast<unsigned char>(byte)) * kFnvPrime;
  return hash;
}

VirtualClock::~VirtualClock() { VirtualClock::stop(); }

void VirtualClock::stop() {
  {
    Lock lock(mutex_);
    stopping_ = true;
    pacer_changed_.notify_all();
    proceeded_.wait(lock, [this] { return !proceeding_; });
  }
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
    if (shared_) return id;
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

void VirtualClock::stage(Staged staged) {
  {
    const std::lock_guard lock(mutex_);
    staged_.push_back(std::move(staged));
    if (shared_) return;
  }
  proceed();
}

/// One that is woken again before it has told that it is idle is busy twice for a moment.
bool VirtualClock::strand_busy(Strand& strand) {
  const std::lock_guard lock(mutex_);
  if (++strand.busy_count_ == 1) {
    strand.busy_place_ = busy_.size();
    busy_.push_back(&strand);
  }
  if (holding_back_) held_back_.push_back(strand.shared_from_this());
  return !holding_back_;
}

void VirtualClock::strand_idle(Strand& strand) {
  {
    const std::lock_guard lock(mutex_);
    ++progress_;
    if (--strand.busy_count_ > 0) return;
    assert(busy_.at(strand.busy_place_) == &strand);
    busy_[strand.busy_place_] = busy_.back();
    busy_[strand.busy_place_]->busy_place_ = strand.busy_place_;
    busy_.pop_back();
  }
  proceed();
}

std::vector<std::string> VirtualClock::busy_strands() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names;
  for (const Strand* strand : busy_) names.push_back(strand->name());
  return names;
}

std::uint64_t VirtualClock::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

void VirtualClock::set_recorder(std::shared_ptr<DeliveryRecorder> recorder) {
  const std::lock_guard lock(mutex_);
  recorder_.swap(recorder);
}

void VirtualClock::lead(OtherProcesses& others) {
  const std::lock_guard lock(mutex_);
  others_ = &others;
  shared_ = true;
}

bool VirtualClock::settle(Duration most) {
  Lock lock(mutex_);
  const std::uint64_t before = settled_;
  lock.unlock();
  proceed();
  lock.lock();
  return settled_changed_.wait_for(lock, most, [&] { return settled_ != before; });
}

void VirtualClock::note_settled() {
  ++settled_;
  settled_changed_.notify_all();
}

bool VirtualClock::released() const {
  const std::lock_guard lock(mutex_);
  return releases_ > 0;
}

void VirtualClock::release() {
  {
    const std::lock_guard lock(mutex_);
    // Who comes while time runs is no new beginning: what has passed since the last event would be lost.
    if (++releases_ == 1) {
      pace_virtual_ = now_;
      pace_real_ = std::chrono::steady_clock::now();
    }
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
  Lock lock(mutex_);
  if (proceeding_ || stopping_) {
    again_ = true;
    return;
  }
  proceeding_ = true;
  do {
    again_ = false;
    while (!stopping_ && idle() && next_round(lock)) ++progress_;
  } while (again_ && !stopping_);
  proceeding_ = false;
  if (stopping_) proceeded_.notify_all();
}

bool VirtualClock::next_round(Lock& lock) {
  OtherProcesses::Situation others;
  if (others_) {
    lock.unlock();
    others = others_->situation();
    lock.lock();
    if (!others.quiet || !idle()) return false;
  }
  if (staged() > 0 || others.staged) {
    if (recorder_) recorder_->round(now_);
    if (others_) others_->deliver(now_);
    return deliver_staged(lock, staged());
  }
  note_settled();
  if (releases_ <= 0) return false;
  const TimePoint next = std::min(next_timer(), others.next);
  if (!stops_.empty() && stops_.begin()->first.first < next) return run_stop(lock);
  if (next == TimePoint::max() || paced(next)) return false;
  advance_to(next);
  if (recorder_) recorder_->round(now_);
  if (others_) others_->fire(now_);
  return fire_timers(lock, now_);
}

bool VirtualClock::deliver_staged(Lock& lock, std::size_t count) {
  if (count >= staged_.size()) {
    round_.swap(staged_);
  } else {
    const auto end = staged_.begin() + static_cast<std::ptrdiff_t>(count);
    round_.assign(std::make_move_iterator(staged_.begin()), std::make_move_iterator(end));
    staged_.erase(staged_.begin(), end);
  }
  const auto recorder = recorder_;
  const TimePoint at = now_;
  holding_back_ = true;
  lock.unlock();
  std::stable_sort(round_.begin(), round_.end(), [](const Staged& a, const Staged& b) {
    return std::tie(a.wire, a.sequence) < std::tie(b.wire, b.sequence);
  });
  std::array<char, 16> digits{};
  for (auto& staged : round_) {
    const bool told = staged.object || !staged.word.empty();
    if (recorder && told) recorder->delivered(at, staged.wire, staged.sequence, what_of(staged, digits));
    staged.deliver();
  }
  round_.clear();
  lock.lock();
  start_held_back(lock);
  return true;
}

/// What a strand does first, and what overtakes what in its inboxes, must not depend on how soon it gets a thread.
void VirtualClock::start_held_back(Lock& lock) {
  holding_back_ = false;
  const auto held_back = std::exchange(held_back_, {});
  lock.unlock();
  for (const auto& strand : held_back) strand->start();
  lock.lock();
}

bool VirtualClock::run_stop(Lock& lock) {
  const TimePoint at = stops_.begin()->first.first;
  if (paced(at)) return false;
  advance_to(at);
  Job then = std::move(stops_.begin()->second);
  stops_.erase(stops_.begin());
  lock.unlock();
  then();
  then = Job();
  lock.lock();
  return true;
}

bool VirtualClock::fire_timers(Lock& lock, TimePoint at) {
  std::vector<Entry> due;
  while (next_timer() <= at) {
    due.push_back(std::move(entries_.begin()->second));
    keys_.erase(due.back().id);
    entries_.erase(entries_.begin());
  }
  holding_back_ = true;
  lock.unlock();
  for (auto& entry : due) {
    if (const auto strand = entry.strand.lock()) strand->post(std::move(entry.job));
  }
  due.clear();
  lock.lock();
  start_held_back(lock);
  return true;
}

/// Whether `next` must wait for real time; the pacer then proceeds when it has come.
bool VirtualClock::paced(TimePoint next) {
  if (speed_ <= 0) return false;
  const auto real = std::chrono::duration_cast<Duration>(
      std::chrono::duration<double, std::nano>(static_cast<double>((next - pace_virtual_).count()) / speed_));
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
