// What a system does with other hosts: those that it leads, and the one that leads it (docs/hosts.md).
#include <fmt/format.h>

#include <algorithm>

#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kLeader = "host:";   ///< the way to the leader, on a host that is led
constexpr std::string_view kGroup = "group:";   ///< a group, as its own host knows it
constexpr std::string_view kLocal = "local/";   ///< plugins that are in no package

}  // namespace

// ---- leading --------------------------------------------------------------------------------------------------

/// The host that a group is on; empty: this one.
std::string System::host_of(const std::string& group) const {
  const std::string host = group.substr(0, group.find('/'));
  return hosts_ && hosts_->peer(host) ? host : "";
}

Group& System::main_of(const std::string& host) { return group(host.empty() ? "main" : host); }

std::vector<RemoteGroup*> System::groups_of(const std::string& host) {
  std::vector<RemoteGroup*> found;
  for (auto& [name, one] : groups_) {
    auto* remote = dynamic_cast<RemoteGroup*>(one.get());
    if (remote && remote->host() == host) found.push_back(remote);
  }
  return found;
}

/// The group of an instance whose host is silent and may come back; null otherwise.
RemoteGroup* System::silent_group(const Instance& one) {
  const auto found = groups_.find(one.group);
  auto* remote = found == groups_.end() ? nullptr : dynamic_cast<RemoteGroup*>(found->second.get());
  return remote && remote->end().empty() && !remote->alive() ? remote : nullptr;
}

/// Null where the name is none of another host's.
Group* System::remote_group(const std::string& name) {
  const std::size_t slash = name.find('/');
  const std::string host = name.substr(0, slash);
  PeerLink* peer = hosts_ ? hosts_->peer(host) : nullptr;
  if (!peer) {
    if (slash == std::string::npos) return nullptr;
    std::vector<std::string> known;
    if (hosts_) for (const auto& one : hosts_->peers()) known.push_back(one->peer().name);
    throw Error(ErrorCode::NotFound, {.what = fmt::format("there is no host '{}'", host),
                                      .expected = known.empty() ? "a host that was named with --peer when this one was started"
                                                                : fmt::format("one of {}", fmt::join(known, ", ")),
                                      .next = "ls hosts",
                                      .near = nearest_names(host, known)});
  }
  if (!peer->joined()) {
    throw Error(ErrorCode::Unreachable, {.what = fmt::format("host '{}' is not connected", host),
                                         .where = peer->peer().address,
                                         .found = peer->status().reason(),
                                         .next = "ls hosts"});
  }
  const std::string group = slash == std::string::npos ? "main" : name.substr(slash + 1);
  return (groups_[name] = std::make_unique<RemoteGroup>(name, *peer, group)).get();
}

/// Has the hosts on the way pass the wire on, and returns where the client's process finds it. One connection carries
/// all that goes between two hosts; their groups reach it through their host's own process.
std::string System::route(Wire& wire, const std::string& token, Group& client, Group& provider) {
  const std::string from = host_of(client.name());
  const std::string to = host_of(provider.name());
  if (from == to) return provider.endpoint();
  const auto pass_on = [&](Group& at, const std::string& endpoint) {
    wire.relays.push_back(at.name());
    wire::GroupRequest request;
    request.mutable_wire_relay()->set_wire(wire.id);
    request.mutable_wire_relay()->set_token(token);
    request.mutable_wire_relay()->set_endpoint(endpoint);
    at.request(std::move(request));
  };
  if (&provider != &main_of(to)) pass_on(main_of(to), provider.endpoint());
  if (!from.empty() && !to.empty()) pass_on(main_of(""), "host:" + to);
  const std::string out = from.empty() ? "host:" + to : std::string(kLeader);
  if (&client == &main_of(from)) return out;
  pass_on(main_of(from), out);
  return main_of(from).endpoint();
}

/// Ends a wire in one group. One that is on a silent host does it when that is back.
void System::cut_at(const std::string& name, std::uint64_t wire, const std::string& reason) {
  const auto found = groups_.find(name);
  if (found == groups_.end()) return;
  wire::GroupRequest cut;
  cut.mutable_cut()->set_wire(wire);
  cut.mutable_cut()->set_reason(reason);
  auto* remote = dynamic_cast<RemoteGroup*>(found->second.get());
  if (!remote) {
    if (found->second->alive()) found->second->request(std::move(cut));
    return;
  }
  if (!remote->end().empty()) return;
  try {
    remote->request(cut);
  } catch (const Error&) {
    if (remote->alive()) throw;
    remote->owe(std::move(cut));
  }
}

