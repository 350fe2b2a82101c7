#include "fiona/watch.hpp"

#include "fiona/hull.hpp"
#include "fiona/master.hpp"

namespace fiona {

namespace when {

control::Condition compared(control::Comparison comparison, control::Value value, std::string_view field) {
  control::Condition condition;
  condition.set_field(std::string(field));
  condition.mutable_compared()->set_comparison(comparison);
  *condition.mutable_compared()->mutable_value() = std::move(value);
  return condition;
}

control::Condition changes(std::string_view field) {
  control::Condition condition;
  condition.set_field(std::string(field));
  condition.set_changes(true);
  return condition;
}

control::Condition older_than(Duration age) {
  control::Condition condition;
  condition.set_older_than_ms(1e3 * to_seconds(age));
  return condition;
}

}  // namespace when

struct Watch::State {
  State(std::shared_ptr<Master*> m, std::uint64_t n) : master(std::move(m)), number(n) {}
  State(const State&) = delete;
  State& operator=(const State&) = delete;
  ~State() {
    if (*master) (*master)->unwatch(number);
  }
  const std::shared_ptr<Master*> master;  ///< null once its component has ended
  const std::uint64_t number;
  std::uint64_t arrived = 0;
};

Async<Result<control::Sample>> Watch::next(Duration deadline) const { return next_of(state_, deadline); }

/// Keeps what it needs, whatever becomes of the watch while it waits.
Async<Result<control::Sample>> Watch::next_of(std::shared_ptr<State> state, Duration deadline) {
  if (!state || !*state->master) co_return Result<control::Sample>(Outcome::Rejected, "the watch was let go of");
  control::Request request;
  request.mutable_next()->set_watch(state->number);
  request.mutable_next()->set_after(state->arrived);
  auto reply = co_await (*state->master)->ask(std::move(request), deadline, Master::Waits::ForTime);
  if (!reply) co_return Result<control::Sample>(reply.outcome(), reply.reason());
  state->arrived = reply->sample().number();
  co_return std::move(*reply.value().mutable_sample());
}

Async<Result<Watch>> Master::watch(std::string_view what, const WatchTerms& terms, Duration deadline) {
  control::Request request;
  control::Watch& watch = *request.mutable_watch();
  *watch.mutable_port() = detail::port_name(what);
  watch.set_prescale(terms.every);
  watch.set_min_period_ms(1e3 * to_seconds(terms.period));
  if (terms.when) *watch.mutable_condition() = *terms.when;
  return begin_watch(std::move(request), deadline);
}

Async<Result<Watch>> Master::begin_watch(control::Request request, Duration deadline) {
  // Its number names it; should nobody hear that it has begun, it is let go of.
  const auto state = std::make_shared<Watch::State>(self_, last_number_ + 1);
  const auto reply = co_await ask(std::move(request), deadline);
  if (!reply) co_return Result<Watch>(reply.outcome(), reply.reason());
  co_return Watch(state);
}

Async<Result<control::Sample>> Master::read(std::string_view probe, Duration deadline) {
  control::Request request;
  *request.mutable_read()->mutable_probe() = detail::port_name(probe);
  return read_by(std::move(request), deadline);
}

Async<Result<control::Sample>> Master::read_by(control::Request request, Duration deadline) {
  auto reply = co_await ask(std::move(request), deadline);
  if (!reply) co_return Result<control::Sample>(reply.outcome(), reply.reason());
  co_return std::move(*reply.value().mutable_sample());
}

/// Nobody waits for the answer.
void Master::unwatch(std::uint64_t watch) {
  control::Request request;
  request.mutable_unwatch()->set_watch(watch);
  hull_.events().asked(hull_.name(), ++last_number_, request);
}

}  // namespace fiona
