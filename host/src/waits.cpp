#include "waits.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <vector>

#include "failure.hpp"
#include "field_compare.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "names.hpp"

namespace fiona::host {

struct Waits::Wait {
  std::uint64_t owner = 0;
  std::uint64_t id = 0;
  Answer answer;
  TimePoint since{};
  TimerId timer = 0;
  bool ended = false;
  bool running = false;  ///< a virtual clock was released for it
  bool is_run = false;
  std::optional<control::WaitMode> mode;
  EndOf end_of;
  std::function<void()> given_up;
  std::optional<control::Expect> expect;
  std::uint64_t tap = 0;
  std::string seen;  ///< the last value that did not meet the expectation
};

control::Reply failure_reply(ErrorCode code, ErrorText text) {
  control::Reply reply;
  *reply.mutable_failure() = failure_of(Error(code, std::move(text)));
  return reply;
}

Waits::Waits(Clock& clock, Executor& executor)
    : clock_(clock),
      virtual_(dynamic_cast<VirtualClock*>(&clock)),
      // Not an instance: named so that no instance can be (a slash), and first in the order of an instant.
      strand_(std::make_shared<Strand>("/host", executor, clock)) {}

Waits::~Waits() { stop(); }

Waits::WaitPtr Waits::add(std::uint64_t owner, std::uint64_t id, Answer answer) {
  auto wait = std::make_shared<Wait>();
  wait->owner = owner;
  wait->id = id;
  wait->answer = std::move(answer);
  wait->since = clock_.now();
  return wait;
}

double Waits::elapsed_ms(const Wait& wait) const { return 1e3 * to_seconds(clock_.now() - wait.since); }

void Waits::time_out_after(const WaitPtr& wait, double within_ms, std::function<control::Reply()> reply) {
  auto expire = [this, weak = std::weak_ptr(wait), reply = std::move(reply)] {
    if (const auto expired = weak.lock()) finish(expired, reply());
  };
  const TimePoint at = saturating_sum(wait->since, from_milliseconds(within_ms));
  const TimerId timer =
      virtual_ ? virtual_->stop_at(at, std::move(expire)) : clock_.schedule(at, strand_, std::move(expire));
  {
    const std::lock_guard lock(mutex_);
    wait->timer = timer;
    if (!wait->ended) return;
  }
  cancel(timer);
}

void Waits::cancel(TimerId timer) { virtual_ ? virtual_->cancel_stop(timer) : clock_.cancel(timer); }

void Waits::wait_mode(std::uint64_t owner, std::uint64_t id, const control::WaitMode& request, Answer answer) {
  auto wait = add(owner, id, std::move(answer));
  wait->mode = request;
  {
    const std::lock_guard lock(mutex_);
    waits_.push_back(wait);
  }
  time_out_after(wait, request.within_ms(), [request] {
    return failure_reply(ErrorCode::Unreachable,
                         {.what = fmt::format("'{}' did not reach mode {} within {} ms", request.instance(),
                                              request.mode(), request.within_ms()),
                          .where = request.instance(),
                          .next = "show " + request.instance()});
  });
  let_run(wait);
}

/// Until it is met. It may have been met already: then nothing is left to run for.
void Waits::let_run(const WaitPtr& wait) {
  {
    const std::lock_guard lock(mutex_);
    if (wait->ended) return;
    wait->running = true;
  }
  if (virtual_) virtual_->release();
}

void Waits::expect(std::uint64_t owner, std::uint64_t id, const control::Expect& request, std::uint64_t tap,
                   const std::function<void()>& begin, Answer answer) {
  auto wait = add(owner, id, std::move(answer));
  wait->expect = request;
  wait->tap = tap;
  {
    const std::lock_guard lock(mutex_);
    waits_.push_back(wait);
  }
  try {
    begin();
  } catch (...) {
    if (!finish(wait, std::nullopt)) return;  // it has been answered meanwhile, and nobody is answered twice
    throw;
  }
  const double within_ms = request.within_ms() > 0 ? request.within_ms() : 1e3 * to_seconds(kDefaultDeadline);
  time_out_after(wait, within_ms, [this, request, within_ms, weak = std::weak_ptr(wait)] {
    std::string seen;
    if (const auto expired = weak.lock()) {
      const std::lock_guard lock(mutex_);  // another thread may just be looking at a value
      seen = expired->seen;
    }
    const std::string port = text_of(request.port());
    return failure_reply(ErrorCode::Failed,
                         {.what = fmt::format("{} was not as expected within {} ms",
                                              request.field().empty() ? port : port + "." + request.field(), within_ms),
                          .where = port,
                          .found = seen.empty() ? "no message at all" : "last seen: " + seen,
                          .next = "watch " + port});
  });
  let_run(wait);
}

void Waits::sleep(std::uint64_t owner, std::uint64_t id, const control::Sleep& request, Answer answer) {
  auto wait = add(owner, id, std::move(answer));
  if (tell_end(wait)) return;
  {
    const std::lock_guard lock(mutex_);
    waits_.push_back(wait);
  }
  time_out_after(wait, request.duration_ms(), [request] {
    control::Reply reply;
    reply.mutable_met()->set_after_ms(request.duration_ms());
    return reply;
  });
  let_run(wait);
}

void Waits::run(std::uint64_t owner, std::uint64_t id, Answer answer) {
  auto wait = add(owner, id, std::move(answer));
  wait->is_run = true;
  if (tell_end(wait)) return;
  {
    const std::lock_guard lock(mutex_);
    waits_.push_back(wait);
  }
  let_run(wait);
}

void Waits::work(std::uint64_t owner, std::uint64_t id, double within_ms, const std::function<void()>& begin,
                 EndOf end_of, control::Reply expired, Answer answer, std::function<void()> given_up) {
  auto wait = add(owner, id, std::move(answer));
  wait->end_of = std::move(end_of);
  wait->given_up = std::move(given_up);
  {
    const std::lock_guard lock(mutex_);
    waits_.push_back(wait);
  }
  time_out_after(wait, within_ms, [expired = std::move(expired)] { return expired; });
  try {
    begin();
  } catch (...) {
    if (!finish(wait, std::nullopt)) return;  // it has been answered meanwhile, and nobody is answered twice
    throw;
  }
  let_run(wait);  // a virtual clock finds it under way, and not idle
}

/// Whoever ends a wait first holds the clock, on the thread where it happened: before time can go on.
bool Waits::finish(const WaitPtr& wait, std::optional<control::Reply> reply) {
  bool running = false;
  TimerId timer = 0;
  {
    const std::lock_guard lock(mutex_);
    if (wait->ended) return false;
    wait->ended = true;
    running = wait->running;
    timer = wait->timer;
    waits_.remove(wait);
  }
  if (virtual_ && running) virtual_->hold();
  cancel(timer);
  if (!reply) return true;
  reply->set_id(wait->id);
  wait->answer(std::move(*reply));
  return true;
}

std::optional<control::Reply> Waits::reply_to_mode(const Wait& wait, const wire::ModeChanged& changed) const {
  if (!wait.mode || wait.mode->instance() != changed.instance()) return std::nullopt;
  if (changed.mode() == wait.mode->mode()) {
    control::Reply reply;
    reply.mutable_met()->set_after_ms(elapsed_ms(wait));
    reply.mutable_met()->set_seen(changed.mode());
    return reply;
  }
  if (changed.mode() != kModeFailed) return std::nullopt;
  return failure_reply(ErrorCode::ComponentFailed,
                       {.what = "'" + changed.instance() + "' failed while it was waited for",
                        .where = changed.instance(),
                        .found = changed.reason(),
                        .next = "show " + changed.instance()});
}

std::optional<control::Reply> Waits::reply_to_value(Wait& wait, const wire::Tapped& tapped, const Types& types) const {
  if (!wait.expect || wait.tap != tapped.tap()) return std::nullopt;
  const auto object = types.make(tapped.type());
  if (!object || !object->ParseFromString(tapped.object())) return std::nullopt;
  control::Reply reply;
  try {
    auto [met, text] =
        compare_field(*object, wait.expect->field(), wait.expect->comparison(), wait.expect->value(), tapped.unit());
    wait.seen = text;
    if (!met) return std::nullopt;
    reply.mutable_met()->set_after_ms(elapsed_ms(wait));
    reply.mutable_met()->set_seen(text);
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  return reply;
}

void Waits::on_event(const wire::GroupMessage& event, const Types& types) {
  std::vector<std::pair<WaitPtr, control::Reply>> ended;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& wait : waits_) {
      std::optional<control::Reply> reply;
      if (event.has_mode_changed()) reply = reply_to_mode(*wait, event.mode_changed());
      if (event.has_tapped()) reply = reply_to_value(*wait, event.tapped(), types);
      if (wait->end_of) reply = wait->end_of(event);
      if (event.has_tap_ended() && wait->expect && wait->tap == event.tap_ended().tap()) {
        *reply.emplace().mutable_failure() = event.tap_ended().failure();
      }
      if (reply) ended.emplace_back(wait, std::move(*reply));
    }
  }
  for (auto& [wait, reply] : ended) finish(wait, std::move(reply));
}

