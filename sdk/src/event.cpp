#include "fiona/event.hpp"

#include <cxxabi.h>

#include <utility>
#include <vector>

#include "fiona/hull.hpp"

namespace fiona::detail {

// ---- provider -------------------------------------------------------------------------------------------------

EventProvider::EventProvider(Component& owner, std::string_view name, const ServiceInfo& service,
                             const PortOptions& options, Test test)
    : ProvidedPort(owner, name, service, options),
      test_(std::move(test)),
      event_rules_(*service.answer()),
      inbox_(*this, Delivery::Each, [this](const Parcel& parcel) -> std::optional<Async<>> {
        add(parcel);
        return std::nullopt;
      }) {}

void EventProvider::close() {
  ProvidedPort::close();
  for (auto& [order, activation] : std::exchange(activations_, {})) {
    activation.client->answer(Outcome::Disconnected, "the provider has ended", nullptr);
  }
}

std::size_t EventProvider::activations() {
  drop_abandoned();
  return activations_.size();
}

void EventProvider::drop_abandoned() {
  std::erase_if(activations_, [](const auto& entry) { return entry.second.client->abandoned(); });
}

void EventProvider::add(const Parcel& parcel) {
  drop_abandoned();
  if (activations_.size() >= kMaxActivations) {
    return parcel.reply->answer(Outcome::Rejected, "the port has all the activations that it can hold", nullptr);
  }
  Activation activation{std::unique_ptr<Object>(parcel.envelope.object->New()), parcel.reply, parcel.continuous, 0};
  activation.parameters->CopyFrom(*parcel.envelope.object);
  activations_.emplace(next_++, std::move(activation));
  parcel.reply->event({});
}

void EventProvider::put_state(const Object& state) {
  if (hull().has_failed()) return;
  drop_abandoned();
  const TimePoint now = hull().clock().now();
  counters().count(now);
  for (auto it = activations_.begin(); it != activations_.end();) {
    Activation& activation = it->second;
    bool goes_on = true;
    std::string failure;
    try {
      auto event = test_(*activation.parameters, state);
      if (event) goes_on = fire(activation, std::move(event), now);
    } catch (const std::exception& error) {
      failure = error.what();
    } catch (const abi::__forced_unwind&) {  // which nobody may stop
      throw;
    } catch (...) {
      failure = reason_of_exception();
    }
    if (!failure.empty()) {
      const std::string reason = "the test of the activation failed: " + failure;
      hull().events().logged(hull().name(), LogLevel::Warning, full_name() + ": " + reason);
      activation.client->answer(Outcome::Rejected, reason, nullptr);
      goes_on = false;
    }
    it = goes_on ? std::next(it) : activations_.erase(it);
  }
}

/// False when the activation is over. One event that found no room was not the one that it is for; the client's port
/// counts that, here or once another one has come.
bool EventProvider::fire(Activation& activation, std::shared_ptr<const Object> event, TimePoint origin) {
  if (const auto violation = event_rules_.first_violation(*event)) {
    throw Error(ErrorCode::Failed, {.what = "its event was refused: " + *violation,
                                    .next = "fire what the rules of its message allow: they are in its .proto"});
  }
  const std::size_t bytes = event->ByteSizeLong();
  const Outcome outcome = activation.client->event(Envelope{std::move(event), ++activation.fired, origin, bytes});
  const bool fires_again = !activation.continuous && outcome == Outcome::Rejected;
  if (outcome != Outcome::Ok && !fires_again) counters().dropped.fetch_add(1, std::memory_order_relaxed);
  return activation.continuous || fires_again;
}

// ---- client ---------------------------------------------------------------------------------------------------

/// What the provider answers on, for one activation at one provider. Events go through the client's inbox, which is
/// bounded; acknowledgement and end, of which there is one each, through its strand.
class EventClient::Channel final : public ReplySink, public std::enable_shared_from_this<Channel> {
 public:
  Channel(EventClient& client, ActivationId id, bool continuous)
      : client_(client),
        id_(id),
        continuous_(continuous),
        strand_(client.hull().shared_strand()),
        wire_(client.full_name() + "/event") {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object>) override {
    if (ended_.exchange(true) || abandoned()) return;
    staged(nullptr, to_string(outcome), [self = shared_from_this(), outcome, reason = std::move(reason)] {
      self->strand_->post([self, outcome, reason] { self->client_.on_end(self->id_, *self, outcome, reason); });
    });
  }

