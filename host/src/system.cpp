#include "system.hpp"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <fstream>
#include <iostream>
#include <sstream>

#include "fiona/contract.hpp"
#include "fiona/error.hpp"
#include "fiona/push.hpp"
#include "fiona/query.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kMain = "main";
/// Of a change of mode that names none; and how much longer than the instance itself the host waits for an end.
constexpr double kModeDeadline_ms = 10'000;
constexpr double kGrace_ms = 1'000;

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

const ComponentInterface& component_of(const Interface& interface, const std::string& name) {
  const auto& all = interface.components();
  return *std::find_if(all.begin(), all.end(), [&](const ComponentInterface& c) { return c.name() == name; });
}

/// "LocationProvider (push timed, CommLocation)".
std::string service_text(const google::protobuf::ServiceDescriptor* service, const std::string& full_name) {
  if (!service) return last_part(full_name);
  const ServiceInfo info(*service);
  const std::string answer = info.answer() ? " -> " + info.answer()->name() : "";
  return fmt::format("{} ({}, {}{})", service->name(), to_string(info.pattern()), info.object().name(), answer);
}

/// A name that can be typed and has no meaning of its own.
void require_name(const std::string& name, std::string_view kind) {
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_'; };
  const bool good = !name.empty() && name.size() <= 64 && std::isalpha(static_cast<unsigned char>(name[0])) &&
                    std::all_of(name.begin(), name.end(), allowed) && name != "host";
  if (good) return;
  throw Error(ErrorCode::Usage, {.what = fmt::format("'{}' is no name for {}", name, kind),
                                 .expected = "a letter, then letters, digits, '-' and '_', at most 64; not 'host'"});
}

}  // namespace

System::System(Options options, OnEvent on_event)
    : options_(std::move(options)), on_event_(std::move(on_event)), store_(options_.store) {
  use_clock(std::make_unique<SystemClock>());
  if (!options_.hosts.any()) return;
  if (!options_.hosts.listen.empty()) next_wire_ = next_tap_ = next_work_ = kOwnNumbers;
  auto& main = dynamic_cast<MainGroup&>(*groups_.at(std::string(kMain)));
  hosts_ = std::make_unique<HostLinks>(
      options_.hosts, options_.name, *pool_, *clock_, main.links(), [this](wire::GroupMessage event) { deliver(event); },
      [](const std::string& text) { std::cerr << text << "\n"; });
}

System::~System() { end_threads(); }

/// Groups, then the clock's thread, which posts, then the pool's; the clock last: a strand tells it that it is idle
/// after its last job has ended.
void System::end_threads() {
  if (hosts_) hosts_->stop();
  groups_.clear();
  if (waits_) waits_->stop();
  if (clock_) clock_->stop();
  hosts_.reset();
  pool_.reset();
  waits_.reset();
}

void System::use_clock(std::unique_ptr<Clock> clock) {
  end_threads();
  clock_ = std::move(clock);
  pool_ = std::make_unique<Pool>(options_.threads);
  waits_ = std::make_unique<Waits>(*clock_, *pool_);
  const std::string endpoint = "ipc://" + (options_.directory / (options_.name + ".main.ipc")).string();
  groups_[std::string(kMain)] =
      std::make_unique<MainGroup>(*pool_, *clock_, libraries_, endpoint, [this](wire::GroupMessage event) { deliver(event); });
}

/// Waits first, on the thread where it happened; then whoever else listens.
void System::deliver(const wire::GroupMessage& event) {
  waits_->on_event(event, types_);
  const bool led = tell_leader(event);
  if (event.has_run_ended() && !led) waits_->end_run(event.run_ended().exit_code(), event.run_ended().reason());
  on_event_(event);
}

// ---- finding things -------------------------------------------------------------------------------------------

