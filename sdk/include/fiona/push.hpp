#pragma once

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
  PushProvider(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options)
      : ProvidedPort(owner, name, service, options), rules_(service.object()), lease_(service.lease()) {}

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

 protected:
  void on_active() override;
  void on_inactive() override;
  /// [strand] The provider speaks: its lease begins anew.
  void renew();
  /// [strand] Ok, or Rejected when a field breaks its declared rule (counted; the first is told to the log).
  Outcome put_object(std::shared_ptr<const Object> object, TimePoint origin);

 private:
  using Sinks = std::vector<std::shared_ptr<Sink>>;
  mutable std::mutex mutex_;
  std::shared_ptr<const Sinks> sinks_ = std::make_shared<Sinks>();
  std::uint64_t sequence_ = 0;
  std::optional<Envelope> last_;
  std::optional<std::string> silence_;  ///< why its clients are told that it is silent; guarded by the mutex
  const ObjectRules rules_;

  void watch_lease();
  void tell_lease(std::optional<std::string> silence);
  const Duration lease_;
  TimePoint renewed_{};     ///< strand only, as is the rest
  TimerId lease_timer_ = 0;
};

/// The client's side of both push patterns, without the object's type.
class PushClient : public RequiredPort {
 public:
  PushClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
             Inbox::Handler handler);
  Inbox* inbox() override { return &inbox_; }

 protected:
  std::optional<Inbox::Newest> newest() { return inbox_.newest(); }
  void on_entering(Connection connection) override;
  void on_connection(Connection connection) override;

  struct NextCall : Call {
    std::optional<Envelope> envelope;
  };
  /// [strand] The next message that comes, or what comes instead.
  Async<Result<Envelope>> next(Duration within);

 private:
  Inbox inbox_;
};

/// What a push handler may look like: `void f(const T&)`, `void f(const Received<T>&)`, or the same as Async<>.
template <class C, class T, class R, class A>
Inbox::Handler push_handler(C& owner, R (C::*handler)(A)) {
  static_assert(std::is_void_v<R> || std::is_same_v<R, Async<>>, "a handler returns void or fiona::Async<>");
  return [&owner, handler](const Parcel& parcel) -> std::optional<Async<>> {
    const auto invoke = [&](const auto& argument) -> std::optional<Async<>> {
      if constexpr (std::is_void_v<R>) {
        (owner.*handler)(argument);
        return std::nullopt;
      } else {
        return (owner.*handler)(argument);
      }
    };
    if constexpr (std::is_same_v<std::remove_cvref_t<A>, Received<T>>) {
      static_assert(std::is_void_v<R>, "a coroutine takes the object itself: a Received would not outlive the call");
      return invoke(received<T>(parcel.envelope));
    } else {
      return invoke(static_cast<const T&>(*parcel.envelope.object));
    }
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
      : PushProvider(owner, name, S::info(), options) {}

  template <class C>
    requires(S::kPattern == PUSH_TIMED)
  Provides(C& owner, std::string_view name, void (C::*produce)(), Duration period = S::info().period(),
           PortOptions options = {})
      : PushProvider(owner, name, S::info(), options),
        producer_(std::make_unique<Task>(owner, name, period, produce)) {}

  /// [strand] A cleared message from the port's pool, to be filled and put.
  std::shared_ptr<ObjectType> make() { return pool_.acquire(); }

  /// [strand] Gives the message to every subscriber, in order, without copying it; it is immutable from here on.
  /// `origin`: when what it says was true, where that is not now.
  Outcome put(std::shared_ptr<const ObjectType> object) { return put_object(std::move(object), owner_now(*this)); }
  Outcome put(std::shared_ptr<const ObjectType> object, TimePoint origin) {
    return put_object(std::move(object), origin);
  }
  /// [strand] Nothing has changed, and the source of what was put last has been looked at: its lease begins anew. For a
  /// service that speaks only on change; call it in the task that reads the sensor, and nowhere else.
  void still_valid() { renew(); }
  Outcome put(ObjectType object) { return put(std::make_shared<const ObjectType>(std::move(object))); }
  Outcome put(ObjectType object, TimePoint origin) {
    return put(std::make_shared<const ObjectType>(std::move(object)), origin);
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

  template <class C, class R, class A>
  Requires(C& owner, std::string_view name, R (C::*handler)(A), PortOptions options = {})
      : PushClient(owner, name, S::info(), options, detail::push_handler<C, ObjectType>(owner, handler)) {}

  /// [strand] The newest value since it was wired, however often it is asked. Fails with NoData, Unwired, Disconnected
  /// or NotActive: an old value never passes for a fresh one. Only for a port without handler.
  Result<Received<ObjectType>> latest() {
    const auto slot = newest();
    const auto outcome = obstacle();
    if (outcome && *outcome != Outcome::Cancelled) return *outcome;  // it does not wait: there is nothing to cancel
    if (!slot) return Outcome::NoData;
    auto value = detail::received<ObjectType>(slot->envelope);
    value.stale = slot->stale;
    return value;
  }

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