  Outcome event(Envelope event) override {
    if (ended_ || abandoned()) return Outcome::Disconnected;
    if (!event.object && event.sequence == 0) {
      staged(nullptr, kTaken, [self = shared_from_this()] {
        self->strand_->post([self] { self->client_.on_acknowledged(self->id_, *self); });
      });
      return Outcome::Ok;
    }
    Parcel parcel{std::move(event), nullptr, false, static_cast<std::uint64_t>(id_)};
    if (!strand_->clock().staging()) return deliver(std::move(parcel));
    const Object* object = parcel.envelope.object.get();
    staged(object, object ? std::string_view() : to_string(Outcome::Rejected),
           [self = shared_from_this(), parcel = std::move(parcel)]() mutable { self->deliver(std::move(parcel)); });
    return Outcome::Ok;
  }

  /// [strand of the client, before it goes] Nothing reaches it any more.
  void detach() {
    const std::lock_guard lock(mutex_);
    detached_ = true;
  }

 private:
  /// What of the sequence does not come this far is counted here, each once: lost on the way, or without room.
  Outcome deliver(Parcel parcel) {
    const std::lock_guard lock(mutex_);
    if (detached_) return Outcome::Disconnected;
    const std::uint64_t sequence = parcel.envelope.sequence;
    std::uint64_t lost = sequence > last_sequence_ ? sequence - last_sequence_ - 1 : 0;
    last_sequence_ = sequence;
    const bool refused = !parcel.envelope.object;  // on the way, and counted there
    const Outcome outcome = refused ? Outcome::Ok : client_.inbox_.push(std::move(parcel));
    const bool full = outcome == Outcome::Rejected;
    if (full) ++lost;
    if ((full || refused) && !continuous_) make_again();
    if (lost > 0) client_.counters().dropped.fetch_add(lost, std::memory_order_relaxed);
    return full && continuous_ ? Outcome::Ok : outcome;  // it has left the provider
  }
  /// A provider in another process, or in virtual time, takes its only event for there: it is asked for another.
  void make_again() {
    strand_->post([self = shared_from_this()] {
      EventClient& client = self->client_;
      const auto found = client.activations_.find(self->id_);
      const bool waits = found != client.activations_.end() && found->second.channel == self && !found->second.fired;
      if (waits && client.connection() == Connection::Connected) client.make_again(self->id_);
    });
  }
  void staged(const Object* object, std::string_view word, Job job) {
    Clock& clock = strand_->clock();
    if (!clock.staging()) return job();
    // In this order at the client: those of an activation as they came, activations by their age.
    clock.stage({wire_, static_cast<std::uint64_t>(id_) << 32 | ++staged_, object, word, std::move(job)});
  }

