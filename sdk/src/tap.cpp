#include "fiona/tap.hpp"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>

#include <utility>

namespace fiona {
namespace {

/// Equal objects give equal bytes, maps too.
std::string bytes_of(const Object& object) {
  std::string bytes;
  google::protobuf::io::StringOutputStream stream(&bytes);
  google::protobuf::io::CodedOutputStream coded(&stream);
  coded.SetSerializationDeterministic(true);
  object.SerializeToCodedStream(&coded);
  coded.Trim();
  return bytes;
}

}  // namespace

Tap::Tap(std::string name, TapTerms terms, std::shared_ptr<Strand> strand, std::shared_ptr<Watcher> watcher)
    : name_(std::move(name)),
      terms_(std::move(terms)),
      strand_(std::move(strand)),
      clock_(strand_->clock()),
      watcher_(std::move(watcher)) {
  newest_.origin = clock_.now();
}

void Tap::start(Sample sample) {
  {
    const std::lock_guard lock(mutex_);
    sample_ = std::move(sample);
    if (terms_.older_than > Duration::zero()) wake_at(saturating_sum(newest_.origin, terms_.older_than));
    if (sample_) next_ = clock_.now();
  }
  if (sample_) sample_now();
}

void Tap::stop() {
  TimerId timer = 0;
  Sample sample;  // destroyed after the lock is released
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
    sample.swap(sample_);
    timer = timer_;
  }
  clock_.cancel(timer);
}

void Tap::end(const Error& why) {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(stopped_, true)) return;
    watcher_->ended(why);
  }
  stop();
}

Outcome Tap::deliver(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  if (stopped_) return Outcome::Disconnected;
  take(parcel.envelope);
  return Outcome::Ok;
}

/// Called with the mutex held, as are those below: by count, then by time, then by condition.
void Tap::take(const Envelope& envelope) {
  if (terms_.older_than > Duration::zero()) return judge_age(envelope);
  if (taken_++ % terms_.every != 0) return;
  if (sample_ || terms_.period <= Duration::zero()) return judge(envelope);
  const TimePoint now = clock_.now();
  if (pending_ && !terms_.holds && !terms_.changes) ++skipped_;
  if (now < next_) {
    pending_ = envelope;
    return wake_at(next_);
  }
  pending_.reset();
  next_ = saturating_sum(now, terms_.period);
  judge(envelope);
}

void Tap::judge(const Envelope& envelope) {
  if (terms_.changes) {
    std::string now = bytes_of(*envelope.object);
    const bool changed = before_ && *before_ != now;
    before_ = std::move(now);
    if (changed) pass_on(envelope);
    return;
  }
  if (!terms_.holds) return pass_on(envelope);
  try {
    const bool before = std::exchange(held_, terms_.holds(*envelope.object));
    if (held_ && !before) pass_on(envelope);
  } catch (const Error& error) {
    stopped_ = true;
    watcher_->ended(error);
  }
}

void Tap::judge_age(const Envelope& envelope) {
  newest_ = envelope;
  const bool before = std::exchange(held_, is_old(clock_.now()));
  if (held_ && !before) pass_on(newest_);
  if (!held_) wake_at(saturating_sum(newest_.origin, terms_.older_than));
}

void Tap::pass_on(const Envelope& envelope) { watcher_->value({envelope, ++number_, skipped_}); }

/// By way of the strand: a clock that is asked for a time may do what is due on the asker's stack.
void Tap::wake_at(TimePoint at) {
  if (wake_) return;
  wake_ = at;
  strand_->post([weak = weak_from_this()] {
    if (const auto self = std::static_pointer_cast<Tap>(weak.lock())) self->arm();
  });
}

void Tap::arm() {
  TimePoint at;
  {
    const std::lock_guard lock(mutex_);
    if (stopped_ || !wake_) return;
    at = *wake_;
  }
  const TimerId timer = clock_.schedule(at, strand_, [weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->fire();
  });
  const std::lock_guard lock(mutex_);
  timer_ = timer;
}

void Tap::fire() {
  bool sampled = false;
  {
    const std::lock_guard lock(mutex_);
    wake_.reset();
    if (stopped_) return;
    sampled = sample_ != nullptr;
    if (!sampled) on_time();
  }
  if (!sampled) return;
  if (!clock_.staging()) return sample_now();
  // Simulated: when all strands have done what belongs to this instant.
  clock_.stage({name_, ++staged_, nullptr, {}, [self = shared_from_this()] { self->sample_now(); }});
}

void Tap::on_time() {
  if (terms_.older_than > Duration::zero()) {
    if (held_) return;
    held_ = is_old(clock_.now());
    return held_ ? pass_on(newest_) : wake_at(saturating_sum(newest_.origin, terms_.older_than));
  }
  if (!pending_) return;
  next_ = saturating_sum(clock_.now(), terms_.period);
  const Envelope envelope = *std::exchange(pending_, std::nullopt);
  judge(envelope);
}

/// Keeps to the grid of its period; what was missed is not made up for.
void Tap::sample_now() {
  const std::lock_guard lock(mutex_);
  if (stopped_) return;
  if (auto envelope = sample_()) {
    envelope->sequence = taken_ + 1;
    take(*envelope);
  }
  const Duration period = terms_.period > Duration::zero() ? terms_.period : kSamplePeriod;
  const TimePoint now = clock_.now();
  next_ = saturating_sum(next_, period);
  if (next_ <= now) next_ += ((now - next_) / period + 1) * period;
  wake_at(next_);
}

}  // namespace fiona
