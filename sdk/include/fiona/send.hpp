#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

#include "fiona/port.hpp"
#include "fiona/provides.hpp"
#include "fiona/push.hpp"
#include "fiona/rules.hpp"

namespace fiona {

/// What an acknowledged send results in, if it does not fail.
struct Acknowledged {};

namespace detail {

class SendClient : public RequiredPort {
 public:
  SendClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options)
      : RequiredPort(owner, name, service, options), rules_(service.object()) {}

 protected:
  void use_target(std::shared_ptr<Sink> target) override { target_.set(std::move(target)); }
  Outcome send_object(std::shared_ptr<const Object> object);
  Async<Result<Acknowledged>> send_and_wait(std::shared_ptr<const Object> object, Duration within);
  void on_connection(Connection connection, std::uint64_t change) override;

 private:
  class Receipt;
  std::optional<std::string> refusal_of(const Object& object);
  Outcome put_to_target(std::shared_ptr<const Object> object, std::shared_ptr<ReplySink> receipt);

  Target target_;
  std::uint64_t sequence_ = 0;
  const ObjectRules rules_;
};

class SendProvider : public ProvidedPort {
 public:
  SendProvider(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
               Inbox::Handler handler)
      : ProvidedPort(owner, name, service, options), inbox_(*this, Delivery::Each, std::move(handler)) {}
  Inbox* inbox() override { return &inbox_; }

 private:
  Inbox inbox_;
};

}  // namespace detail

/// Receives what clients send: `Provides<DestinationProvider> destination_{*this, "destination",
/// &Self::on_destination};` The receiver is the provider (docs/patterns.md, Send). Handlers as for a push client.
template <SendService S>
class Provides<S> : public detail::SendProvider {
 public:
  using ObjectType = typename S::ObjectType;

  template <class C, class H>
  requires std::is_member_function_pointer_v<H> Provides(C& owner, std::string_view name, H handler,
                                                         PortOptions options = {})
      : SendProvider(owner, name, S::info(), options, detail::push_handler<ObjectType>(owner, handler)) {}
};

/// Sends, one way. A full queue is an outcome, not a wait.
template <SendService S>
class Requires<S> : public detail::SendClient {
 public:
  using ObjectType = typename S::ObjectType;

  template <class C>
  Requires(C& owner, std::string_view name, PortOptions options = {}) : SendClient(owner, name, S::info(), options) {}

  /// [strand] Ok: the wire's bounded queue has it, and the provider gets it unless it dies or the wire ends first: what
  /// a provider in another process has no room for waits there, and makes this queue full. Counted is what is lost so.
  Outcome send(ObjectType object) { return send_object(std::make_shared<const ObjectType>(std::move(object))); }
  /// [strand] Ends when the provider's hull has it, or with the reason why it has not (Rejected: its queue is full).
  /// What still waits for room there when the call ends goes no further; but after Timeout and Disconnected the
  /// provider may have taken it before it heard of that.
  Async<Result<Acknowledged>> send_acknowledged(ObjectType object, Duration deadline = kDefaultDeadline) {
    return send_and_wait(std::make_shared<const ObjectType>(std::move(object)), deadline);
  }
};

}  // namespace fiona