  EventClient& client_;
  const ActivationId id_;
  const bool continuous_;
  const std::shared_ptr<Strand> strand_;
  const std::string wire_;
  std::atomic<bool> ended_{false};
  std::atomic<std::uint32_t> staged_{0};
  std::mutex mutex_;
  bool detached_ = false;
  std::uint64_t last_sequence_ = 0;
};

EventClient::EventClient(Component& owner, std::string_view name, const ServiceInfo& service,
                         const PortOptions& options, Handler handler)
    : RequiredPort(owner, name, service, options),
      handler_(std::move(handler)),
      parameter_rules_(service.object()),
      event_rules_(*service.answer()),
      inbox_(*this, Delivery::Each, [this](const Parcel& parcel) { return on_event(parcel); }) {
  if (options.delivery != Delivery::Each) {
    throw Error(ErrorCode::Usage, {.what = "port '" + std::string(name) + "' asks for the newest event only",
                                   .where = service.name(),
                                   .expected = "each: no event stands for the one before it",
                                   .next = "leave its delivery out"});
  }
  inbox_.on_not_active([this](const Parcel& parcel) { on_missed(parcel); });
}

EventClient::~EventClient() {
  for (auto& [id, activation] : activations_) {
    if (!activation.channel) continue;
    activation.channel->detach();
    activation.channel->abandon();
  }
}

/// Makes the activation at the provider of this moment and gives it up at the one before.
Outcome EventClient::put_to_target(ActivationId id, Activation& activation) {
  activation.since = changes();
  const auto before = std::exchange(activation.channel, std::make_shared<Channel>(*this, id, activation.continuous));
  Envelope envelope{activation.parameters, static_cast<std::uint64_t>(id), hull().clock().now(),
                    activation.parameters->ByteSizeLong()};
  const Outcome outcome = target_.deliver(Parcel{std::move(envelope), activation.channel, activation.continuous, 0})
                              .value_or(Outcome::Disconnected);
  if (before) {
    before->detach();
    before->abandon();
  }
  return outcome;
}

Async<Result<ActivationId>> EventClient::activate_object(std::shared_ptr<const Object> parameters, bool continuous,
                                                         Duration within) {
  const auto call = std::make_shared<Call>();
  call->since = changes();
  const ActivationId id{next_id_++};
  if (activations_.size() >= EventProvider::kMaxActivations) forget_refused();
  if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal, reason_for(*refusal));
  } else if (activations_.size() >= EventProvider::kMaxActivations) {
    calls().finish(call, Outcome::Rejected, "the port has all the activations that it can hold");
  } else if (const auto violation = parameter_rules_.first_violation(*parameters)) {
    counters().refuse(*violation, hull().clock().now());
    calls().finish(call, Outcome::Rejected, "the activation was refused: " + *violation);
  } else {
    // Entered first: on another thread the acknowledgement may be on its way before `deliver` returns.
    Activation& made = activations_[id];
    made.parameters = std::move(parameters);
    made.continuous = continuous;
    made.acknowledgement = call;
    const Outcome outcome = put_to_target(id, made);
    if (outcome != Outcome::Ok) calls().finish(call, outcome, reason_for(outcome));
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  if (outcome == Outcome::Ok) co_return id;
  give_up(id);
  co_return Result<ActivationId>(outcome, call->reason);
}

Async<Result<Envelope>> EventClient::next_event(ActivationId id, Duration within) {
  const auto call = std::make_shared<EventCall>();
  call->since = changes();
  const auto found = activations_.find(id);
  if (found == activations_.end() || handler_) {
    calls().finish(call, Outcome::WrongId, handler_ ? "the port has a handler: events go there" : "");
  } else if (calls_are_cancelled() || !is_active()) {
    calls().finish(call, *obstacle());
  } else if (!found->second.events.empty()) {
    Activation& activation = found->second;
    call->event = take_oldest(activation);
    if (activation.fired) activations_.erase(found);
    calls().finish(call, Outcome::Ok);
  } else if (const auto refused = found->second.refused; refused && (refused->is_due || inbox_.depth() == 0)) {
    const auto earlier = std::exchange(found->second.wait, nullptr);
    activations_.erase(found);
    if (earlier) calls().finish(earlier, Outcome::Cancelled);
    calls().finish(call, refused->outcome, refused->reason);
  } else if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal, reason_for(*refusal));
  } else {
    if (const auto earlier = std::exchange(found->second.wait, call)) calls().finish(earlier, Outcome::Cancelled);
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  const auto open = activations_.find(id);
  if (open != activations_.end() && open->second.wait == call) open->second.wait = nullptr;
  if (outcome != Outcome::Ok) co_return Result<Envelope>(outcome, call->reason);
  co_return std::move(call->event);
}

bool EventClient::give_up(ActivationId id) {
  const auto found = activations_.find(id);
  if (found == activations_.end()) return false;
  const bool refused = found->second.refused.has_value();
  end(id, Outcome::WrongId, {});
  return !refused;
}

