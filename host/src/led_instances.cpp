#include "led_instances.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iostream>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "link_keys.hpp"
#include "names.hpp"
#include "orders.hpp"

namespace fiona::host {
namespace {

/// Of those that have ended so many are remembered, until the leader makes them again.
constexpr std::size_t kMostEnded = 10'000;
/// What a former leader has left and could not be destroyed.
constexpr std::chrono::seconds kDestroysEvery{5};

}  // namespace

wire::GroupMessage LedInstances::obey(const wire::HostRequest& order) {
  wire::GroupMessage reply;
  reply.mutable_done();
  try {
    check(order.request());
    Group* found = around_.groups.living(order.group());
    if (order.request().has_create()) {
      create(order.request(), order.group(), reply);
    } else if (!found && order.request().has_inventory()) {
      reply.mutable_adopted();
    } else if (!found) {
      throw Error(ErrorCode::NotFound, {.what = fmt::format("host '{}' has no group '{}'", around_.host, order.group()),
                                        .next = "its process may have ended: ls tells"});
    } else {
      reply = pass_on(order.request(), *found);
    }
    if (reply.has_status()) keep_led(*reply.mutable_status());
    if (reply.has_adopted()) keep_led(*reply.mutable_adopted());
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(order.request().id());
  return reply;
}

/// What goes between processes of this host is opened with keys that only it knows.
Links::Endpoint LedInstances::own_endpoint(const std::string& endpoint, const Group& at) const {
  if (endpoint == kLeaderEndpoint) return {endpoint, "", ""};
  const Group& to = group_at(endpoint);
  return {to.endpoint(), at.link_name(), link_key(to.link_key(), at.link_name())};
}

wire::GroupMessage LedInstances::pass_on(wire::GroupRequest request, Group& group) {
  request.clear_expires_ns();  // by the clock of another machine
  const auto set_peer = [this](auto& message) {
    if (message.peer() != kLeaderEndpoint) message.set_peer(group_at(message.peer()).link_name());
  };
  if (request.has_wire_provide()) set_peer(*request.mutable_wire_provide());
  if (request.has_wire_relay()) set_peer(*request.mutable_wire_relay());
  const auto set_way = [&](auto& message) { set_endpoint(message, own_endpoint(message.endpoint(), group)); };
  if (request.has_wire_require()) set_way(*request.mutable_wire_require());
  if (request.has_wire_relay()) set_way(*request.mutable_wire_relay());
  wire::GroupMessage reply;
  reply.mutable_done();
  if (request.has_destroy()) {
    reply.mutable_done()->set_note(destroy(request.destroy().instance()));
  } else if (request.has_cut() || request.has_await()) {
    group.inform(std::move(request));
  } else if (request.has_untap() || request.has_give_up_call()) {
    group.tell(std::move(request));  // one that is silent does it when it comes to it
  } else {
    reply = group.request(std::move(request));
  }
  return reply;
}

void LedInstances::keep_led(wire::GroupStatusReply& status) const {
  auto& instances = *status.mutable_instances();
  for (int i = instances.size() - 1; i >= 0; --i) {
    const auto* one = around_.model.find(instances[i].name());
    if (!one || !one->led) instances.DeleteSubrange(i, 1);
  }
}

/// What the leader has here, and what he had.
void LedInstances::keep_led(wire::Adopted& held) const {
  keep_led(*held.mutable_status());
  auto& wires = *held.mutable_wires();
  wires.erase(std::remove_if(wires.begin(), wires.end(), [](const auto& one) { return one.wire() >= kOwnNumbers; }),
              wires.end());
  held.mutable_ended()->insert(ended_.begin(), ended_.end());
}

void LedInstances::require_led(const std::string& name) const {
  const auto* found = around_.model.find(name);
  if (found && found->led) return;
  throw Error(ErrorCode::NotFound,
              {.what = fmt::format("the leader has no instance '{}' on host '{}'", name, around_.host),
               .expected = "an instance that this leader has made here"});
}

/// A leader reaches what is his: his instances, his wires, his taps.
void LedInstances::check(const wire::GroupRequest& request) const {
  using Request = wire::GroupRequest;
  const auto number = [](std::uint64_t one) {
    if (one >= kOwnNumbers)
      throw Error(ErrorCode::NotAllowed, {.what = "this number belongs to the host that is led",
                                          .expected = fmt::format("a number below {}", kOwnNumbers)});
  };
  switch (request.what_case()) {
    case Request::kDestroy: require_led(request.destroy().instance()); return;
    case Request::kSetParameters: require_led(request.set_parameters().instance()); return;
    case Request::kSetMode: require_led(request.set_mode().instance()); return number(request.set_mode().change());
    case Request::kWireLocal:
      require_led(request.wire_local().client().instance());
      require_led(request.wire_local().provider().instance());
      number(request.wire_local().replaces());
      return number(request.wire_local().wire());
    case Request::kWireProvide:
      require_led(request.wire_provide().provider().instance());
      return number(request.wire_provide().wire());
    case Request::kSetPrescale: return number(request.set_prescale().wire());
    case Request::kWireRequire:
      require_led(request.wire_require().client().instance());
      number(request.wire_require().replaces());
      return number(request.wire_require().wire());
    case Request::kTap: require_led(request.tap().watch().port().instance()); return number(request.tap().tap());
    case Request::kCall: require_led(request.call().target().instance()); return number(request.call().run());
    case Request::kRead: return require_led(request.read().probe().instance());
    case Request::kAwait: return require_led(request.await().client().instance());
    case Request::kArrange:
      for (const std::uint64_t wire : request.arrange().retires()) number(wire);
      return require_led(request.arrange().client().instance());
    case Request::kCut: return number(request.cut().wire());
    case Request::kGiveUpCall: return number(request.give_up_call().run());
    case Request::kUntap: return number(request.untap().tap());
    case Request::kAnswered: return require_led(request.answered().instance());
    case Request::kWireRelay: return number(request.wire_relay().wire());
    case Request::kCreate:
    case Request::kPing:
    case Request::kInventory:
    case Request::kStatus: return;
    case Request::kWelcome:
    case Request::kAdopt:
    case Request::kPeerLost:
      throw Error(ErrorCode::NotAllowed, {.what = "a host tells its processes about their links itself",
                                          .expected = "an order about what the leader has made here"});
    case Request::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, {.what = "the request is empty, or newer than this program",
                                 .next = "run the same version of FIONA on both hosts"});
}

/// Of those here. A leader names no sockets.
Group& LedInstances::group_at(const std::string& endpoint) const {
  Group* found =
      endpoint.starts_with(kGroupEndpoint) ? around_.groups.living(endpoint.substr(kGroupEndpoint.size())) : nullptr;
  if (found) return *found;
  throw Error(ErrorCode::NotFound, {.what = fmt::format("host '{}' has no group for '{}'", around_.host, endpoint),
                                    .next = "its process may have ended: ls tells"});
}

/// The package is this host's own: of the same name, version and interface as the leader's.
Packages::Choice LedInstances::own_package(const wire::Create& create) const {
  const bool local = create.plugin().starts_with(kTypedByPath);
  if (local && (around_.plugins.empty() || create.plugin().find("..") != std::string::npos)) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("{} is in no package, and host '{}' takes only what is installed on it",
                                     create.plugin(), around_.host),
                 .next = "pack it and install it on both hosts; or start that host with --plugins DIR"});
  }
  const std::string library =
      (around_.plugins / ("lib" + create.plugin().substr(local ? kTypedByPath.size() : 0) + ".so")).string();
  const Packages::Choice own = around_.packages.find((local ? library : create.plugin()) + "/" + create.component());
  const Package& package = *own.package;
  const bool same = package.name == create.plugin() && package.version == create.version();
  if (!same || package.interface.SerializeAsString() != create.interface().SerializeAsString()) {
    throw Error(ErrorCode::DependencyConflict,
                {.what = fmt::format("host '{}' has {}{} {}", around_.host, same ? "another build of " : "",
                                     package.name, package.version),
                 .expected = fmt::format("{} {}, as on the host that leads", create.plugin(), create.version()),
                 .next = fmt::format("on host '{}': fiona market install {}@{}", around_.host, create.plugin(),
                                     create.version())});
  }
  return own;
}