std::string System::choose_component(const Interface& interface, const std::string& plugin, const std::string& wanted) {
  std::vector<std::string> names;
  for (const auto& component : interface.components()) names.push_back(component.name());
  const std::string short_name = plugin.substr(plugin.rfind('/') + 1);
  const std::string choice = !wanted.empty() ? wanted : names.size() == 1 ? names.front() : short_name;
  if (std::find(names.begin(), names.end(), choice) != names.end()) return choice;
  throw Error(ErrorCode::NotFound, {.what = fmt::format("plugin '{}' has no component '{}'", plugin, choice),
                                    .expected = fmt::format("one of {}", fmt::join(names, ", ")),
                                    .next = fmt::format("load {}/{}", plugin, names.empty() ? "COMPONENT" : names.front()),
                                    .near = nearest_names(choice, names)});
}

/// A library as its author builds it: "DIR/libNAME.so" beside "DIR/NAME.interface.textproto".
System::Installed System::find_library(const std::filesystem::path& library) const {
  std::string name = library.stem().string();
  if (name.starts_with("lib")) name = name.substr(3);
  const auto description = library.parent_path() / (name + ".interface.textproto");
  Installed found{"local/" + name, "0", std::filesystem::absolute(library), {}, {}, {}, nullptr};
  std::ifstream file(description);
  std::stringstream text;
  text << file.rdbuf();
  if (!file || !google::protobuf::TextFormat::ParseFromString(text.str(), &found.interface)) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("plugin '{}' has no readable interface beside it", name),
                                      .where = description.string(),
                                      .next = "fiona_add_plugin() in its CMakeLists.txt writes it, or: fiona-describe " + library.string()});
  }
  const auto share = library.parent_path() / (name + ".share");
  if (std::filesystem::is_directory(share)) found.share = share;
  return found;
}

System::Installed System::find_plugin(const std::string& text) const {
  if (const std::size_t ending = text.find(".so"); ending != std::string::npos) {
    // "DIR/libNAME.so" or, with several components, "DIR/libNAME.so/component".
    Installed found = find_library(text.substr(0, ending + 3));
    found.component = choose_component(found.interface, found.name, text.substr(std::min(text.size(), ending + 4)));
    return found;
  }
  // "publisher/name" and "name/component" look alike: an installed package of the whole text wins.
  std::string plugin = text;
  std::string component;
  const auto known = store_.installed();
  const auto matches = [&](const std::string& wanted) {
    return std::any_of(known.begin(), known.end(),
                       [&](const auto& p) { return p.name() == wanted || p.manifest.name() == wanted; });
  };
  const std::size_t slash = text.rfind('/');
  if (!matches(text) && slash != std::string::npos && matches(text.substr(0, slash))) {
    plugin = text.substr(0, slash);
    component = text.substr(slash + 1);
  }
  const auto package = store_.find(plugin);
  Installed found{package.name(), package.manifest.version(), package.library, package.share, package.interface(), {},
                  std::make_shared<marketplace::PackageHold>(store_.hold(package))};
  found.component = choose_component(found.interface, found.name, component);
  return found;
}

std::vector<std::string> System::instance_names() const {
  std::vector<std::string> names;
  for (const auto& [name, one] : instances_) names.push_back(name);
  return names;
}

System::Instance& System::instance(const std::string& name) {
  const auto found = instances_.find(name);
  if (found != instances_.end()) return found->second;
  throw Error(ErrorCode::NotFound, {.what = "there is no instance '" + name + "'",
                                    .next = "ls",
                                    .near = nearest_names(name, instance_names())});
}

System::PortRef System::port(const control::PortName& name, Direction direction) {
  const Instance& owner = instance(name.instance());
  const auto& component = component_of(owner.package.interface, owner.package.component);
  std::vector<std::string> fitting;
  for (const auto& one : component.ports()) {
    if (one.direction() != direction) {
      if (one.name() != name.port()) continue;
      throw Error(ErrorCode::Usage,
                  {.what = fmt::format("{} {} {}", text_of(name), one.direction() == PROVIDES ? "provides" : "requires",
                                       last_part(one.service())),
                   .expected = direction == PROVIDES ? "a port that provides" : "a port that requires",
                   .next = "show " + name.instance()});
    }
    if (one.name() == name.port()) return {&owner, &one};
    fitting.push_back(one.name());
  }
  throw Error(ErrorCode::NotFound, {.what = fmt::format("'{}' has no port '{}' that {}", name.instance(), name.port(),
                                                        direction == PROVIDES ? "provides" : "requires"),
                                    .expected = fitting.empty() ? "nothing: it has none" : fmt::format("one of {}", fmt::join(fitting, ", ")),
                                    .next = "show " + name.instance(),
                                    .near = nearest_names(name.port(), fitting)});
}