/// The provider has ended it: that stays for who waits, or will, unless events go to a handler.
void EventClient::refuse(ActivationId id, Outcome outcome, const std::string& reason) {
  Activation& activation = activations_.at(id);
  if (!activation.wait) {
    hull().events().logged(hull().name(), LogLevel::Warning,
                           full_name() + ": an activation has ended: " + std::string(to_string(outcome)) +
                               (reason.empty() ? "" : ", " + reason));
  }
  if (const auto channel = std::exchange(activation.channel, nullptr)) {
    channel->detach();
    channel->abandon();
  }
  activation.refused = Refusal{outcome, reason};
  has_refused_ = true;
  tell_refusals();
}

/// Once nothing waits in the inbox: all events that had come before have been told.
void EventClient::tell_refusals() {
  if (!has_refused_ || inbox_.depth() > 0) return;
  has_refused_ = false;
  std::vector<ActivationId> over;
  for (auto& [id, activation] : activations_) {
    if (!activation.refused) continue;
    activation.refused->is_due = true;
    if (handler_ || activation.wait) over.push_back(id);
  }
  for (const ActivationId id : over) {
    const auto found = activations_.find(id);  // what one ends may have ended another, or its wait
    if (found == activations_.end() || (!handler_ && !found->second.wait)) continue;
    const Refusal refused = *found->second.refused;
    end(id, refused.outcome, refused.reason);
  }
}

/// Room for others: nobody has waited for these.
void EventClient::forget_refused() {
  std::erase_if(activations_, [](const auto& entry) {
    const Activation& one = entry.second;
    return one.refused && one.refused->is_due && one.events.empty() && !one.wait;
  });
}

/// The activation is over: the provider is told, and whoever waits for it.
void EventClient::end(ActivationId id, Outcome outcome, const std::string& reason) {
  const auto found = activations_.find(id);
  if (found == activations_.end()) return;
  const Activation over = std::move(found->second);
  activations_.erase(found);
  for (const Envelope& event : over.events) kept_bytes_ -= Inbox::cost_of(event.bytes);
  if (over.channel) {
    over.channel->detach();
    over.channel->abandon();
  }
  if (over.acknowledgement) calls().finish(over.acknowledgement, outcome, reason);
  if (over.wait) calls().finish(over.wait, outcome, reason);
}

void EventClient::on_acknowledged(ActivationId id, const Channel& from) {
  const auto found = activations_.find(id);
  if (found == activations_.end() || found->second.channel.get() != &from) return;
  if (const auto call = std::exchange(found->second.acknowledgement, nullptr)) calls().finish(call, Outcome::Ok);
}

void EventClient::on_end(ActivationId id, const Channel& from, Outcome outcome, const std::string& reason) {
  const auto found = activations_.find(id);
  if (found == activations_.end() || found->second.channel.get() != &from) return;
  if (outcome == Outcome::NotActive && !found->second.acknowledgement) return ask_again(id, found->second.channel);
  if (found->second.acknowledgement) return end(id, outcome, reason);
  if (outcome != Outcome::Disconnected) return refuse(id, outcome, reason);
  // The provider has gone: the activation stays and is made again at the next one.
  found->second.channel->detach();
  if (const auto wait = std::exchange(found->second.wait, nullptr)) calls().finish(wait, outcome, reason);
}

void EventClient::make_again(ActivationId id) {
  const Outcome outcome = put_to_target(id, activations_.at(id));
  if (outcome == Outcome::Ok || outcome == Outcome::Disconnected) return;
  const std::string reason = "the new provider refused it";
  activations_.at(id).acknowledgement ? end(id, outcome, reason) : refuse(id, outcome, reason);
}

/// The provider that the activation was moved to does not serve the port in its mode, or this one had no mode, or no
/// room, for the only event of a single one. Nobody says when that will be: so it is asked for, once this port is
/// served.
void EventClient::ask_again(ActivationId id, const std::shared_ptr<Channel>& refused) {
  if (!refused) return;
  const auto ask = [this, id, refused] {
    const auto found = activations_.find(id);
    const bool waits = found != activations_.end() && found->second.channel == refused;
    if (!waits || connection() != Connection::Connected) return;
    const bool serves = is_active() && !(begins_work() && hull().is_leaving(activity()));
    serves ? make_again(id) : ask_again(id, refused);
  };
  hull().clock().schedule(hull().clock().now() + kAskAgain, hull().shared_strand(), ask);
}

