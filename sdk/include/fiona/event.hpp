#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string_view>
#include <type_traits>
#include <unordered_map>

#include "fiona/port.hpp"
#include "fiona/provides.hpp"
#include "fiona/rules.hpp"

namespace fiona {

/// Whether an activation fires once, or each time.
enum class EventMode { Single, Continuous };

/// Names an activation of one client port.
enum class ActivationId : std::uint64_t {};

/// An event as a handler gets it: what the provider's test made, and for which activation.
template <class T>
struct Fired {
  ActivationId activation{};
  std::shared_ptr<const T> object;
  std::uint64_t sequence = 0;  ///< counts the events of this activation at this provider, from 1
  TimePoint origin{};          ///< of the state that fired it

  const T& operator*() const { return *object; }
  const T* operator->() const { return object.get(); }
};

namespace detail {

/// The provider's side: activations, and the test that each state is put to. All on the strand.
class EventProvider : public ProvidedPort {
 public:
  /// Activations that a port holds at once.
  static constexpr std::size_t kMaxActivations = 1024;
  /// The event that `state` means for this activation, if any; may change its copy of the activation.
  using Test = std::function<std::shared_ptr<const Object>(Object& activation, const Object& state)>;

  EventProvider(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
                Test test);
  Inbox* inbox() override { return &inbox_; }
  void close() override;
  /// [strand] How many there are now.
  std::size_t activations();

 protected:
  void put_state(const Object& state);

 private:
  struct Activation {
    std::unique_ptr<Object> parameters;  ///< the test's own copy
    std::shared_ptr<ReplySink> client;
    bool continuous = false;
    std::uint64_t fired = 0;
  };
  void add(const Parcel& parcel);
  void drop_abandoned();
  bool fire(Activation& activation, std::shared_ptr<const Object> event, TimePoint origin);

  const Test test_;
  const ObjectRules event_rules_;
  std::map<std::uint64_t, Activation> activations_;  ///< by age
  std::uint64_t next_ = 1;
  Inbox inbox_;
};

/// The client's side. Activations belong to the port: they move with it from provider to provider, and are made
/// again when a provider is back, or is active again, until they are given up, have fired (single), or are refused.
class EventClient : public RequiredPort {
 public:
  using Handler = std::function<std::optional<Async<>>(ActivationId, const Envelope&)>;
  /// Bytes of events that may wait for `wait`, unless a single one is larger.
  static constexpr std::size_t kMaxBytes = 4 * 1024 * 1024;
  /// A provider that is not active is asked again so often.
  static constexpr Duration kAskAgain = std::chrono::milliseconds(500);

  EventClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
              Handler handler);
  ~EventClient() override;

 protected:
  void use_target(std::shared_ptr<Sink> target) override { target_.set(std::move(target)); }
  struct EventCall : Call {
    Envelope event;
  };
  Async<Result<ActivationId>> activate_object(std::shared_ptr<const Object> parameters, bool continuous,
                                              Duration within);
  Async<Result<Envelope>> next_event(ActivationId id, Duration within);
  bool give_up(ActivationId id);
  void on_connection(Connection connection, std::uint64_t change) override;
  void on_active() override { leave_mode(); }
  void on_inactive() override { leave_mode(); }
  /// Without a handler an event is kept, or ends a wait, which a change of mode may be waiting for.
  bool begins_work() const override { return handler_ != nullptr; }

 private:
  class Channel;
  /// What the provider has ended it with: told to who waits, behind the events that had arrived.
  struct Refusal {
    Outcome outcome;
    std::string reason;
    bool is_due = false;  ///< none of those events is in the inbox any more
  };
  struct Activation {
    std::shared_ptr<const Object> parameters;
    bool continuous = false;
    std::shared_ptr<Channel> channel;  ///< to the provider of this moment; none: refused
    std::optional<Refusal> refused;
    std::shared_ptr<Call> acknowledgement;
    std::shared_ptr<EventCall> wait;
    std::deque<Envelope> events;  ///< of a port without handler: that nobody has waited for yet
    bool fired = false;           ///< a single one: over, but for who has not asked for its event yet
    std::uint64_t since = 0;      ///< `changes` when it was put to that provider
    bool is_over() const { return fired || refused; }
  };
  Outcome put_to_target(ActivationId id, Activation& activation);
  std::optional<Async<>> on_event(const Parcel& parcel);
  std::optional<Async<>> take_event(const Parcel& parcel);
  void refuse(ActivationId id, Outcome outcome, const std::string& reason);
  void tell_refusals();
  void forget_refused();
  void on_acknowledged(ActivationId id, const Channel& from);
  void on_end(ActivationId id, const Channel& from, Outcome outcome, const std::string& reason);
  void make_again(ActivationId id);
  void ask_again(ActivationId id, const std::shared_ptr<Channel>& refused);
  bool keep(Activation& activation, const Envelope& event);
  bool drop_oldest(Activation& own);
  Envelope take_oldest(Activation& activation);
  void on_missed(const Parcel& parcel);
  void leave_mode();
  void end(ActivationId id, Outcome outcome, const std::string& reason);