Group& System::group(const std::string& name) {
  const std::string wanted = name.empty() ? std::string(kMain) : name;
  const auto found = groups_.find(wanted);
  if (found != groups_.end() && found->second->alive()) return *found->second;
  if (Group* remote = remote_group(wanted)) return *remote;
  require_name(wanted, "a group");
  const auto* clock = dynamic_cast<const SystemClock*>(clock_.get());
  if (!clock) {
    throw Error(ErrorCode::NotAllowed, {.what = "a virtual clock drives one process: groups need the system clock",
                                        .next = "load without 'in " + wanted + "', or: set host clock=system"});
  }
  const std::string endpoint = "ipc://" + (options_.directory / fmt::format("{}.{}.{}.ipc", options_.name, wanted, next_order_++)).string();
  auto made = std::make_unique<ChildGroup>(wanted, endpoint, *clock, [this](wire::GroupMessage event) { deliver(event); });
  return *(groups_[wanted] = std::move(made));
}

// ---- instances ------------------------------------------------------------------------------------------------

std::string System::load(const control::Load& request) { return create(find_plugin(request.plugin()), request, false); }

std::string System::create(Installed package, const control::Load& request, bool led) {
  const std::string name = request.instance().empty() ? package.component : request.instance();
  require_name(name, "an instance");
  if (instances_.contains(name)) {
    throw Error(ErrorCode::Usage, {.what = "there is an instance '" + name + "' already",
                                   .found = instances_.at(name).package.name,
                                   .next = fmt::format("load {} as OTHER-NAME, or: unload {}", request.plugin(), name)});
  }
  auto types = Types::read(package.name, package.interface);
  Group& target = group(request.group());
  wire::GroupRequest create;
  auto& c = *create.mutable_create();
  c.set_instance(name);
  c.set_plugin(package.name);
  c.set_version(package.version);
  c.set_library(package.library.string());
  c.set_share(package.share.string());
  c.set_component(package.component);
  *c.mutable_interface() = package.interface;
  *c.mutable_parameters() = request.parameters();
  c.set_mode(request.mode());
  if (led) note_led(name, true);
  try {
    target.request(std::move(create));
  } catch (...) {
    note_led(name, false);
    retire_if_empty(target);
    throw;
  }
  types_.add(package.name, std::move(types));
  const std::string note = fmt::format("{} {} as {}{}", package.name, package.version, name,
                                       target.name() == kMain ? "" : " in " + target.name());
  instances_.emplace(name, Instance{std::move(package), target.name(), {}, next_order_++, false, led});
  return note;
}

/// A process that was started for an instance that could not be made has no purpose.
void System::retire_if_empty(const Group& target) {
  const std::string name = target.name();
  const bool used = std::any_of(instances_.begin(), instances_.end(),
                                [&](const auto& entry) { return entry.second.group == name; });
  if (!used && name != kMain) groups_.erase(name);
}

std::string System::unload(const control::Unload& request) {
  Instance& leaving = instance(request.instance());
  refuse_if_led(request.instance());
  std::vector<std::string> dependents;
  for (auto it = wires_.begin(); it != wires_.end();) {
    const bool is_provider = it->second.provider.instance() == request.instance();
    if (!is_provider && it->first.first != request.instance()) {
      ++it;
      continue;
    }
    control::PortName client;
    client.set_instance(it->first.first);
    client.set_port(it->first.second);
    if (is_provider && it->first.first != request.instance()) dependents.push_back(text_of(client));
    disconnect(client, it->second, request.instance() + " was unloaded");
    it = wires_.erase(it);
  }
  std::string note = "unloaded " + request.instance();
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(request.instance());
  if (RemoteGroup* silent = silent_group(leaving)) {
    silent->owe(std::move(destroy));
    note += ", which its host will do when it is back";
  } else if (leaving.lost.empty()) {
    const auto reply = group(leaving.group).request(std::move(destroy));
    if (!reply.done().note().empty() && host_of(leaving.group).empty()) note += "; " + reply.done().note();
  }
  note_led(request.instance(), false);
  instances_.erase(request.instance());
  if (!dependents.empty()) note += fmt::format("; now unwired: {}", fmt::join(dependents, ", "));
  return note;
}

