// Which of a port's providers serves.
#include <google/protobuf/message.h>

#include <algorithm>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"
#include "fiona/port.hpp"

namespace fiona {

// ---- the ends of a port ---------------------------------------------------------------------------------------

std::shared_ptr<WireEnd> RequiredPort::end_for(const std::string& provider) {
  const std::lock_guard lock(mutex_);
  for (const auto& end : ends_) {
    if (end->provider_ == provider) return end;
  }
  return std::make_shared<WireEnd>(*this, provider);
}

bool RequiredPort::owns(const WireEnd& end) const {
  return std::any_of(ends_.begin(), ends_.end(), [&](const auto& one) { return one.get() == &end; });
}

/// Whether the end is the port's; one that comes takes the place of an only one.
bool RequiredPort::adopts(WireEnd& end) {
  if (owns(end)) return true;
  if (ends_.size() > 1) return false;
  serving_->open_ = false;
  serving_ = ends_.front() = end.shared_from_this();
  use_target(end.target_);
  end.open_ = !keeps_last();
  return true;
}

void RequiredPort::arrange(const std::vector<std::string>& providers, Duration hold) {
  Ends gone;  // let go outside the lock
  const std::lock_guard lock(mutex_);
  hold_ = hold;
  Ends next;
  for (const auto& name : providers) {
    const auto known =
        std::find_if(ends_.begin(), ends_.end(), [&](const auto& end) { return end->provider_ == name; });
    next.push_back(known == ends_.end() ? std::make_shared<WireEnd>(*this, name) : *known);
  }
  if (next.empty()) next.push_back(std::make_shared<WireEnd>(*this, ""));
  for (const auto& end : ends_) end->open_ = false;
  gone = std::exchange(ends_, std::move(next));
  if (ends_.size() == 1) return serve_only();
  choose();
}

std::vector<RequiredPort::Alternative> RequiredPort::alternatives() const {
  const std::lock_guard lock(mutex_);
  std::vector<Alternative> all;
  if (ends_.size() == 1) return all;
  for (const auto& end : ends_) {
    const Connection connection = end->silence_ ? Connection::Lost : end->connection_;
    const bool serves = end == serving_ && end->is_live();
    all.push_back({end->provider_, connection, end->is_fit() ? "" : end->unfitness(), end->is_fit(), serves});
  }
  return all;
}

Result<Duration> RequiredPort::provider_cycle() const {
  const std::lock_guard lock(mutex_);
  if (connection() == Connection::Connected)
    return serving_->cycle_ > Duration::zero() ? serving_->cycle_ : Result<Duration>(Outcome::NoData);
  return {connection() == Connection::Unwired ? Outcome::Unwired : Outcome::Disconnected, reason_};
}

void RequiredPort::repeat_last() {
  const std::lock_guard lock(mutex_);
  if (connection() == Connection::Connected && serving_->last_) inbox()->push(Parcel{*serving_->last_, nullptr});
}

void RequiredPort::connected(WireEnd& end, Connection connection, std::string reason) {
  const bool again = connection == Connection::Connected && serving_.get() == &end;
  change(end, [&] {
    end.connection_ = connection;
    end.reason_ = std::move(reason);
    end.silence_.reset();
    end.flaw_ = {};
    end.heard_ = false;
    end.last_.reset();
  });
  if (ends_.size() == 1) return enter(connection, end.reason_);
  again ? serve(serving_, true) : choose();
}

void RequiredPort::leased(WireEnd& end, bool held, const std::string& reason) {
  const auto silence = held ? std::nullopt : std::optional(end.reason_ + " " + reason);
  if (end.connection_ != Connection::Connected || silence == end.silence_) return;
  const bool was_silent = end.silence_.has_value();
  change(end, [&] {
    end.silence_ = silence;
    end.heard_ = end.heard_ || held;
  });
  if (ends_.size() > 1) return choose();
  if (was_silent && !held) {  // no further loss, but for another reason now
    reason_ = *silence;
    return;
  }
  held ? enter(Connection::Connected, end.reason_) : enter(Connection::Lost, *end.silence_);
}

Outcome RequiredPort::take(WireEnd& end, Parcel parcel) {
  if (!owns(end)) return Outcome::Disconnected;
  if (keeps_last()) end.last_ = parcel.envelope;
  const bool served = serving_.get() == &end;
  const std::string_view flaw = ends_.size() == 1 ? std::string_view() : flaw_of(parcel.envelope);
  if (!end.heard_ || flaw != end.flaw_) {
    change(end, [&] {
      end.flaw_ = flaw;
      end.heard_ = true;
    });
    if (ends_.size() > 1) choose();
  }
  if (serving_.get() != &end) return Outcome::Ok;
  if (!served && end.last_) return Outcome::Ok;  // it has come with the change
  return inbox()->push(std::move(parcel));
}

/// Why who says this is not to serve; empty: he may.
std::string_view RequiredPort::flaw_of(const Envelope& envelope) {
  const Object& object = *envelope.object;
  const bool has_field = validity_ && object.GetDescriptor() == validity_->containing_type();
  if (has_field && !object.GetReflection()->GetBool(object, validity_)) return "says that it is not valid";
  return inbox()->is_too_old(envelope) ? "says what is older than the port takes" : "";
}

// ---- the choice -----------------------------------------------------------------------------------------------

template <class Change>
void RequiredPort::change(WireEnd& end, const Change& make) {
  const bool was_fit = end.is_fit();
  const bool could_return = may_return(end);
  make();
  if (may_return(end) && !could_return) end.fit_since_ = hull().clock().now();
  if (ends_.size() == 1 || !was_fit || end.is_fit()) return;
  for (const auto& one : ends_) {
    if (one.get() == &end) flaps_.fetch_add(1, std::memory_order_relaxed);
    if (one.get() == &end || one == serving_) return;
  }
}

/// Who is to serve now. While nobody is fit, one that is at least there: what it says tells itself that it is not
/// valid.
std::shared_ptr<WireEnd> RequiredPort::best() const {
  const auto first = [this](bool (WireEnd::*is)() const) {
    const auto found = std::find_if(ends_.begin(), ends_.end(), [is](const auto& end) { return (*end.*is)(); });
    return found == ends_.end() ? nullptr : *found;
  };
  const bool serves = owns(*serving_);
  if (!serves || !serving_->is_fit()) {
    if (auto fit = first(&WireEnd::is_fit)) return fit;
    if (serves && serving_->is_live()) return serving_;
    if (auto live = first(&WireEnd::is_live)) return live;
    return serves ? serving_ : ends_.front();
  }
  const TimePoint now = hull().clock().now();
  for (const auto& end : ends_) {
    if (end == serving_ || (may_return(*end) && end->fit_since_ + hold_ <= now)) return end;
  }
  return serving_;
}

void RequiredPort::choose() {
  const auto next = best();
  if (!next->is_fit()) {
    if (next != serving_) use_target((serving_ = next)->target_);
    return enter_unfit();
  }
  serve(next, false);
  if (next_return() < TimePoint::max()) hull().strand().post([this] { arm_return(); });
}

/// `again`: over another wire.
void RequiredPort::serve(const std::shared_ptr<WireEnd>& chosen, bool again) {
  const auto next = chosen;  // which may be `serving_` itself
  if (next == serving_ && !again && connection() == Connection::Connected) return;
  const auto before = std::exchange(serving_, next);
  const bool changed = before != next;
  std::string news;
  if (changed) use_target(next->target_);
  if (changed && owns(*before)) {
    news = next->provider_ + (before->is_fit() ? " serves again" : " serves now; " + before->unfitness());
  }
  enter(Connection::Connected, next->reason_, std::move(news));
  if (changed && next->last_) inbox()->push(Parcel{*next->last_, nullptr});
}

/// The alternatives have gone, or all wires.
void RequiredPort::serve_only() {
  WireEnd& only = *ends_.front();
  const auto before = std::exchange(serving_, ends_.front());
  const bool changed = before != serving_;
  only.flaw_ = {};
  if (only.provider_.empty()) only.reason_ = "unwired";
  const Connection connection = only.silence_ ? Connection::Lost : only.connection_;
  if (changed) use_target(only.target_);
  if (changed || connection != this->connection()) enter(connection, only.silence_.value_or(only.reason_));
  if (changed && only.last_ && only.is_live()) inbox()->push(Parcel{*only.last_, nullptr});
  only.open_ = !keeps_last();
}

/// Nobody is fit.
void RequiredPort::enter_unfit() {
  const auto some = [this](const auto& fits) { return std::any_of(ends_.begin(), ends_.end(), fits); };
  const bool lost = some([](const auto& end) {
    return end->connection_ == Connection::Lost || end->connection_ == Connection::Connected;
  });
  const bool waits = some([](const auto& end) { return end->connection_ == Connection::Waiting; });
  const Connection connection = lost ? Connection::Lost : waits ? Connection::Waiting : Connection::Unwired;
  std::string reason;
  for (const auto& end : ends_) reason += (reason.empty() ? "" : "; ") + end->unfitness();
  if (connection == this->connection()) {
    reason_ = std::move(reason);
    return;
  }
  enter(connection, reason, lost ? "no provider is fit: " + reason : "");
}

/// When the first of those that are better than who serves has been fit for long enough.
TimePoint RequiredPort::next_return() const {
  TimePoint next = TimePoint::max();
  for (const auto& end : ends_) {
    if (end == serving_) return next;
    if (may_return(*end)) next = std::min(next, end->fit_since_ + hold_);
  }
  return next;
}

/// On the strand, where a virtual clock stands.
void RequiredPort::arm_return() {
  Clock& clock = hull().clock();
  clock.cancel(std::exchange(return_timer_, 0));
  TimePoint due;
  {
    const std::lock_guard lock(mutex_);
    due = next_return();
  }
  if (due == TimePoint::max()) return;
  return_timer_ = clock.schedule(due, hull().shared_strand(), [this] {
    const std::lock_guard lock(mutex_);
    choose();
  });
}

}  // namespace fiona