std::vector<Waits::WaitPtr> Waits::of(std::uint64_t owner, std::optional<std::uint64_t> id) {
  std::vector<WaitPtr> found;
  const std::lock_guard lock(mutex_);
  for (const auto& wait : waits_) {
    if (wait->owner == owner && (!id || wait->id == *id)) found.push_back(wait);
  }
  return found;
}

void Waits::meet(std::uint64_t owner) {
  const std::lock_guard lock(mutex_);
  if (end_) told_.insert(owner);
}

/// Where the run has ended and this owner did not wait for that.
bool Waits::tell_end(const WaitPtr& wait) {
  std::optional<control::Reply> end;
  {
    const std::lock_guard lock(mutex_);
    if (end_ && told_.insert(wait->owner).second) end = end_;
  }
  if (end) finish(wait, std::move(end));
  return wait->ended;
}

bool Waits::drop(std::uint64_t owner, std::optional<std::uint64_t> id) {
  if (!id) {
    const std::lock_guard lock(mutex_);
    told_.erase(owner);
  }
  const std::vector<WaitPtr> dropped = of(owner, id);
  for (const auto& wait : dropped) {
    if (finish(wait, std::nullopt) && wait->given_up) wait->given_up();
  }
  return !dropped.empty();
}

void Waits::end(std::uint64_t owner, std::uint64_t id, const control::Reply& reply) {
  for (const auto& wait : of(owner, id)) finish(wait, reply);
}

