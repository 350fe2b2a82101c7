// Being led: what the host that leads this one orders, and what it is told.
#include <fmt/format.h>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "link_keys.hpp"
#include "orders.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kLocal = "local/";  ///< plugins that are in no package

}  // namespace

wire::GroupMessage System::obey(const wire::HostRequest& order) {
  wire::GroupMessage reply;
  reply.mutable_done();
  try {
    check_order(order.request());
    Group* found = groups_.living(order.group());
    if (order.request().has_create()) {
      obey_create(order.request(), order.group(), reply);
    } else if (!found) {
      throw Error(ErrorCode::NotFound,
                  {.what = fmt::format("host '{}' has no group '{}'", options_.name, order.group()),
                   .next = "its process may have ended: ls tells"});
    } else {
      reply = obey_in_group(order.request(), *found);
    }
    if (reply.has_status()) keep_led(*reply.mutable_status());
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(order.request().id());
  return reply;
}

/// What goes between processes of this host is opened with keys that only it knows.
Links::Endpoint System::led_endpoint(const std::string& endpoint, Group& at) {
  if (endpoint == kLeaderEndpoint) return {endpoint, "", ""};
  Group& to = led_group(endpoint);
  return {to.endpoint(), at.link_name(), link_key(to.link_key(), at.link_name())};
}

wire::GroupMessage System::obey_in_group(wire::GroupRequest request, Group& group) {
  const auto set_peer = [this](auto& message) {
    if (message.peer() != kLeaderEndpoint) message.set_peer(led_group(message.peer()).link_name());
  };
  if (request.has_wire_provide()) set_peer(*request.mutable_wire_provide());
  if (request.has_wire_relay()) set_peer(*request.mutable_wire_relay());
  const auto set_way = [&](auto& message) { set_endpoint(message, led_endpoint(message.endpoint(), group)); };
  if (request.has_wire_require()) set_way(*request.mutable_wire_require());
  if (request.has_wire_relay()) set_way(*request.mutable_wire_relay());
  wire::GroupMessage reply;
  reply.mutable_done();
  if (request.has_destroy()) {
    reply.mutable_done()->set_note(drop_led(request.destroy().instance()));
  } else if (request.has_cut() || request.has_await()) {
    group.inform(std::move(request));
  } else {
    reply = group.request(std::move(request));
  }
  return reply;
}

void System::keep_led(wire::GroupStatusReply& status) const {
  auto& instances = *status.mutable_instances();
  for (int i = instances.size() - 1; i >= 0; --i) {
    const auto* one = model_.find(instances[i].name());
    if (!one || !one->led) instances.DeleteSubrange(i, 1);
  }
}

void System::require_led(const std::string& name) {
  const auto* found = model_.find(name);
  if (found && found->led) return;
  throw Error(ErrorCode::NotFound,
              {.what = fmt::format("the leader has no instance '{}' on host '{}'", name, options_.name),
               .expected = "an instance that this leader has made here"});
}

/// A leader reaches what is his: his instances, his wires, his taps.
void System::check_order(const wire::GroupRequest& request) {
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
    case Request::kUntap: return number(request.untap().tap());
    case Request::kAnswered: return require_led(request.answered().instance());
    case Request::kWireRelay: return number(request.wire_relay().wire());
    case Request::kCreate:
    case Request::kPing:
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
Group& System::led_group(const std::string& endpoint) {
  Group* found =
      endpoint.starts_with(kGroupEndpoint) ? groups_.living(endpoint.substr(kGroupEndpoint.size())) : nullptr;
  if (found) return *found;
  throw Error(ErrorCode::NotFound, {.what = fmt::format("host '{}' has no group for '{}'", options_.name, endpoint),
                                    .next = "its process may have ended: ls tells"});
}

/// The package is this host's own: of the same name, version and interface as the leader's.
Packages::Choice System::own_package(const wire::Create& create) const {
  const bool local = create.plugin().starts_with(kLocal);
  if (local && (options_.plugins.empty() || create.plugin().find("..") != std::string::npos)) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("{} is in no package, and host '{}' takes only what is installed on it",
                                     create.plugin(), options_.name),
                 .next = "pack it and install it on both hosts; or start that host with --plugins DIR"});
  }
  const std::string library =
      (options_.plugins / ("lib" + create.plugin().substr(local ? kLocal.size() : 0) + ".so")).string();
  const Packages::Choice own = packages_.find((local ? library : create.plugin()) + "/" + create.component());
  const Package& package = *own.package;
  const bool same = package.name == create.plugin() && package.version == create.version();
  if (!same || package.interface.SerializeAsString() != create.interface().SerializeAsString()) {
    throw Error(ErrorCode::DependencyConflict,
                {.what = fmt::format("host '{}' has {}{} {}", options_.name, same ? "another build of " : "",
                                     package.name, package.version),
                 .expected = fmt::format("{} {}, as on the host that leads", create.plugin(), create.version()),
                 .next = fmt::format("on host '{}': fiona market install {}@{}", options_.name, create.plugin(),
                                     create.version())});
  }
  return own;
}