void System::state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer) {
  const std::string name = request.instance();
  Group& target = group(instance(name).group);
  refuse_if_led(name);
  const std::uint64_t change = next_work_++;
  const double within_ms = request.within_ms() > 0 ? request.within_ms() : kModeDeadline_ms;
  const auto begin = [&] {
    wire::GroupRequest set;
    set.mutable_set_mode()->set_instance(name);
    set.mutable_set_mode()->set_mode(request.mode());
    set.mutable_set_mode()->set_change(change);
    set.mutable_set_mode()->set_within_ms(within_ms);
    target.request(std::move(set));
  };
  const auto end_of = [change, done = name + " is " + request.mode()](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply;
    if (!event.has_mode_set() || event.mode_set().change() != change) return reply;
    reply.emplace().mutable_done()->set_note(done);
    if (event.mode_set().has_failure()) *reply->mutable_failure() = event.mode_set().failure();
    return reply;
  };
  // The instance itself withdraws a change that is blocked; this is for one that hangs.
  const auto expired = failure_reply(
      ErrorCode::Unreachable, {.what = "'" + name + "' did not change its mode in time: a handler still runs, or it has ended",
                               .where = name,
                               .next = "show " + name});
  waits_->work(owner, id, within_ms + kGrace_ms, begin, end_of, expired, std::move(answer));
}

/// What a call by hand reaches: the port or trigger that is named, of a required port the provider at its wire's end.
control::PortName System::callee(const control::PortName& name) {
  const Instance& owner = instance(name.instance());
  const auto& component = component_of(owner.package.interface, owner.package.component);
  for (const auto& one : component.ports()) {
    if (one.name() != name.port() || one.direction() != REQUIRES) continue;
    const auto wire = wires_.find({name.instance(), name.port()});
    if (wire != wires_.end()) return wire->second.provider;
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: there is nobody to call", .next = "spots"});
  }
  return name;
}

void System::call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer) {
  const control::PortName name = callee(request.target());
  Group& target = group(instance(name.instance()).group);
  const std::uint64_t run = next_work_++;
  const double within_ms = request.within_ms() > 0 ? request.within_ms() : 1e3 * to_seconds(kDefaultDeadline);
  const TimePoint begun = clock_->now();
  const auto begin = [&] {
    wire::GroupRequest call;
    call.mutable_call()->set_run(run);
    *call.mutable_call()->mutable_target() = name;
    *call.mutable_call()->mutable_arguments() = request.arguments();
    call.mutable_call()->set_within_ms(within_ms);
    target.request(std::move(call));
  };
  const auto end_of = [this, run, begun](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply;
    if (!event.has_call_ended() || event.call_ended().run() != run) return reply;
    auto& called = *reply.emplace().mutable_called();
    called.set_run(run);
    called.set_outcome(std::string(to_string(static_cast<Outcome>(event.call_ended().outcome()))));
    called.set_reason(event.call_ended().reason());
    called.set_after_ms(1e3 * to_seconds(clock_->now() - begun));
    if (event.call_ended().type().empty()) return reply;
    called.mutable_result()->set_type(event.call_ended().type());
    called.mutable_result()->set_object(event.call_ended().object());
    if (const auto object = types_.make(event.call_ended().type())) {
      *called.mutable_result()->mutable_files() = Types::files_of(*object->GetDescriptor()->file());
    }
    return reply;
  };
  control::Reply expired;
  expired.mutable_called()->set_run(run);
  expired.mutable_called()->set_outcome(std::string(to_string(Outcome::Timeout)));
  expired.mutable_called()->set_reason("the instance does not answer");
  waits_->work(owner, id, within_ms + kGrace_ms, begin, end_of, expired, std::move(answer));
}