bool System::crosses(const control::PortName& client, const Wire& wire, const std::string& host) {
  const std::string from = host_of(instance(client.instance()).group);
  const std::string to = host_of(instance(wire.provider.instance()).group);
  return from != to && (from == host || to == host);
}

void System::on_host_lost(const std::string& host, const std::string& reason, bool for_good) {
  for (auto& [name, one] : instances_) {
    if (host_of(one.group) != host || (!one.lost.empty() && !one.away)) continue;
    one.lost = reason;
    one.away = !for_good;
  }
  for (auto& [key, wire] : wires_) {
    control::PortName client;
    client.set_instance(key.first);
    const bool inside = host_of(instances_.at(key.first).group) == host;
    if (crosses(client, wire, host) || (for_good && inside)) wire.lost = reason;
  }
  if (!for_good) return;
  for (auto* group : groups_of(host)) {
    group->end(reason);
    group->take_owed();
  }
}

/// Does what was asked for meanwhile, and finds out what is still there.
void System::resume(RemoteGroup& group) {
  for (auto& request : group.take_owed()) {
    try {
      group.request(request);
    } catch (const Error&) {
      if (!group.alive()) group.owe(std::move(request));  // what is refused is gone already
    }
  }
  wire::GroupRequest ask;
  ask.mutable_status();
  std::set<std::string> there;
  try {
    const auto reply = group.request(std::move(ask));
    for (const auto& one : reply.status().instances()) there.insert(one.name());
  } catch (const Error&) {
    if (!group.alive()) return;
  }
  for (auto& [name, one] : instances_) {
    if (one.group != group.name() || !one.away) continue;
    one.away = false;
    one.lost = there.contains(name) ? "" : fmt::format("it was unloaded on host '{}'", group.host());
  }
  for (const auto& name : there) {
    const auto known = instances_.find(name);
    if (known != instances_.end() && known->second.group == group.name()) continue;
    // Made by a request whose answer was lost.
    wire::GroupRequest destroy;
    destroy.mutable_destroy()->set_instance(name);
    group.owe(std::move(destroy));
  }
  for (auto& request : group.take_owed()) group.request(std::move(request));
}

void System::resume_wires(const std::string& host) {
  for (auto& [key, wire] : wires_) {
    control::PortName client;
    client.set_instance(key.first);
    client.set_port(key.second);
    const bool both = instances_.at(key.first).lost.empty() && instances_.at(wire.provider.instance()).lost.empty();
    if (wire.lost.empty() || !both || !crosses(client, wire, host)) continue;
    try {
      wire = connect(client, wire.provider, wire.prescale, wire.id, true);
    } catch (const Error& error) {
      wire.lost = error.text().what;
    }
  }
}

std::string System::on_host_joined(const HostChange& change) {
  if (!change.same_run) {
    on_host_lost(change.host, fmt::format("host '{}' was started anew", change.host), true);
  } else {
    for (auto* group : groups_of(change.host)) {
      if (group->end().empty()) resume(*group);
    }
  }
  resume_wires(change.host);
  return fmt::format("host '{}' has joined", change.host);
}

void System::on_remote_group_ended(const HostChange& change) {
  for (auto* group : groups_of(change.host)) {
    if (group->group() != change.group) continue;
    group->end(change.reason);
    for (auto& [name, one] : instances_) {
      if (one.group == group->name()) one.lost = change.reason;
    }
    for (auto& [key, wire] : wires_) {
      const std::string provider_group = instances_.at(wire.provider.instance()).group;
      const bool client_gone = instances_.at(key.first).group == group->name();
      const bool provider_gone = provider_group == group->name();
      if (client_gone || provider_gone) wire.lost = change.reason;
      if (client_gone && !provider_gone) cut_at(provider_group, wire.id, change.reason);
    }
  }
}

