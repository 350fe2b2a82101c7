#pragma once

#include <atomic>
#include <deque>
#include <memory>
#include <mutex>
#include <string_view>
#include <type_traits>
#include <vector>

#include "fiona/port.hpp"
#include "fiona/provides.hpp"
#include "fiona/rules.hpp"

namespace fiona {
namespace detail {

/// The provider's side of both push patterns, without the object's type.
class PushProvider : public ProvidedPort {
 public:
  PushProvider(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
               Duration cycle = Duration::zero())
      : ProvidedPort(owner, name, service, options),
        rules_(service.object()),
        cycle_(cycle),
        lease_(lease_for(service, cycle)) {}
  ~PushProvider() override { end_watch(); }
  /// Calls that may wait for room at once.
  static constexpr std::size_t kMaxWaiting = 1024;
  static constexpr Duration kTellAgain = std::chrono::seconds(10);

  /// [any thread] Adds a subscriber; a service with `last_value` gives it the newest value at once. Returns the
  /// sequence number after which it receives.
  std::uint64_t attach(std::shared_ptr<Sink> sink);
  /// [any thread] The same for a subscriber that shares `carrier` with others: `newcomer` is told where it begins, and
  /// given the newest value; what is put from now on goes to the carrier, once for all.
  std::uint64_t attach(std::shared_ptr<Sink> carrier, Sink& newcomer);
  /// [any thread]
  void detach(const Sink& sink);
  /// [any thread] Lets go of a carrier that has no subscriber left.
  void detach_unused(const Sink& carrier);
  /// [any thread] How many subscribers there are now.
  std::size_t subscribers() const;
  void close() override;
  /// [any thread] Silence longer than this is loss; zero: it may be silent for ever.
  Duration lease() const { return lease_; }
  /// [any thread] Its lease has run out, or it has stopped: its clients are told so.
  bool is_silent() const;

 protected:
  void on_active() override;
  void on_inactive() override;
  /// [strand] What was put last is valid still: its lease begins anew.
  void confirm();
  /// [strand] Of a push timed: it produces from now on, or no longer. Its subscribers are told.
  void set_started(bool started);
  bool is_started() const { return started_; }
  /// [strand] Ok, or Rejected when a field breaks its declared rule (counted; told to the log where it is another rule,
  /// or another value, than was told last, but not more often than each kTellAgain).
  Outcome put_object(std::shared_ptr<const Object> object, TimePoint origin);
  /// [strand] The same, once each subscriber that receives each message has room for it.
  Async<Outcome> put_with_room(std::shared_ptr<const Object> object, TimePoint origin, Duration within);

 private:
  bool refuses(const Object& object);
  Outcome put_checked(std::shared_ptr<const Object> object, TimePoint origin);
  bool has_room(std::size_t bytes);
  void room_may_have_changed();
  void put_waiting();
  struct PutCall : Call {
    std::shared_ptr<const Object> object;
    TimePoint origin{};
    std::size_t bytes = 0;
  };

  using Sinks = std::vector<std::shared_ptr<Sink>>;
  mutable std::mutex mutex_;
  std::shared_ptr<const Sinks> sinks_ = std::make_shared<Sinks>();
  std::uint64_t sequence_ = 0;
  std::optional<Envelope> last_;
  std::optional<std::string> silence_;  ///< why its clients are told that it is silent; guarded by the mutex
  const ObjectRules rules_;
  std::optional<PortCounters::Refusal> told_;  ///< to the log; strand only

  /// What the timer of the lease finds: it does not run on the provider's strand, and may come when the port has gone.
  struct Watch {
    explicit Watch(PushProvider& of) : port(&of) {}
    std::mutex mutex;
    PushProvider* port;
  };
  static Duration lease_for(const ServiceInfo& service, Duration cycle);
  void end_watch();
  void check_lease();
  // guarded by the mutex, as are the functions
  void watch_lease();
  void tell_lease(std::optional<std::string> silence);
  bool renew();
  std::atomic<bool> paced_{false};                ///< somebody has waited for room
  std::deque<std::shared_ptr<PutCall>> waiting_;  ///< strand only
  TimePoint renewed_{};
  TimerId lease_timer_ = 0;