std::string System::set(const control::Set& request) {
  if (request.instance() == "host") {
    set_host(request);
    return "";
  }
  const Instance& target = instance(request.instance());
  refuse_if_led(request.instance());
  wire::GroupRequest change;
  change.mutable_set_parameters()->set_instance(request.instance());
  *change.mutable_set_parameters()->mutable_parameters() = request.parameters();
  group(target.group).request(std::move(change));
  return "";
}

/// The host's own parameters: which clock the system has, and how fast a virtual one may run.
void System::set_host(const control::Set& request) {
  std::string kind = dynamic_cast<VirtualClock*>(clock_.get()) ? "virtual" : "system";
  std::optional<double> speed;
  for (const auto& argument : request.parameters()) {
    const auto& value = argument.value();
    const bool number = value.kind_case() == control::Value::kNumber || value.kind_case() == control::Value::kInteger;
    if (argument.name() == "clock" && (value.text() == "virtual" || value.text() == "system")) {
      kind = value.text();
    } else if (argument.name() == "speed" && number) {
      speed = value.kind_case() == control::Value::kNumber ? value.number() : static_cast<double>(value.integer());
    } else {
      throw Error(ErrorCode::Usage, {.what = "the host does not take '" + argument.name() + "' so",
                                     .expected = "clock=system, clock=virtual, speed=TIMES-REAL-TIME (0: as fast as it goes)",
                                     .next = "get host"});
    }
  }
  if (speed && (*speed < 0 || *speed > 1e6)) {
    throw Error(ErrorCode::Usage, {.what = "the speed is out of range", .expected = "0 .. 1000000", .found = fmt::format("{}", *speed)});
  }
  if (speed && kind == "system") {
    throw Error(ErrorCode::Usage, {.what = "the system clock has one speed", .next = "set host clock=virtual speed=…"});
  }
  const bool is_virtual = dynamic_cast<VirtualClock*>(clock_.get()) != nullptr;
  if (kind == "virtual" && hosts_) {
    throw Error(ErrorCode::NotAllowed, {.what = "a virtual clock drives one process, and this host works with others over tcp",
                                        .next = "start it without --listen and --peer"});
  }
  if ((kind == "virtual") != is_virtual) {
    if (!instances_.empty()) {
      throw Error(ErrorCode::NotAllowed, {.what = fmt::format("{} instances live by the present clock", instances_.size()),
                                          .next = "set host clock before the first load"});
    }
    use_clock(kind == "virtual" ? std::unique_ptr<Clock>(std::make_unique<VirtualClock>()) : std::make_unique<SystemClock>());
  }
  if (speed) dynamic_cast<VirtualClock&>(*clock_).set_speed(*speed);
}

std::pair<bool, std::string> System::has_mode(const std::string& name, const std::string& mode) {
  instance(name);
  const auto snapshot_now = snapshot();
  for (const auto& one : snapshot_now.instances()) {
    if (one.name() == name) return {one.mode() == mode, one.mode()};
  }
  return {false, ""};
}

// ---- wires ----------------------------------------------------------------------------------------------------

std::string System::providers_of(const std::string& service) const {
  std::vector<std::string> names;
  for (const auto& [name, one] : instances_) {
    for (const auto& p : component_of(one.package.interface, one.package.component).ports()) {
      if (p.direction() == PROVIDES && p.service() == service) names.push_back(name + "." + p.name());
    }
  }
  return fmt::format("{}", fmt::join(names, ", "));
}