std::vector<std::string> System::serve_hosts() {
  std::vector<std::string> said;
  if (!hosts_) return said;
  LeaderLink* leader = hosts_->leader();
  for (const auto& change : hosts_->changes()) {
    switch (change.what) {
      case HostChange::What::Request: leader->answer(change.session, obey(change.request)); break;
      case HostChange::What::Joined:
        if (leader && !change.same_run) drop_led();
        said.push_back(leader ? fmt::format("host '{}' leads this one", change.host) : on_host_joined(change));
        break;
      case HostChange::What::Lost:
        if (!leader) on_host_lost(change.host, change.reason, false);
        said.push_back(change.reason);
        break;
      case HostChange::What::Left:
        leader->leave(change.session);
        drop_led();
        break;
      case HostChange::What::GroupEnded:
        on_remote_group_ended(change);
        said.push_back(fmt::format("on host '{}': {}", change.host, change.reason));
        break;
    }
  }
  return said;
}

const char* System::transport(const std::string& client, const Wire& wire) const {
  if (wire.local) return "process";
  const bool far = host_of(instances_.at(client).group) != host_of(instances_.at(wire.provider.instance()).group);
  return far ? "tcp" : "ipc";
}

void System::add_hosts(control::System& all) {
  if (!hosts_) return;
  all.set_key(hosts_->key());
  all.set_listens(listens());
  all.set_refused_hosts(hosts_->refused());
  const auto count = [this](const auto& fits) {
    return static_cast<std::uint64_t>(std::count_if(instances_.begin(), instances_.end(), [&](const auto& entry) { return fits(entry.second); }));
  };
  for (const auto& peer : hosts_->peers()) {
    auto& status = *all.add_hosts() = peer->status();
    status.set_instances(count([&](const Instance& one) { return host_of(one.group) == peer->peer().name; }));
  }
  if (!hosts_->leader()) return;
  if (const auto leader = hosts_->leader()->status()) {
    auto& status = *all.add_hosts() = *leader;
    status.set_instances(count([](const Instance& one) { return one.led; }));
  }
}

// ---- being led ------------------------------------------------------------------------------------------------

