// What a system does with other hosts: those that it leads, and the one that leads it (docs/hosts.md).
#include <fmt/format.h>

#include <algorithm>

#include "fiona/error.hpp"
#include "link_keys.hpp"
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

std::string System::host_of_instance(const std::string& name) const {
  const auto* one = model_.find(name);
  return one ? host_of(one->group) : "";
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

/// A group whose host is silent and may come back; null otherwise.
RemoteGroup* System::silent_group(const std::string& group) {
  const auto found = groups_.find(group);
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

/// The processes that a wire goes through, from its client to its provider. One connection carries all that goes between
/// two hosts; their groups reach it through their host's own process.
std::vector<Group*> System::way(Group& client, Group& provider) {
  const std::string from = host_of(client.name());
  const std::string to = host_of(provider.name());
  std::vector<Group*> path{&client};
  const auto go_by = [&path](Group& next) {
    if (path.back() != &next) path.push_back(&next);
  };
  if (from != to) go_by(main_of(from));
  if (from != to && !from.empty() && !to.empty()) go_by(main_of(""));
  if (from != to) go_by(main_of(to));
  go_by(provider);
  return path;
}

/// How the process `at` knows who opens a link to it.
std::string System::known_as(Group& who, Group& at) {
  const std::string host = host_of(who.name());
  if (host == host_of(at.name())) return who.link_name();
  return host_of(at.name()).empty() ? std::string(kLeader) + host : std::string(kLeader);
}

/// Where `at` finds `to`, and what opens the link. A host that is led knows that of its own processes itself.
Links::Endpoint System::endpoint_for(Group& at, Group& to) {
  const std::string host = host_of(to.name());
  if (host != host_of(at.name())) return {known_as(to, at), "", ""};
  if (!host.empty()) return {to.endpoint(), "", ""};
  return {to.endpoint(), at.link_name(), link_key(to.link_key(), at.link_name())};
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

bool System::crosses(const Model::PortKey& client, const Wire& wire, const std::string& host) {
  const std::string from = host_of_instance(client.first);
  const std::string to = host_of_instance(wire.provider.instance());
  return from != to && (from == host || to == host);
}

void System::on_host_lost(const std::string& host, const std::string& reason, bool for_good) {
  for (const std::string& name : model_.names()) {
    if (host_of_instance(name) != host) continue;
    const auto [lost, is_new] = lost_.emplace(name, Lost{});
    if (!is_new && !lost->second.away) continue;
    lost->second = {reason, !for_good};
    if (is_new) tell_failed(name, reason);
  }
  for (auto& [key, wire] : wires_) {
    const bool inside = host_of_instance(key.first) == host;
    if (wire.id != 0 && (crosses(key, wire, host) || (for_good && inside))) wire.reason = reason;
  }
  if (!for_good) return;
  for (auto* group : groups_of(host)) {
    group->end(reason);
    group->take_owed();
    end_taps(group->name(), reason);
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
  for (const std::string& name : model_.names()) {
    const auto lost = lost_.find(name);
    if (model_.instance(name).group != group.name() || lost == lost_.end() || !lost->second.away) continue;
    if (there.contains(name)) {
      lost_.erase(lost);
    } else {
      lost->second = {fmt::format("it was unloaded on host '{}'", group.host()), false};
    }
  }
  for (const auto& name : there) {
    const auto* known = model_.find(name);
    if (known && known->group == group.name()) continue;
    // Made by a request whose answer was lost.
    wire::GroupRequest destroy;
    destroy.mutable_destroy()->set_instance(name);
    group.owe(std::move(destroy));
  }
  for (auto& request : group.take_owed()) group.request(std::move(request));
}

void System::resume_wires(const std::string& host) {
  for (auto& [key, wire] : wires_) {
    const control::PortName client = port_of(key);
    const std::string provider = wire.provider.instance();
    const bool touched = wire.id != 0 ? crosses(key, wire, host) : host_of_instance(key.first) == host || host_of_instance(provider) == host;
    if (wire.reason.empty() || !touched || lost_.contains(key.first) || lost_.contains(provider)) continue;
    try {
      if (!model_.find(provider)) {
        await_provider(client, wire, model_);
        continue;
      }
      control::Done ignored;
      wire = connect(client, wire.provider, model_, wire.id, ignored, wire.id != 0);
    } catch (const Error& error) {
      wire.reason = error.text().what;
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
    for (const std::string& name : model_.names()) {
      if (model_.instance(name).group != group->name()) continue;
      lost_[name] = {change.reason, false};
      tell_failed(name, change.reason);
    }
    end_taps(group->name(), change.reason);
    for (auto& [key, wire] : wires_) {
      const auto* provider = model_.find(wire.provider.instance());
      const bool client_gone = model_.instance(key.first).group == group->name();
      const bool provider_gone = provider && provider->group == group->name();
      if (wire.id == 0 || (!client_gone && !provider_gone)) continue;
      wire.reason = change.reason;
      if (client_gone && provider && !provider_gone) cut_at(provider->group, wire.id, change.reason);
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
        if (leader) model_.set_leader(change.host);
        said.push_back(leader ? fmt::format("host '{}' leads this one", change.host) : on_host_joined(change));
        break;
      case HostChange::What::Lost:
        leader ? model_.set_leader("") : on_host_lost(change.host, change.reason, false);
        said.push_back(change.reason);
        break;
      case HostChange::What::Left:
        leader->leave(change.session);
        model_.set_leader("");
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
  return host_of_instance(client) != host_of_instance(wire.provider.instance()) ? "tcp" : "ipc";
}

void System::add_hosts(control::System& all) {
  if (!hosts_) return;
  all.set_key(hosts_->key());
  all.set_listens(listens());
  all.set_refused_hosts(hosts_->refused());
  const auto count = [this](const auto& fits) {
    const auto names = model_.names();
    return static_cast<std::uint64_t>(
        std::count_if(names.begin(), names.end(), [&](const std::string& name) { return fits(model_.instance(name)); }));
  };
  for (const auto& peer : hosts_->peers()) {
    auto& status = *all.add_hosts() = peer->status();
    status.set_instances(count([&](const Model::Instance& one) { return host_of(one.group) == peer->peer().name; }));
  }
  if (!hosts_->leader()) return;
  if (const auto leader = hosts_->leader()->status()) {
    auto& status = *all.add_hosts() = *leader;
    status.set_instances(count([](const Model::Instance& one) { return one.led; }));
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
      reply = obey_in_group(order.request(), *found->second);
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
  if (endpoint == kLeader) return {endpoint, "", ""};
  Group& to = led_group(endpoint);
  return {to.endpoint(), at.link_name(), link_key(to.link_key(), at.link_name())};
}

wire::GroupMessage System::obey_in_group(wire::GroupRequest request, Group& group) {
  const auto set_peer = [this](auto& message) {
    if (message.peer() != kLeader) message.set_peer(led_group(message.peer()).link_name());
  };
  if (request.has_wire_provide()) set_peer(*request.mutable_wire_provide());
  if (request.has_wire_relay()) set_peer(*request.mutable_wire_relay());
  const auto set_way = [&](auto& message) { set_endpoint(message, led_endpoint(message.endpoint(), group)); };
  if (request.has_wire_require()) set_way(*request.mutable_wire_require());
  if (request.has_wire_relay()) set_way(*request.mutable_wire_relay());
  if (!request.has_destroy()) return group.request(std::move(request));
  wire::GroupMessage reply;
  reply.mutable_done()->set_note(drop_led(request.destroy().instance()));
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
  throw Error(ErrorCode::NotFound, fmt::format("the leader has no instance '{}' on host '{}'", name, options_.name));
}

/// A leader reaches what is his: his instances, his wires, his taps.
void System::check_order(const wire::GroupRequest& request) {
  using Request = wire::GroupRequest;
  const auto number = [](std::uint64_t one) {
    if (one >= kOwnNumbers) throw Error(ErrorCode::NotAllowed, "this number belongs to the host that is led");
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
    case Request::kWireRelay: return number(request.wire_relay().wire());
    case Request::kCreate:
    case Request::kStatus: return;
    case Request::kWelcome:
    case Request::kPeerLost:
      throw Error(ErrorCode::NotAllowed, "a host tells its processes about their links itself");
    case Request::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, "the request is empty, or newer than this program");
}

/// Of those here. A leader names no sockets.
Group& System::led_group(const std::string& endpoint) {
  const auto found = endpoint.starts_with(kGroup) ? groups_.find(endpoint.substr(kGroup.size())) : groups_.end();
  if (found != groups_.end() && found->second->alive()) return *found->second;
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
  const std::string library = (options_.plugins / ("lib" + create.plugin().substr(local ? kLocal.size() : 0) + ".so")).string();
  const auto [package, component] = packages_.find((local ? library : create.plugin()) + "/" + create.component());
  const bool same = package->name == create.plugin() && package->version == create.version();
  if (!same || package->interface.SerializeAsString() != create.interface().SerializeAsString()) {
    throw Error(ErrorCode::DependencyConflict, {.what = same ? fmt::format("host '{}' has another build of {} {}", options_.name, package->name, package->version)
                                                             : fmt::format("host '{}' has {} {}", options_.name, package->name, package->version),
                                                .expected = fmt::format("{} {}, as on the host that leads", create.plugin(), create.version()),
                                                .next = fmt::format("on host '{}': fiona market install {}@{}", options_.name, create.plugin(), create.version())});
  }
  const std::string& name = create.instance();
  Model next = model_;
  next.take(name, {create.plugin(), package, component, group_name, create.mode(), create.mode(), nullptr, 0, true});
  control::Load load_it;
  *load_it.mutable_parameters() = create.parameters();
  load_it.set_mode(create.mode());
  note_led(name, true);  // from its first word on
  try {
    this->create(group(group_name), name, next.instance(name), load_it);
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
  control::Unload unload_it;
  unload_it.set_instance(name);
  const control::Done done = unload(unload_it);
  note_led(name, false);
  model_.drop(name);
  return done.note();
}

void System::note_led(const std::string& name, bool led) {
  const std::lock_guard lock(led_mutex_);
  led ? static_cast<void>(led_names_.insert(name)) : static_cast<void>(led_names_.erase(name));
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