void LedInstances::create(const wire::GroupRequest& request, const std::string& group, wire::GroupMessage& reply) {
  const auto& create = request.create();
  const auto [package, component] = own_package(create);
  const std::string& name = create.instance();
  Model next = around_.model;
  next.take(name, {.plugin = create.plugin(),
                   .package = package,
                   .component = component,
                   .group = group,
                   .mode = create.mode(),
                   .mode_at_load = create.mode(),
                   .parameters = nullptr,
                   .led = true});
  control::Load as_ordered;
  *as_ordered.mutable_parameters() = create.parameters();
  as_ordered.set_mode(create.mode());
  note(name, true);  // from its first word on
  try {
    around_.make(std::move(next), name, as_ordered);
  } catch (...) {
    note(name, false);
    throw;
  }
  ended_.erase(name);
  left_.erase(name);
  reply.mutable_done()->set_note(fmt::format("{} {} as {}", package->name, package->version, name));
}

void LedInstances::destroy_all() {
  ended_.clear();
  for (const std::string& name : around_.model.names()) {
    if (around_.model.instance(name).led) left_.insert(name);
  }
  destroys_at_ = {};
  destroy_left(std::chrono::steady_clock::now());
}

/// A group that does not answer is not asked for the next one at once.
void LedInstances::destroy_left(std::chrono::steady_clock::time_point now) {
  if (left_.empty() || now < destroys_at_) return;
  std::set<std::string> silent;
  for (const std::string& name : std::set<std::string>(left_)) {
    const auto* one = around_.model.find(name);  // it may go with the end of the one before it
    if (!one || !one->led) left_.erase(name);
    if (!one || !one->led || silent.contains(one->group)) continue;
    const std::string group = one->group;
    const auto fault = fault_of([&] { destroy(name); });
    if (!fault) continue;
    std::cerr << name << ": " << *fault << "\n";
    if (around_.groups.living(group)) silent.insert(group);
  }
  destroys_at_ = std::chrono::steady_clock::now() + kDestroysEvery;
}