/// What is kept is of the mode before. That of a single activation, which has no other, is asked for again.
void EventClient::leave_mode() {
  inbox_.leave_mode();
  for (auto& [id, activation] : activations_) {
    for (; !activation.events.empty(); take_oldest(activation)) {
      counters().not_active.fetch_add(1, std::memory_order_relaxed);
    }
    if (std::exchange(activation.fired, false)) ask_again(id, activation.channel);
  }
  tell_refusals();
}

std::optional<Async<>> EventClient::on_event(const Parcel& parcel) {
  auto begun = take_event(parcel);
  tell_refusals();
  return begun;
}

/// Whichever provider it is of: it had arrived before the activation moved to another.
std::optional<Async<>> EventClient::take_event(const Parcel& parcel) {
  const ActivationId id{parcel.activation};
  const auto found = activations_.find(id);
  if (found == activations_.end() || found->second.fired) return std::nullopt;
  Activation& activation = found->second;
  const Envelope& event = parcel.envelope;
  const bool over = !activation.continuous;
  if (over && activation.channel) activation.channel->abandon();
  if (handler_) {
    if (over) activations_.erase(found);
    return handler_(id, event);
  }
  if (!activation.wait) {
    activation.fired = keep(activation, event) && over;
    if (over && !activation.fired) ask_again(id, activation.channel);
    return std::nullopt;
  }
  activation.fired = over;
  const auto wait = std::exchange(activation.wait, nullptr);
  wait->event = event;
  if (over) activations_.erase(found);
  calls().finish(wait, Outcome::Ok);
  return std::nullopt;
}

/// Until somebody waits for it. When too much is kept the oldest go, counted, those of this activation before those of
/// others; that of a single one, which has no other, stays. False: there is no room, and it is dropped itself.
bool EventClient::keep(Activation& activation, const Envelope& event) {
  const std::size_t cost = Inbox::cost_of(event.bytes);
  const auto full = [&] { return kept_bytes_ > 0 && kept_bytes_ + cost > kMaxBytes; };
  while (full() && drop_oldest(activation)) {
  }
  if (full()) {
    counters().dropped.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  activation.events.push_back(event);
  kept_bytes_ += cost;
  return true;
}

bool EventClient::drop_oldest(Activation& own) {
  Activation* from = own.events.empty() ? nullptr : &own;
  if (!from) {
    for (auto& [id, one] : activations_) {
      if (!one.continuous || one.events.empty()) continue;
      if (!from || one.events.front().origin < from->events.front().origin) from = &one;
    }
  }
  if (!from) return false;
  take_oldest(*from);
  counters().dropped.fetch_add(1, std::memory_order_relaxed);
  return true;
}

Envelope EventClient::take_oldest(Activation& activation) {
  Envelope oldest = std::move(activation.events.front());
  activation.events.pop_front();
  kept_bytes_ -= Inbox::cost_of(oldest.bytes);
  return oldest;
}

/// A single activation whose only event came in no mode for it is not over.
void EventClient::on_missed(const Parcel& parcel) {
  const ActivationId id{parcel.activation};
  const auto found = activations_.find(id);
  const bool waits = found != activations_.end() && !found->second.continuous && !found->second.fired;
  if (waits) ask_again(id, found->second.channel);
  tell_refusals();
}

void EventClient::on_connection(Connection connection, std::uint64_t change) {
  if (connection == Connection::Connected) {
    std::vector<ActivationId> ids;
    for (const auto& [id, activation] : activations_) {
      if (!activation.is_over() && activation.since < change) ids.push_back(id);
    }
    for (const ActivationId id : ids) {
      if (activations_.contains(id)) make_again(id);  // what one ends may have ended another
    }
    return;
  }
  if (connection == Connection::Waiting) return;
  for (auto& [id, activation] : activations_) {
    if (!activation.channel || activation.since >= change) continue;
    activation.channel->detach();
    activation.channel->abandon();
  }
  calls().finish_all(Outcome::Disconnected, connection_reason(), change);
}

}  // namespace fiona::detail