Waits::Runs Waits::leave(const Error& error) {
  Runs runs;
  std::vector<WaitPtr> left;
  {
    const std::lock_guard lock(mutex_);
    runs.end = end_;
    runs.told = told_;
    std::copy_if(waits_.begin(), waits_.end(), std::back_inserter(left), [](const auto& wait) { return wait->is_run; });
  }
  for (const auto& wait : left) {
    runs.open.push_back({wait->owner, wait->id, wait->answer});
    finish(wait, std::nullopt);
  }
  fail_all(error);
  return runs;
}

void Waits::take(Runs runs) {
  {
    const std::lock_guard lock(mutex_);
    end_ = std::move(runs.end);
    told_ = std::move(runs.told);
  }
  for (auto& one : runs.open) run(one.owner, one.id, std::move(one.answer));
}

void Waits::fail_all(const Error& error) {
  control::Reply reply;
  *reply.mutable_failure() = failure_of(error);
  end_all(reply);
}

void Waits::end_run(int exit_code, const std::string& reason) {
  constexpr int kMost = 255;
  control::Reply reply;
  reply.mutable_ended()->set_exit_code(exit_code >= 0 && exit_code <= kMost ? exit_code : kMost);
  reply.mutable_ended()->set_reason(reason);
  {
    const std::lock_guard lock(mutex_);
    end_ = reply;
    told_.clear();
    for (const auto& wait : waits_) {
      if (wait->is_run) told_.insert(wait->owner);
    }
  }
  end_all(reply);
}

void Waits::end_all(const control::Reply& reply) {
  std::vector<WaitPtr> all;
  {
    const std::lock_guard lock(mutex_);
    all.assign(waits_.begin(), waits_.end());
  }
  for (const auto& wait : all) finish(wait, reply);
}

}  // namespace fiona::host