std::string LedInstances::destroy(const std::string& name) {
  std::string said = around_.destroy(name);
  forget(name);
  return said;
}

void LedInstances::forget(const std::string& name) {
  note(name, false);
  left_.erase(name);
}

void LedInstances::forget(const std::string& name, const std::string& reason) {
  forget(name);
  if (ended_.size() >= kMostEnded) ended_.erase(ended_.begin());
  ended_[name] = reason;
}

void LedInstances::note(const std::string& name, bool led) {
  const std::lock_guard lock(mutex_);
  led ? static_cast<void>(names_.insert(name)) : static_cast<void>(names_.erase(name));
}

bool LedInstances::is_led(const std::string& name) const {
  const std::lock_guard lock(mutex_);
  return names_.contains(name);
}

bool LedInstances::is_of_leader(const wire::GroupMessage& event) const {
  using Event = wire::GroupMessage;
  switch (event.what_case()) {
    case Event::kModeChanged: return is_led(event.mode_changed().instance());
    case Event::kRunEnded: return is_led(event.run_ended().instance());
    case Event::kLogged: return is_led(event.logged().instance());
    case Event::kAsked: return is_led(event.asked().instance());
    case Event::kTapEnded: return event.tap_ended().tap() < kOwnNumbers;
    case Event::kTapped: return event.tapped().tap() < kOwnNumbers;
    case Event::kWireLost: return event.wire_lost().wire() < kOwnNumbers;
    case Event::kModeSet: return event.mode_set().change() < kOwnNumbers;
    case Event::kCallEnded: return event.call_ended().run() < kOwnNumbers;
    case Event::kGroupEnded: return true;
    default: return false;
  }
}

}  // namespace fiona::host