wire::GroupMessage System::obey(const wire::HostRequest& order) {
  wire::GroupMessage reply;
  reply.mutable_done();
  try {
    check_order(order.request());
    const auto found = groups_.find(order.group());
    if (order.request().has_create()) {
      obey_create(order.request(), order.group(), reply);
    } else if (found == groups_.end() || !found->second->alive()) {
      throw Error(ErrorCode::NotFound, fmt::format("host '{}' has no group '{}'", options_.name, order.group()));
    } else {
      wire::GroupRequest request = order.request();
      if (request.has_wire_require()) request.mutable_wire_require()->set_endpoint(led_endpoint(request.wire_require().endpoint()));
      if (request.has_wire_relay()) request.mutable_wire_relay()->set_endpoint(led_endpoint(request.wire_relay().endpoint()));
      if (request.has_wire_relay()) led_relays_.insert(request.wire_relay().wire());
      if (request.has_cut()) led_relays_.erase(request.cut().wire());
      if (request.has_destroy()) {
        control::Unload unload_it;
        unload_it.set_instance(request.destroy().instance());
        led_instance(request.destroy().instance()).led = false;
        reply.mutable_done()->set_note(unload(unload_it));
      } else {
        reply = found->second->request(std::move(request));
      }
    }
    if (reply.has_status()) keep_led(*reply.mutable_status());
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(order.request().id());
  return reply;
}

void System::keep_led(wire::GroupStatusReply& status) const {
  auto& instances = *status.mutable_instances();
  for (int i = instances.size() - 1; i >= 0; --i) {
    const auto one = instances_.find(instances[i].name());
    if (one == instances_.end() || !one->second.led) instances.DeleteSubrange(i, 1);
  }
}

System::Instance& System::led_instance(const std::string& name) {
  const auto found = instances_.find(name);
  if (found != instances_.end() && found->second.led) return found->second;
  throw Error(ErrorCode::NotFound, fmt::format("the leader has no instance '{}' on host '{}'", name, options_.name));
}

/// A leader reaches what is his: his instances, his wires, his taps.
void System::check_order(const wire::GroupRequest& request) {
  using Request = wire::GroupRequest;
  const auto number = [](std::uint64_t one) {
    if (one >= kOwnNumbers) throw Error(ErrorCode::NotAllowed, "this number belongs to the host that is led");
  };
  switch (request.what_case()) {
    case Request::kDestroy: led_instance(request.destroy().instance()); return;
    case Request::kSetParameters: led_instance(request.set_parameters().instance()); return;
    case Request::kSetMode: led_instance(request.set_mode().instance()); return number(request.set_mode().change());
    case Request::kWireLocal:
      led_instance(request.wire_local().client().instance());
      led_instance(request.wire_local().provider().instance());
      number(request.wire_local().replaces());
      return number(request.wire_local().wire());
    case Request::kWireProvide:
      led_instance(request.wire_provide().provider().instance());
      return number(request.wire_provide().wire());
    case Request::kWireRequire:
      led_instance(request.wire_require().client().instance());
      number(request.wire_require().replaces());
      return number(request.wire_require().wire());
    case Request::kTap: led_instance(request.tap().port().instance()); return number(request.tap().tap());
    case Request::kCall: led_instance(request.call().target().instance()); return number(request.call().run());
    case Request::kCut: return number(request.cut().wire());
    case Request::kUntap: return number(request.untap().tap());
    case Request::kWireRelay: return number(request.wire_relay().wire());
    case Request::kCreate:
    case Request::kStatus: return;
    case Request::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, "the request is empty, or newer than this program");
}

/// Where a leader's wire goes: to himself, or to a group here. He names no sockets.
std::string System::led_endpoint(const std::string& endpoint) {
  if (endpoint == kLeader) return endpoint;
  const auto found = endpoint.starts_with(kGroup) ? groups_.find(endpoint.substr(kGroup.size())) : groups_.end();
  if (found != groups_.end() && found->second->alive()) return found->second->endpoint();
  throw Error(ErrorCode::NotFound, fmt::format("host '{}' has no group for '{}'", options_.name, endpoint));
}

/// The package is this host's own: of the same name, version and interface as the leader's.
void System::obey_create(const wire::GroupRequest& request, const std::string& group_name, wire::GroupMessage& reply) {
  const auto& create = request.create();
  const bool local = create.plugin().starts_with(kLocal);
  if (local && (options_.plugins.empty() || create.plugin().find("..") != std::string::npos)) {
    throw Error(ErrorCode::NotAllowed, {.what = fmt::format("{} is in no package, and host '{}' takes only what is installed on it",
                                                            create.plugin(), options_.name),
                                        .next = "pack it and install it on both hosts; or start that host with --plugins DIR"});
  }
  Installed package = local ? find_library(options_.plugins / ("lib" + create.plugin().substr(kLocal.size()) + ".so")) : find_plugin(create.plugin());
  const bool same = package.name == create.plugin() && package.version == create.version();
  if (!same || package.interface.SerializeAsString() != create.interface().SerializeAsString()) {
    throw Error(ErrorCode::DependencyConflict, {.what = same ? fmt::format("host '{}' has another build of {} {}", options_.name, package.name, package.version)
                                                             : fmt::format("host '{}' has {} {}", options_.name, package.name, package.version),
                                                .expected = fmt::format("{} {}, as on the host that leads", create.plugin(), create.version()),
                                                .next = fmt::format("on host '{}': fiona market install {}@{}", options_.name, create.plugin(), create.version())});
  }
  package.component = choose_component(package.interface, package.name, create.component());
  control::Load load_it;
  load_it.set_plugin(create.plugin());
  load_it.set_instance(create.instance());
  load_it.set_group(group_name == "main" ? "" : group_name);
  *load_it.mutable_parameters() = create.parameters();
  load_it.set_mode(create.mode());
  reply.mutable_done()->set_note(this->create(std::move(package), load_it, true));
}

/// What a former leader has left.
void System::drop_led() {
  for (const std::uint64_t wire : std::exchange(led_relays_, {})) cut_at("main", wire, "another host leads");
  std::vector<std::string> names;
  for (auto& [name, one] : instances_) {
    if (std::exchange(one.led, false)) names.push_back(name);
  }
  for (const auto& name : names) {
    control::Unload unload_it;
    unload_it.set_instance(name);
    unload(unload_it);
  }
}

void System::note_led(const std::string& name, bool led) {
  const std::lock_guard lock(led_mutex_);
  led ? static_cast<void>(led_names_.insert(name)) : static_cast<void>(led_names_.erase(name));
}

void System::refuse_if_led(const std::string& name) {
  const std::string leader = hosts_ && hosts_->leader() ? hosts_->leader()->leader() : "";
  if (leader.empty() || !instance(name).led) return;
  throw Error(ErrorCode::NotAllowed, {.what = fmt::format("'{}' belongs to the system of host '{}', which leads this one", name, leader),
                                      .next = fmt::format("say it on host '{}'", leader)});
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