  const Duration cycle_;  ///< of a push timed; zero: none
  const Duration lease_;
  const std::shared_ptr<Watch> watch_ = std::make_shared<Watch>(*this);
  bool started_ = true;  ///< strand only
};

/// The client's side of both push patterns, without the object's type.
class PushClient : public RequiredPort {
 public:
  PushClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
             Inbox::Handler handler);
  Inbox* inbox() override { return &inbox_; }

 protected:
  std::optional<Inbox::Newest> newest() { return inbox_.newest(); }
  bool has_handler() const { return inbox_.has_handler(); }
  void on_entering(Connection connection) override;
  void on_connection(Connection connection, std::uint64_t change) override;
  void on_active() override;

  struct NextCall : Call {
    std::optional<Envelope> envelope;
  };
  /// [strand] The next message that comes, or what comes instead.
  Async<Result<Envelope>> next(Duration within);

 private:
  Inbox inbox_;
};

/// What a push handler may look like: `void f(const T&)`, `Async<> f(const T&)` or `void f(const Received<T>&)`; each
/// may be const.
template <class T, class C, class H>
Inbox::Handler push_handler(C& owner, H handler) {
  return [&owner, handler](const Parcel& parcel) -> std::optional<Async<>> {
    if constexpr (std::is_invocable_v<H, C&, const T&>) {
      const auto& object = static_cast<const T&>(*parcel.envelope.object);
      using R = std::invoke_result_t<H, C&, const T&>;
      static_assert(std::is_void_v<R> || std::is_same_v<R, Async<>>, "a handler returns void or fiona::Async<>");
      if constexpr (!std::is_void_v<R>) return (owner.*handler)(object);
      if constexpr (std::is_void_v<R>) (owner.*handler)(object);
    } else {
      static_assert(std::is_void_v<std::invoke_result_t<H, C&, const Received<T>&>>,
                    "a coroutine takes the object itself: a Received would not outlive the call");
      (owner.*handler)(received<T>(parcel.envelope));
    }
    return std::nullopt;
  };
}

}  // namespace detail

/// Provides a push service: `Provides<StepProvider> steps_{*this, "steps"};`, then `steps_.put(step)`.
///
/// For *push timed* a producing function may be named; the hull then calls it on the strand once per period of the
/// service (or of the given one) while the instance is in a main mode:
/// `Provides<LocationProvider> location_{*this, "location", &Self::produce_location};`
template <PushService S>
class Provides<S> : public detail::PushProvider {
 public:
  using ObjectType = typename S::ObjectType;

  template <class C>
  Provides(C& owner, std::string_view name, PortOptions options = {})
      : PushProvider(owner, name, S::info(), options,
                     S::kPattern == PUSH_TIMED ? S::info().period() : Duration::zero()) {}

  template <class C>
  requires(S::kPattern == PUSH_TIMED) Provides(C& owner, std::string_view name, void (C::*produce)(),
                                               Duration period = S::info().period(), PortOptions options = {})
      : PushProvider(owner, name, S::info(), options, period),
        producer_(std::make_unique<Task>(owner, name, period, Task::Work([this, &owner, produce] {
                                           if (is_started()) (owner.*produce)();
                                           return std::nullopt;
                                         }))) {}

  /// [strand] A cleared message from the port's pool, to be filled and put.
  std::shared_ptr<ObjectType> make() { return pool_.acquire(); }