void System::obey_create(const wire::GroupRequest& request, const std::string& group_name, wire::GroupMessage& reply) {
  const auto& create = request.create();
  const auto [package, component] = own_package(create);
  const std::string& name = create.instance();
  Model next = model_;
  next.take(name, {.plugin = create.plugin(),
                   .package = package,
                   .component = component,
                   .group = group_name,
                   .mode = create.mode(),
                   .mode_at_load = create.mode(),
                   .parameters = nullptr,
                   .led = true});
  control::Load as_ordered;
  *as_ordered.mutable_parameters() = create.parameters();
  as_ordered.set_mode(create.mode());
  note_led(name, true);  // from its first word on
  try {
    this->create(group_for(next.instance(name)), name, next.instance(name), as_ordered);
  } catch (...) {
    note_led(name, false);
    throw;
  }
  model_ = std::move(next);
  reply.mutable_done()->set_note(fmt::format("{} {} as {}", package->name, package->version, name));
}

/// What a former leader has left.
void System::drop_led() {
  for (const std::string& name : model_.names()) {
    if (model_.instance(name).led) drop_led(name);
  }
}

std::string System::drop_led(const std::string& name) {
  control::Unload request;
  request.set_instance(name);
  const control::Done done = unload(request);
  note_led(name, false);
  model_.drop(name);
  return done.note();
}

void System::note_led(const std::string& name, bool led) {
  const std::lock_guard lock(led_mutex_);
  led ? static_cast<void>(led_names_.insert(name)) : static_cast<void>(led_names_.erase(name));
}

/// What was the leader's in a group that has gone is told; the names are his to use again.
void System::forget_led(const std::string& group) {
  for (const std::string& name : model_.names_in(group)) {
    if (!model_.instance(name).led) continue;
    note_led(name, false);
    lost_.erase(name);
    model_.drop(name);
  }
}

/// Whether the event is of the leader's system; if so it is told.
bool System::tell_leader(const wire::GroupMessage& event) {
  using Event = wire::GroupMessage;
  LeaderLink* leader = hosts_ ? hosts_->leader() : nullptr;
  if (!leader) return false;
  const auto is_led = [this](const std::string& name) {
    const std::lock_guard lock(led_mutex_);
    return led_names_.contains(name);
  };
  bool led = false;
  switch (event.what_case()) {
    case Event::kModeChanged: led = is_led(event.mode_changed().instance()); break;
    case Event::kRunEnded: led = is_led(event.run_ended().instance()); break;
    case Event::kLogged: led = is_led(event.logged().instance()); break;
    case Event::kAsked: led = is_led(event.asked().instance()); break;
    case Event::kTapEnded: led = event.tap_ended().tap() < kOwnNumbers; break;
    case Event::kTapped: led = event.tapped().tap() < kOwnNumbers; break;
    case Event::kWireLost: led = event.wire_lost().wire() < kOwnNumbers; break;
    case Event::kModeSet: led = event.mode_set().change() < kOwnNumbers; break;
    case Event::kCallEnded: led = event.call_ended().run() < kOwnNumbers; break;
    case Event::kGroupEnded: led = true; break;
    default: break;
  }
  if (led) leader->tell(event);
  return led;
}

}  // namespace fiona::host