  const Handler handler_;
  const ObjectRules parameter_rules_;
  const ObjectRules event_rules_;
  Target target_;
  std::map<ActivationId, Activation> activations_;  ///< strand only
  bool has_refused_ = false;                        ///< one whose refusal is not due yet
  std::size_t kept_bytes_ = 0;
  std::uint64_t next_id_ = 1;
  Inbox inbox_;
};

/// `void f(const Fired<T>&)` or `Async<> f(const T&)`; each may be const.
template <class T, class C, class H>
EventClient::Handler event_handler(C& owner, H handler) {
  return [&owner, handler](ActivationId id, const Envelope& event) -> std::optional<Async<>> {
    if constexpr (std::is_invocable_r_v<Async<>, H, C&, const T&>) {
      return (owner.*handler)(static_cast<const T&>(*event.object));
    } else {
      static_assert(std::is_void_v<std::invoke_result_t<H, C&, const Fired<T>&>>,
                    "a coroutine takes the object itself: a Fired would not outlive the call");
      (owner.*handler)(Fired<T>{id, std::static_pointer_cast<const T>(event.object), event.sequence, event.origin});
      return std::nullopt;
    }
  };
}

}  // namespace detail

/// Tells clients when a condition of theirs comes true. For each state that is put, `test` says for each activation
/// whether it means an event; its copy of the activation is its own, for hysteresis or a limit of the rate:
///
///     std::optional<Alarm> test(AlarmLimits& limits, const Temperature& now);
///     Provides<TemperatureAlarm> alarm_{*this, "alarm", &Self::test};
///     alarm_.put(temperature);
///
/// A test that throws ends that activation alone; its client is told why.
template <EventService S>
class Provides<S> : public detail::EventProvider {
 public:
  using ActivationType = typename S::ActivationType;
  using ResultType = typename S::ResultType;
  using StateType = typename S::StateType;

  template <class C>
  Provides(C& owner, std::string_view name, std::optional<ResultType> (C::*test)(ActivationType&, const StateType&),
           PortOptions options = {})
      : EventProvider(owner, name, S::info(), options,
                      [&owner, test](Object& activation, const Object& state) -> std::shared_ptr<const Object> {
                        auto event = (owner.*test)(static_cast<ActivationType&>(activation),
                                                   static_cast<const StateType&>(state));
                        if (!event) return nullptr;
                        return std::make_shared<const ResultType>(std::move(*event));
                      }) {}

  /// [strand] Puts the state to the test of each activation, the oldest first; those that fire tell their clients.
  /// Nothing comes of it once the instance has failed.
  void put(const StateType& state) { put_state(state); }
};

/// Waits for a condition: `auto id = co_await alarm_.activate(EventMode::Continuous, limits);`, then each event reaches
/// the handler, or, on a port without one, `co_await alarm_.wait(*id, 10s)`.
template <EventService S>
class Requires<S> : public detail::EventClient {
 public:
  using ActivationType = typename S::ActivationType;
  using ResultType = typename S::ResultType;

  template <class C>
  Requires(C& owner, std::string_view name, PortOptions options = {})
      : EventClient(owner, name, S::info(), options, nullptr) {}
  template <class C, class H>
  requires std::is_member_function_pointer_v<H> Requires(C& owner, std::string_view name, H handler,
                                                         PortOptions options = {})
      : EventClient(owner, name, S::info(), options, detail::event_handler<ResultType>(owner, handler)) {}

  /// [strand] Ends when the provider has taken the activation; if it has not by the deadline there is none.
  Async<Result<ActivationId>> activate(EventMode mode, ActivationType parameters,
                                       Duration deadline = kDefaultDeadline) {
    return activate_object(std::make_shared<const ActivationType>(std::move(parameters)), mode == EventMode::Continuous,
                           deadline);
  }
  /// [strand] The oldest event that has not been waited for, or the next. Behind the last one of an activation that the
  /// provider has ended, once, its outcome and reason. WrongId: the activation is over.
  Async<Result<Fired<ResultType>>> wait(ActivationId id, Duration deadline = kDefaultDeadline) {
    const Result<Envelope> event = co_await next_event(id, deadline);
    if (!event) co_return Result<Fired<ResultType>>(event.outcome(), event.reason());
    co_return Fired<ResultType>{id, std::static_pointer_cast<const ResultType>(event->object), event->sequence,
                                event->origin};
  }
  /// [strand] WrongId if it is over already.
  Outcome deactivate(ActivationId id) { return give_up(id) ? Outcome::Ok : Outcome::WrongId; }
};

}  // namespace fiona