  /// [strand] Gives the message to every subscriber, in order, without copying it; it is immutable from here on.
  /// `origin`: when what it says was true, where that is not now. Ok, whoever is wired or not; Rejected when a field
  /// breaks a rule that it declares (counted as refused); NotActive between `stop` and `start`, and of an instance that
  /// has failed.
  Outcome put(std::shared_ptr<const ObjectType> object) { return put_object(std::move(object), owner_now(*this)); }
  Outcome put(std::shared_ptr<const ObjectType> object, TimePoint origin) {
    return put_object(std::move(object), origin);
  }
  /// [strand] Waits until the message fits in front of the handler of each subscriber that receives each one, then puts
  /// it: `co_await steps_.put(step, 500ms)`. So nothing is lost to a slow consumer, and the producer goes at its pace.
  /// Not put: with Timeout there was no room in time; NotActive, Cancelled and Rejected as of every call. Waiting calls
  /// have their turn in their order; `put` without a deadline does not wait for them.
  Async<Outcome> put(std::shared_ptr<const ObjectType> object, Duration within) {
    return put_with_room(std::move(object), owner_now(*this), within);
  }
  Async<Outcome> put(std::shared_ptr<const ObjectType> object, TimePoint origin, Duration within) {
    return put_with_room(std::move(object), origin, within);
  }
  Async<Outcome> put(ObjectType object, Duration within) {
    return put(std::make_shared<const ObjectType>(std::move(object)), within);
  }
  /// [strand] Nothing has changed, and the source of what was put last has been looked at: its lease begins anew. For a
  /// service that speaks only on change; call it in the task that reads the sensor, and nowhere else. Of a provider
  /// that had been silent for longer than its lease the last value of a service that has one goes to each subscriber
  /// again.
  void still_valid() { confirm(); }
  /// [strand] Of a push timed: stops its cycle, and tells its subscribers, whose ports are *lost* until `start`. Until
  /// then puts are NotActive. A provider begins started.
  void stop() requires(S::kPattern == PUSH_TIMED) { set_started(false); }
  void start() requires(S::kPattern == PUSH_TIMED) { set_started(true); }
  /// [strand] As above, of an object that was not made as a shared one.
  Outcome put(ObjectType object) { return put(std::make_shared<const ObjectType>(std::move(object))); }
  Outcome put(ObjectType object, TimePoint origin) {
    return put(std::make_shared<const ObjectType>(std::move(object)), origin);
  }
  Async<Outcome> put(ObjectType object, TimePoint origin, Duration within) {
    return put(std::make_shared<const ObjectType>(std::move(object)), origin, within);
  }

 private:
  MessagePool<ObjectType> pool_;
  std::unique_ptr<Task> producer_;
};

/// Requires a push service. With a handler each message reaches it on the strand, in order (`Delivery::Newest`: the
/// newest only); without one, `latest` reads the newest value whenever it is wanted.
template <PushService S>
class Requires<S> : public detail::PushClient {
 public:
  using ObjectType = typename S::ObjectType;

  template <class C>
  Requires(C& owner, std::string_view name, PortOptions options = {})
      : PushClient(owner, name, S::info(), newest_only(options), nullptr) {}

  template <class C, class H>
  requires std::is_member_function_pointer_v<H> Requires(C& owner, std::string_view name, H handler,
                                                         PortOptions options = {})
      : PushClient(owner, name, S::info(), options, detail::push_handler<ObjectType>(owner, handler)) {}

  /// [strand] The newest value since it was wired, however often it is asked. Fails with NoData (also when it is older
  /// than the port's `max_age`), Unwired, Disconnected or NotActive: an old value never passes for a fresh one.
  /// Rejected where the port has a handler, which gets them.
  Result<Received<ObjectType>> latest() {
    if (has_handler()) return {Outcome::Rejected, "the port has a handler: what arrives goes there"};
    const auto slot = newest();
    if (const auto outcome = absence()) return *outcome;  // it does not wait: there is nothing to cancel
    if (!slot) return Outcome::NoData;
    auto value = detail::received<ObjectType>(slot->envelope);
    value.stale = slot->stale;
    return value;
  }

  /// [any thread] Of a push timed: the cycle of the provider, for who wants to choose a prescale. Unwired or
  /// Disconnected while there is none.
  Result<Duration> cycle() const requires(S::kPattern == PUSH_TIMED) { return provider_cycle(); }

  /// [strand] The next value that arrives: `auto next = co_await port.wait_update(1s);`
  Async<Result<Received<ObjectType>>> wait_update(Duration deadline) {
    const Result<Envelope> envelope = co_await next(deadline);
    if (!envelope) co_return Result<Received<ObjectType>>(envelope.outcome(), envelope.reason());
    co_return detail::received<ObjectType>(*envelope);
  }

 private:
  static PortOptions newest_only(PortOptions options) {
    options.delivery = Delivery::Newest;
    return options;
  }
};

}  // namespace fiona
