// The wires of one process: those within it, and its ends of those that links carry.
#include "fiona/error.hpp"
#include "fiona/push.hpp"
#include "names.hpp"
#include "runtime.hpp"

namespace fiona::host {
namespace {

/// How long a port has neither the old wire nor the new one, on the machine's clock, what it loses while one takes the
/// other's place, and which requests change over.
class SwitchCost {
 public:
  explicit SwitchCost(RequiredPort& client)
      : client_(client), dropped_(client.counters().dropped), redirected_(client.redirectable()) {}
  void old_one_has_gone() { since_ = std::chrono::steady_clock::now(); }
  void end(wire::Switched& switched) const {
    switched.set_gap_ns(std::chrono::nanoseconds(std::chrono::steady_clock::now() - since_).count());
    switched.set_lost(client_.counters().dropped - dropped_);
    switched.set_redirected(redirected_);
  }

 private:
  RequiredPort& client_;
  const std::uint64_t dropped_;
  const std::uint64_t redirected_;
  std::chrono::steady_clock::time_point since_ = std::chrono::steady_clock::now();
};

}  // namespace

/// What takes part in nothing any more is wired to nobody.
template <class Port>
Port& Runtime::living(Port& port, const control::PortName& name) {
  if (!port.hull().has_failed()) return port;
  throw Error(ErrorCode::ComponentFailed, {.what = "'" + name.instance() + "' has failed: " + port.hull().reason(),
                                           .where = text_of(name),
                                           .next = "unload " + name.instance() + ", then load it again"});
}

void Runtime::wire_local(const wire::WireLocal& request, wire::Switched& switched) {
  ProvidedPort& provider = living(provided(request.provider()), request.provider());
  RequiredPort& client = living(required(request.client()), request.client());
  auto* push = dynamic_cast<detail::PushProvider*>(&provider);
  const auto end = client.end_for(provider.full_name());
  const std::string name = client.full_name() + "<" + provider.full_name();
  auto local = push ? std::make_shared<LocalWire>(name, end, request.prescale())
                    : std::make_shared<LocalWire>(name, *provider.inbox());
  SwitchCost cost(client);
  // The new one first: a request that is being made has somewhere to go at every moment.
  if (!push) end->set_target(local);
  retire(request.replaces(), true);
  cost.old_one_has_gone();
  end->set_connection(Connection::Connected, provider.full_name());
  if (push) push->attach(local);
  wires_[request.wire()] = Wire{std::move(local), push, end, &provider.hull(), request.prescale()};
  cost.end(switched);
}

void Runtime::wire_provide(const wire::WireProvide& request) try {
  links_.provide(request.wire(), request.token(), request.peer(),
                 living(provided(request.provider()), request.provider()), request.prescale(),
                 request.attached() ? request.client().instance() : text_of(request.client()), request.attached());
} catch (const Error& error) {
  links_.deny(request.wire(), error.text().what);
  throw;
}

/// Nothing is opened or let go of: no message is lost, or comes twice.
void Runtime::set_prescale(const wire::SetPrescale& request) {
  const auto found = wires_.find(request.wire());
  if (found == wires_.end()) return links_.set_prescale(request.wire(), request.prescale());
  found->second.prescale = request.prescale();
  if (found->second.provider) found->second.local->set_prescale(request.prescale());
}

void Runtime::wire_require(const wire::WireRequire& request, wire::Switched& switched) {
  RequiredPort& client = living(required(request.client()), request.client());
  std::optional<SwitchCost> cost;
  const auto let_go = [&] {
    cost.emplace(client);
    retire(request.replaces(), true);
    cost->old_one_has_gone();
  };
  links_.require(request.wire(), request.token(), client.end_for(text_of(request.provider())),
                 {request.endpoint(), request.name(), request.key()}, request.ahead(), request.replaces(),
                 request.resumes_every(), let_go);
  cost->end(switched);
}

void Runtime::wire_relay(const wire::WireRelay& request) {
  links_.relay(request.wire(), request.token(), request.peer(), {request.endpoint(), request.name(), request.key()});
}

void Runtime::await(const wire::Await& request) {
  required(request.client())
      .end_for(text_of(request.provider()))
      ->set_connection(Connection::Waiting, request.reason());
}

void Runtime::arrange(const wire::Arrange& request, wire::Switched& switched) {
  RequiredPort& client = required(request.client());
  std::vector<std::string> providers;
  for (const auto& name : request.providers()) providers.push_back(text_of(name));
  SwitchCost cost(client);
  client.arrange(providers, from_milliseconds(request.hold_ms()));
  cost.end(switched);
  for (const std::uint64_t wire : request.retires()) retire(wire);
}

void Runtime::cut(const wire::Cut& request) {
  const auto found = wires_.find(request.wire());
  if (found == wires_.end()) return links_.cut(request.wire(), request.reason());
  const auto client = found->second.client;
  client->set_target(nullptr);
  found->second.local->cut(request.reason());
  retire(request.wire());
  client->set_connection(Connection::Unwired, request.reason());
}

/// Lets go of a wire whose client goes on with another one, or with none. What is on its way over a local wire still
/// reaches the provider and ends there; a push has its cut here.
void Runtime::retire(std::uint64_t id, bool drains) {
  const auto found = wires_.find(id);
  if (found == wires_.end()) return links_.retire(id, drains);
  if (found->second.provider) {
    found->second.provider->detach(*found->second.local);
    found->second.local->cut("");  // a push: nothing is open on it
  } else {
    std::erase_if(retired_, [](const auto& wire) { return !wire->has_open(); });
    retired_.push_back(found->second.local);
  }
  wires_.erase(found);
}

/// Whoever asked for the end of an instance has cut its wires, unless he did not know of it any more.
void Runtime::end_wires(const Hull& hull, Connection now, const std::string& reason) {
  std::vector<std::uint64_t> left;
  for (const auto& [id, wire] : wires_) {
    if (wire.provider_hull == &hull || &wire.client->port().hull() == &hull) left.push_back(id);
  }
  for (const std::uint64_t id : left) {
    const auto client = wires_.at(id).client;
    wire::Cut request;
    request.set_wire(id);
    request.set_reason(reason);
    cut(request);
    if (now != Connection::Lost) continue;
    client->set_connection(now, reason);
    wire::GroupMessage message;
    message.mutable_wire_lost()->set_wire(id);
    message.mutable_wire_lost()->set_reason(reason);
    emit(std::move(message));
  }
  for (const auto& wire : retired_) wire->cut_from(hull, reason);
}

ProvidedPort& Runtime::provided(const control::PortName& name) {
  auto* port = dynamic_cast<ProvidedPort*>(find(name.instance()).hull->find_port(name.port()));
  if (port) return *port;
  throw Error(ErrorCode::NotFound,
              {.what = text_of(name) + " is no provided port", .next = "show " + name.instance() + " tells its ports"});
}

RequiredPort& Runtime::required(const control::PortName& name) {
  auto* port = dynamic_cast<RequiredPort*>(find(name.instance()).hull->find_port(name.port()));
  if (port) return *port;
  throw Error(ErrorCode::NotFound,
              {.what = text_of(name) + " is no required port", .next = "show " + name.instance() + " tells its ports"});
}

}  // namespace fiona::host