void System::check_contract(const control::PortName& client, const control::PortName& provider) {
  const PortRef required = port(client, REQUIRES);
  const PortRef provided = port(provider, PROVIDES);
  const auto* a = types_.service(required.instance->package.name, required.port->service());
  const auto* b = types_.service(provided.instance->package.name, provided.port->service());
  const auto difference = a && b ? contract_difference(*a, *b) : std::optional<std::string>("a service is unknown to the host");
  if (!difference) return;
  const std::string fitting = providers_of(required.port->service());
  const std::string name = last_part(required.port->service());
  const bool same_service = required.port->service() == provided.port->service();
  throw Error(ErrorCode::WiringInvalid,
              {.what = fmt::format("{} requires {}; {} provides {}", text_of(client), service_text(a, required.port->service()),
                                   text_of(provider), service_text(b, provided.port->service())),
               .found = same_service ? *difference : "",
               .next = fitting.empty() ? "nothing here provides " + name + ": spots shows who could"
                                       : "these provide " + name + ": " + fitting});
}

/// Make before break: the client's side lets go of the wire `replaces` once the new one is open; if it does not open,
/// all is as before.
System::Wire System::connect(const control::PortName& client, const control::PortName& provider, std::uint32_t prescale,
                             std::uint64_t replaces, bool resumes) {
  Group& client_group = group(instance(client.instance()).group);
  Group& provider_group = group(instance(provider.instance()).group);
  Wire wire{next_wire_++, provider, prescale, &client_group == &provider_group, {}};
  wire::GroupRequest request;
  if (wire.local) {
    auto& local = *request.mutable_wire_local();
    local.set_wire(wire.id);
    *local.mutable_client() = client;
    *local.mutable_provider() = provider;
    local.set_prescale(prescale);
    local.set_replaces(replaces);
    client_group.request(std::move(request));
    return wire;
  }
  const std::string token = os::random_token();
  auto& provide = *request.mutable_wire_provide();
  provide.set_wire(wire.id);
  provide.set_token(token);
  *provide.mutable_provider() = provider;
  provide.set_prescale(prescale);
  provider_group.request(request);
  auto& require = *request.mutable_wire_require();
  require.set_wire(wire.id);
  require.set_token(token);
  *require.mutable_client() = client;
  *require.mutable_provider() = provider;
  require.set_replaces(replaces);
  if (resumes) require.set_resumes_every(prescale);
  try {
    require.set_endpoint(route(wire, token, client_group, provider_group));
    client_group.request(std::move(request));
  } catch (...) {
    for (const auto& relay : wire.relays) cut_at(relay, wire.id, "the wire did not open");
    cut_at(provider_group.name(), wire.id, "the wire did not open");
    throw;
  }
  return wire;
}

void System::disconnect(const control::PortName& client, const Wire& wire, const std::string& reason) {
  // The client first: told by its host it is unwired; told by the provider it would be lost.
  for (const auto& name : {client.instance(), wire.provider.instance()}) {
    const auto found = instances_.find(name);
    if (found != instances_.end()) cut_at(found->second.group, wire.id, reason);
    if (wire.local) return;
  }
  for (const auto& relay : wire.relays) cut_at(relay, wire.id, reason);
}

std::string System::wire(const control::Wire& request) {
  check_contract(request.client(), request.provider());
  refuse_if_led(request.client().instance());
  refuse_if_led(request.provider().instance());
  const auto key = std::pair(request.client().instance(), request.client().port());
  const auto old = wires_.find(key);
  const std::uint32_t prescale = std::max(1U, request.prescale());
  const bool unchanged = old != wires_.end() && old->second.lost.empty() && old->second.prescale == prescale &&
                         text_of(old->second.provider) == text_of(request.provider());
  if (unchanged) return "wired so already";
  wires_[key] = connect(request.client(), request.provider(), prescale, old == wires_.end() ? 0 : old->second.id);
  return text_of(request.client()) + " to " + text_of(request.provider());
}

std::string System::unwire(const control::Unwire& request) {
  port(request.client(), REQUIRES);
  refuse_if_led(request.client().instance());
  const auto found = wires_.find({request.client().instance(), request.client().port()});
  if (found == wires_.end()) {
    throw Error(ErrorCode::NotFound, {.what = text_of(request.client()) + " has no wire", .where = text_of(request.client()), .next = "ls wires"});
  }
  disconnect(request.client(), found->second, "unwired");
  wires_.erase(found);
  return text_of(request.client()) + " unwired";
}

