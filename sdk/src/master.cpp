#include "fiona/master.hpp"

#include <algorithm>
#include <limits>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"

namespace fiona {

control::PortName detail::port_name(std::string_view text) {
  control::PortName name;
  name.set_instance(std::string(text.substr(0, text.find('.'))));
  if (const auto dot = text.find('.'); dot != std::string_view::npos) name.set_port(std::string(text.substr(dot + 1)));
  return name;
}

namespace {

using detail::port_name;

/// A change of mode gives up so much before its caller does, so that the reason arrives.
double reserve_ms(double deadline_ms) { return std::min(std::max(deadline_ms / 10, 500.0), deadline_ms / 2); }
/// As long as a request can say.
constexpr double kLongestMs = std::numeric_limits<std::uint32_t>::max();

control::Request transaction_of(const Changes& changes, Duration deadline, bool dry_run) {
  control::Request request;
  const double deadline_ms = 1e3 * to_seconds(deadline);
  request.set_deadline_ms(static_cast<std::uint32_t>(std::clamp(deadline_ms, 1.0, kLongestMs)));
  request.mutable_transact()->set_dry_run(dry_run);
  for (const auto& change : changes.list()) {
    auto& added = *request.mutable_transact()->add_changes() = change;
    if (added.has_state() && added.state().within_ms() <= 0)
      added.mutable_state()->set_within_ms(deadline_ms - reserve_ms(deadline_ms));
  }
  return request;
}

std::string text_of(const control::Failure& failure) {
  return Error(static_cast<ErrorCode>(failure.code()), {.what = failure.what(),
                                                        .where = failure.where(),
                                                        .expected = failure.expected(),
                                                        .found = failure.found(),
                                                        .next = failure.next(),
                                                        .near = {failure.near().begin(), failure.near().end()}})
      .what();
}

}  // namespace

Changes& Changes::wire(std::string_view client, std::string_view provider, const WireChoice& choice) {
  control::Wire& wire = *next().mutable_wire();
  *wire.mutable_client() = port_name(client);
  *wire.mutable_provider() = port_name(provider);
  for (const auto& other : choice.otherwise) *wire.add_alternatives() = port_name(other);
  if (choice.every > 0) wire.set_prescale(choice.every);
  if (choice.hold) wire.set_hold_ms(1e3 * to_seconds(*choice.hold));
  return *this;
}

Changes& Changes::unwire(std::string_view client) {
  *next().mutable_unwire()->mutable_client() = port_name(client);
  return *this;
}

Changes& Changes::swap(std::string_view old, std::string_view next_one) {
  control::Replace& replace = *next().mutable_replace();
  replace.set_old(std::string(old));
  replace.set_next(std::string(next_one));
  return *this;
}

Changes& Changes::state(std::string_view instance, std::string_view mode) {
  control::State& state = *next().mutable_state();
  state.set_instance(std::string(instance));
  state.set_mode(std::string(mode));
  return *this;
}

Changes& Changes::load(std::string_view plugin, std::string_view instance, std::string_view group) {
  control::Load& load = *next().mutable_load();
  load.set_plugin(std::string(plugin));
  load.set_instance(std::string(instance));
  load.set_group(std::string(group));
  return *this;
}

Changes& Changes::unload(std::string_view instance) {
  next().mutable_unload()->set_instance(std::string(instance));
  return *this;
}

Changes& Changes::set_value(std::string_view instance, std::string_view parameter, control::Value value) {
  control::Set& set = *next().mutable_set();
  set.set_instance(std::string(instance));
  control::Argument& argument = *set.add_parameters();
  argument.set_name(std::string(parameter));
  *argument.mutable_value() = std::move(value);
  return *this;
}

Changes& Changes::add(control::Change change) {
  next() = std::move(change);
  return *this;
}

Master::Master(Component& owner) : hull_(owner.hull()), calls_(hull_.clock(), hull_.shared_strand()) {
  hull_.add(*this);
}

std::optional<Outcome> Master::obstacle() const {
  if (!hull_.is_active()) return Outcome::NotActive;
  if (hull_.all_calls_are_cancelled()) return Outcome::Cancelled;
  return open_.size() >= kMaxOpen ? std::optional(Outcome::Rejected) : std::nullopt;
}

Async<Result<control::Reply>> Master::ask(control::Request request, Duration deadline, Waits waits) {
  const auto call = std::make_shared<detail::Call>();
  const std::uint64_t number = ++last_number_;
  const bool is_bound = waits == Waits::ForTime || !hull_.clock().staging();
  if (const auto refusal = obstacle()) {
    calls_.finish(call, *refusal,
                  *refusal == Outcome::Rejected ? std::to_string(kMaxOpen) + " calls are open already" : "");
  } else if (is_bound && deadline <= Duration::zero()) {
    calls_.finish(call, Outcome::Timeout);  // what has not begun by then is not begun
  } else if (!control::Request().ParseFromString(request.SerializeAsString())) {
    calls_.finish(call, Outcome::Rejected, "what it asks for holds text that is no UTF-8");
  } else {
    open_[number].call = call;
    hull_.events().asked(hull_.name(), number, request);
  }
  detail::CallAwaiter ended(calls_, call, is_bound ? deadline : detail::Calls::kNoDeadline);
  const Outcome outcome = co_await ended;
  const auto open = open_.extract(number);
  if (outcome != Outcome::Ok) co_return Result<control::Reply>(outcome, call->reason);
  co_return std::move(open.mapped().reply);
}

void Master::take(std::uint64_t number, control::Reply reply) {
  const auto found = open_.find(number);
  if (found == open_.end()) return;  // given up
  const auto call = found->second.call;
  if (reply.has_failure()) return calls_.finish(call, Outcome::Rejected, text_of(reply.failure()));
  found->second.reply = std::move(reply);
  calls_.finish(call, Outcome::Ok);
}

Async<Result<control::Done>> Master::make(Changes changes, Duration deadline) {
  auto reply = co_await ask(transaction_of(changes, deadline, false), deadline);
  if (!reply) co_return Result<control::Done>(reply.outcome(), reply.reason());
  co_return std::move(*reply.value().mutable_done());
}

Async<Result<control::Planned>> Master::plan(Changes changes, Duration deadline) {
  auto reply = co_await ask(transaction_of(changes, deadline, true), deadline);
  if (!reply) co_return Result<control::Planned>(reply.outcome(), reply.reason());
  co_return std::move(*reply.value().mutable_planned());
}

Async<Result<control::System>> Master::system(Duration deadline) {
  control::Request request;
  request.mutable_snapshot();
  auto reply = co_await ask(std::move(request), deadline);
  if (!reply) co_return Result<control::System>(reply.outcome(), reply.reason());
  co_return std::move(*reply.value().mutable_system());
}

}  // namespace fiona