void System::on_wire_lost(std::uint64_t id, const std::string& reason) {
  for (auto& [client, wire] : wires_) {
    if (wire.id == id) wire.lost = reason;
  }
}

// ---- watching -------------------------------------------------------------------------------------------------

std::uint64_t System::tap(const control::PortName& name) {
  control::PortName target = name;
  const auto wire = wires_.find({name.instance(), name.port()});
  if (wire != wires_.end()) target = wire->second.provider;
  const Instance& owner = instance(target.instance());
  const auto& ports = component_of(owner.package.interface, owner.package.component).ports();
  const bool unwired = std::any_of(ports.begin(), ports.end(), [&](const PortInterface& p) {
    return p.name() == target.port() && p.direction() == REQUIRES;
  });
  if (unwired) {
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: nothing comes to it", .next = "spots"});
  }
  port(target, PROVIDES);
  wire::GroupRequest request;
  const std::uint64_t id = next_tap_++;
  request.mutable_tap()->set_tap(id);
  *request.mutable_tap()->mutable_port() = target;
  taps_.emplace(id, owner.group);
  try {
    group(owner.group).request(std::move(request));
  } catch (...) {
    taps_.erase(id);
    throw;
  }
  return id;
}

void System::untap(std::uint64_t id) {
  const auto found = taps_.find(id);
  if (found == taps_.end()) return;
  const auto owner = groups_.find(found->second);
  taps_.erase(found);
  if (owner == groups_.end() || !owner->second->alive()) return;
  wire::GroupRequest request;
  request.mutable_untap()->set_tap(id);
  owner->second->request(std::move(request));
}

// ---- groups ---------------------------------------------------------------------------------------------------

std::vector<ChildGroup*> System::child_groups() {
  std::vector<ChildGroup*> children;
  for (auto& [name, one] : groups_) {
    auto* child = dynamic_cast<ChildGroup*>(one.get());
    if (!child) continue;
    // A request may have found the end of the process before its socket was polled.
    if (!child->alive()) lose(*child);
    if (child->alive()) children.push_back(child);
  }
  return children;
}

void System::serve_group(ChildGroup& group) {
  if (!group.serve()) lose(group);
}

void System::lose(ChildGroup& gone) {
  if (!noted_dead_.insert(gone.endpoint()).second) return;
  const std::string reason = "group '" + gone.name() + "' " + gone.end();
  for (auto& [name, one] : groups_) {
    if (one.get() != &gone && one->alive()) one->peer_lost(gone.endpoint(), reason);
  }
  for (auto& [name, one] : instances_) {
    if (one.group != gone.name() || !one.lost.empty()) continue;
    one.lost = reason;
    wire::GroupMessage event;
    event.mutable_mode_changed()->set_instance(name);
    event.mutable_mode_changed()->set_mode(std::string(kModeFailed));
    event.mutable_mode_changed()->set_reason(reason);
    deliver(event);
  }
  for (auto& [client, wire] : wires_) {
    const bool client_gone = instances_.at(client.first).group == gone.name();
    const bool provider_gone = instances_.at(wire.provider.instance()).group == gone.name();
    if (client_gone || provider_gone) wire.lost = reason;
    if (!client_gone || provider_gone) continue;
    // The provider lives on and must not go on sending to nobody.
    cut_at(instances_.at(wire.provider.instance()).group, wire.id, reason);
  }
  wire::GroupMessage event;
  event.mutable_group_ended()->set_group(gone.name());
  event.mutable_group_ended()->set_reason(reason);
  tell_leader(event);
  // What was the leader's there is told; the names are his to use again.
  for (auto it = instances_.begin(); it != instances_.end();) {
    const bool his = it->second.led && it->second.group == gone.name();
    if (his) note_led(it->first, false);
    it = his ? instances_.erase(it) : std::next(it);
  }
}

// ---- snapshot -------------------------------------------------------------------------------------------------

control::InstanceStatus System::status_of_lost(const std::string& name, const Instance& one) const {
  control::InstanceStatus status;
  status.set_name(name);
  status.set_plugin(one.package.name);
  status.set_component(one.package.component);
  status.set_version(one.package.version);
  status.set_mode(std::string(kModeFailed));
  status.set_reason(one.lost.empty() ? "its process does not answer" : one.lost);
  for (const auto& declared : component_of(one.package.interface, one.package.component).ports()) {
    auto& p = *status.add_ports();
    p.set_name(declared.name());
    p.set_direction(declared.direction());
    p.set_service(declared.service());
    p.set_optional(declared.optional());
    p.set_doc(declared.doc());
    p.set_age_ms(-1);
    if (declared.direction() == REQUIRES) p.set_connection(control::LOST);
  }
  return status;
}

/// What only the whole system knows: groups, wires seen from both ends.
void System::complete_status(control::InstanceStatus& status) const {
  const Instance& one = instances_.at(status.name());
  status.set_group(one.group);
  for (auto& p : *status.mutable_ports()) {
    for (const auto& [client, wire] : wires_) {
      if (client.first == status.name() && client.second == p.name()) {
        *p.mutable_peer() = wire.provider;
        p.set_prescale(wire.prescale);
        p.set_transport(transport(status.name(), wire));
        if (!wire.lost.empty()) p.set_connection(control::LOST);
        if (!wire.lost.empty()) p.set_reason(wire.lost);
      }
      if (wire.provider.instance() == status.name() && wire.provider.port() == p.name()) {
        auto& user = *p.add_clients();
        user.set_instance(client.first);
        user.set_port(client.second);
      }
    }
  }
}

/// The instances of a group; none when the process turns out to be gone, which is then noted.
std::vector<control::InstanceStatus> System::status_of_group(Group& target) {
  std::vector<control::InstanceStatus> found;
  if (!target.alive()) return found;
  wire::GroupRequest request;
  request.mutable_status();
  try {
    const auto reply = target.request(std::move(request));
    std::copy_if(reply.status().instances().begin(), reply.status().instances().end(), std::back_inserter(found),
                 [this](const auto& one) { return instances_.contains(one.name()); });
  } catch (const Error&) {
    if (dynamic_cast<RemoteGroup*>(&target)) return found;  // its host will tell, or fall silent
    if (target.alive()) throw;
    if (auto* child = dynamic_cast<ChildGroup*>(&target)) lose(*child);
  }
  return found;
}

control::System System::snapshot() {
  child_groups();  // notes those that a request found dead
  control::System all;
  all.set_host(options_.name);
  all.set_version(FIONA_VERSION);
  const auto* simulated = dynamic_cast<VirtualClock*>(clock_.get());
  all.set_clock(simulated ? "virtual" : "system");
  all.set_speed(simulated ? simulated->speed() : 1);
  all.set_time_s(to_seconds(clock_->now() - clock_->start()));
  std::map<std::uint64_t, control::InstanceStatus> ordered;
  for (auto& [name, one] : groups_) {
    auto& status = *all.add_groups();
    status.set_name(name);
    status.set_process(one->process());
    for (auto& in_group : status_of_group(*one)) ordered[instances_.at(in_group.name()).order] = std::move(in_group);
    status.set_alive(one->alive());
  }
  for (const auto& [name, one] : instances_) {
    if (!one.lost.empty() || !ordered.contains(one.order)) ordered[one.order] = status_of_lost(name, one);
  }
  std::map<std::string, const Interface*> interfaces;
  for (auto& [order, status] : ordered) {
    complete_status(status);
    interfaces[status.plugin()] = &instances_.at(status.name()).package.interface;
    *all.add_instances() = std::move(status);
  }
  for (const auto& [name, interface] : interfaces) {
    auto& one = *all.add_interfaces();
    one = *interface;
    one.clear_descriptors();
  }
  add_hosts(all);
  for (auto& status : *all.mutable_groups()) {
    status.set_instances(static_cast<std::uint64_t>(std::count_if(
        instances_.begin(), instances_.end(), [&](const auto& entry) { return entry.second.group == status.name(); })));
  }
  return all;
}

}  // namespace fiona::host
