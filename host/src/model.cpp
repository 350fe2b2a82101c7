#include "model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <set>

#include "fiona/contract.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/params.hpp"
#include "fiona/service.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kHost = "host";

/// "LocationProvider (push timed, CommLocation)".
std::string service_text(const google::protobuf::ServiceDescriptor* service, const std::string& full_name) {
  if (!service) return last_part(full_name);
  const ServiceInfo info(*service);
  const std::string answer = info.answer() ? " -> " + info.answer()->name() : "";
  return fmt::format("{} ({}, {}{})", service->name(), to_string(info.pattern()), info.object().name(), answer);
}

std::shared_ptr<Object> default_parameters(const Model::Instance& instance) {
  const std::string& type = instance.interface().parameters();
  std::shared_ptr<Object> values = type.empty() ? nullptr : Types::make(*instance.package->types, type);
  if (values) set_declared_defaults(*values);
  return values;
}

/// `values` with the changes made. Throws as `set_fields` does, with the instance as the place.
std::shared_ptr<Object> changed(const std::string& name, const std::shared_ptr<const Object>& values,
                                const google::protobuf::RepeatedPtrField<control::Argument>& changes, const std::string& next) {
  if (!values) throw Error(ErrorCode::NotFound, {.what = "'" + name + "' has no parameters", .where = name});
  std::shared_ptr<Object> draft(values->New());
  draft->CopyFrom(*values);
  try {
    const std::vector<control::Argument> arguments(changes.begin(), changes.end());
    set_fields(*draft, arguments);
  } catch (const Error& error) {
    ErrorText text = error.text();
    if (text.where.empty()) text.where = name;
    if (text.next.empty()) text.next = next;
    throw Error(error.code(), std::move(text));
  }
  return draft;
}

std::string mode_after_load(const Model::Instance& instance) {
  if (!instance.mode_at_load.empty()) return instance.mode_at_load;
  const auto& modes = instance.interface().modes();
  return modes.empty() ? std::string(kModeActive) : modes.Get(0).name();
}

/// Whether one can become the other without being loaded anew.
bool is_same(const Model::Instance& a, const Model::Instance& b) {
  return a.package == b.package && a.component == b.component && a.group == b.group;
}

/// The longest hold time of a wire with alternatives.
constexpr double kMostHold_ms = 3'600'000;

}  // namespace

Model::PortKey key_of(const control::PortName& name) { return {name.instance(), name.port()}; }

control::PortName port_of(const Model::PortKey& key) {
  control::PortName name;
  name.set_instance(key.first);
  name.set_port(key.second);
  return name;
}

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

bool Model::Wire::uses(const std::string& instance) const {
  return std::any_of(providers.begin(), providers.end(), [&](const auto& one) { return one.instance() == instance; });
}

bool Model::Wire::operator==(const Wire& other) const {
  const auto same = [](const auto& a, const auto& b) { return key_of(a) == key_of(b); };
  return std::equal(providers.begin(), providers.end(), other.providers.begin(), other.providers.end(), same) &&
         prescale == other.prescale && hold_ms == other.hold_ms;
}

void require_name(const std::string& name, std::string_view kind) {
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_'; };
  const bool good = !name.empty() && name.size() <= 64 && std::isalpha(static_cast<unsigned char>(name[0])) &&
                    std::all_of(name.begin(), name.end(), allowed) && name != kHost;
  if (good) return;
  throw Error(ErrorCode::Usage, {.what = fmt::format("'{}' is no name for {}", name, kind),
                                 .expected = "a letter, then letters, digits, '-' and '_', at most 64; not 'host'"});
}

// ---- finding things -------------------------------------------------------------------------------------------

const Model::Instance* Model::find(const std::string& name) const {
  const auto found = instances_.find(name);
  return found == instances_.end() ? nullptr : found->second.get();
}

const Model::Instance& Model::instance(const std::string& name) const {
  if (const Instance* found = find(name)) return *found;
  throw Error(ErrorCode::NotFound,
              {.what = "there is no instance '" + name + "'", .next = "ls", .near = nearest_names(name, names())});
}

void Model::require_own(const std::string& name) const {
  const Instance* found = find(name);
  if (!found || !found->led || leader_.empty()) return;
  throw Error(ErrorCode::NotAllowed, {.what = fmt::format("'{}' belongs to the system of host '{}', which leads this one", name, leader_),
                                      .next = fmt::format("say it on host '{}'", leader_)});
}

void Model::take(const std::string& name, Instance instance) {
  require_name(name, "an instance");
  if (const Instance* taken = find(name)) {
    throw Error(ErrorCode::Usage, {.what = "there is an instance '" + name + "' already", .found = taken->package->name});
  }
  instance.led = true;
  instance.order = next_order_++;
  instances_[name] = std::make_shared<const Instance>(std::move(instance));
}

std::vector<std::string> Model::names() const {
  std::vector<std::string> all;
  for (const auto& [name, one] : instances_) all.push_back(name);
  return all;
}

bool Model::uses_group(const std::string& group) const {
  return std::any_of(instances_.begin(), instances_.end(), [&](const auto& entry) { return entry.second->group == group; });
}

const PortInterface& Model::port(const control::PortName& name, Direction direction) const {
  std::vector<std::string> fitting;
  for (const auto& one : instance(name.instance()).interface().ports()) {
    if (one.direction() != direction) {
      if (one.name() != name.port()) continue;
      throw Error(ErrorCode::Usage,
                  {.what = fmt::format("{} {} {}", text_of(name), one.direction() == PROVIDES ? "provides" : "requires",
                                       last_part(one.service())),
                   .expected = direction == PROVIDES ? "a port that provides" : "a port that requires",
                   .next = "show " + name.instance()});
    }
    if (one.name() == name.port()) return one;
    fitting.push_back(one.name());
  }
  throw Error(ErrorCode::NotFound, {.what = fmt::format("'{}' has no port '{}' that {}", name.instance(), name.port(),
                                                        direction == PROVIDES ? "provides" : "requires"),
                                    .expected = fitting.empty() ? "nothing: it has none" : fmt::format("one of {}", fmt::join(fitting, ", ")),
                                    .next = "show " + name.instance(),
                                    .near = nearest_names(name.port(), fitting)});
}

namespace {

void check_alternatives(const control::Wire& request, const Model::Wire& made) {
  const std::string client = text_of(request.client());
  for (auto one = made.providers.begin(); one != made.providers.end(); ++one) {
    const auto same = [&](const auto& other) { return key_of(other) == key_of(*one); };
    if (std::none_of(made.providers.begin(), one, same)) continue;
    throw Error(ErrorCode::Usage, {.what = text_of(*one) + " is named twice", .where = client,
                                   .expected = "each alternative once, the best first"});
  }
  if (!request.has_hold_ms()) return;
  if (made.providers.size() == 1) {
    throw Error(ErrorCode::Usage, {.what = "a hold time is for a wire with alternatives", .where = client,
                                   .next = fmt::format("wire {} to {} else OTHER.PORT hold=…", client, text_of(request.provider()))});
  }
  if (made.hold_ms >= 0 && made.hold_ms <= kMostHold_ms) return;
  throw Error(ErrorCode::Usage, {.what = "the hold time is out of range", .where = client, .expected = "0s .. 1h",
                                 .found = fmt::format("{:g} ms", made.hold_ms)});
}

}  // namespace

const Model::Wire* Model::wire_of(const control::PortName& client) const {
  const auto found = wires_.find(key_of(client));
  return found == wires_.end() ? nullptr : &found->second;
}

std::string Model::providers_of(const std::string& service) const {
  std::vector<std::string> names;
  for (const auto& [name, one] : instances_) {
    for (const auto& p : one->interface().ports()) {
      if (p.direction() == PROVIDES && p.service() == service) names.push_back(name + "." + p.name());
    }
  }
  return fmt::format("{}", fmt::join(names, ", "));
}

void Model::require_fit(const control::PortName& client, const control::PortName& provider) const {
  const PortInterface& required = port(client, REQUIRES);
  const PortInterface& provided = port(provider, PROVIDES);
  const auto* a = Types::service(*instance(client.instance()).package->types, required.service());
  const auto* b = Types::service(*instance(provider.instance()).package->types, provided.service());
  const auto difference = a && b ? contract_difference(*a, *b) : std::optional<std::string>("a service is unknown to the host");
  if (!difference) return;
  const std::string fitting = providers_of(required.service());
  const std::string name = last_part(required.service());
  throw Error(ErrorCode::WiringInvalid,
              {.what = fmt::format("{} requires {}; {} provides {}", text_of(client), service_text(a, required.service()),
                                   text_of(provider), service_text(b, provided.service())),
               .found = required.service() == provided.service() ? *difference : "",
               .next = fitting.empty() ? "nothing here provides " + name + ": spots shows who could"
                                       : "these provide " + name + ": " + fitting});
}

// ---- changes --------------------------------------------------------------------------------------------------

void Model::make(const control::Change& change, const Packages& packages) {
  switch (change.what_case()) {
    case control::Change::kLoad: return load(change.load(), packages);
    case control::Change::kUnload: return unload(change.unload());
    case control::Change::kWire: return wire(change.wire());
    case control::Change::kUnwire: return unwire(change.unwire());
    case control::Change::kSet: return change.set().instance() == kHost ? set_host(change.set()) : set(change.set());
    case control::Change::kState: return state(change.state());
    case control::Change::kReplace:
      for (const auto& step : steps_of(change)) make(step, packages);
      return;
    case control::Change::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, "the change is empty, or newer than this host");
}

void Model::load(const control::Load& request, const Packages& packages) {
  const auto [package, component] = packages.find(request.plugin());
  const std::string name = request.instance().empty() ? component : request.instance();
  require_name(name, "an instance");
  if (const Instance* taken = find(name)) {
    throw Error(ErrorCode::Usage, {.what = "there is an instance '" + name + "' already",
                                   .found = taken->package->name,
                                   .next = fmt::format("load {} as OTHER-NAME, or: unload {}", request.plugin(), name)});
  }
  auto made = std::make_shared<Instance>();
  *made = {request.plugin(), package, component, request.group().empty() ? "main" : request.group(), "", request.mode(),
           nullptr, next_order_, false};
  made->mode = mode_after_load(*made);
  made->parameters = default_parameters(*made);
  if (request.parameters_size() > 0) {
    made->parameters = changed(name, made->parameters, request.parameters(),
                               "'" + name + "' was not loaded: correct that, then load it again");
  }
  instances_[name] = std::move(made);
  try {
    for (const auto& [client, wire] : wires_) {
      for (const auto& provider : wire.providers) {
        if (provider.instance() == name) require_fit(port_of(client), provider);
      }
    }
  } catch (const Error& error) {
    instances_.erase(name);
    ErrorText text = error.text();
    text.what = "a wire waits for '" + name + "' and does not fit it: " + text.what;
    throw Error(error.code(), std::move(text));
  }
  ++next_order_;
}

void Model::unload(const control::Unload& request) {
  instance(request.instance());
  require_own(request.instance());
  std::erase_if(wires_, [&](const auto& entry) { return entry.first.first == request.instance(); });
  instances_.erase(request.instance());
}

void Model::wire(const control::Wire& request) {
  port(request.client(), REQUIRES);
  require_own(request.client().instance());
  Wire made{{request.provider()}, std::max(1U, request.prescale())};
  made.providers.insert(made.providers.end(), request.alternatives().begin(), request.alternatives().end());
  if (request.has_hold_ms()) made.hold_ms = request.hold_ms();
  check_alternatives(request, made);
  for (const auto& provider : made.providers) {
    require_own(provider.instance());
    if (find(provider.instance())) {
      require_fit(request.client(), provider);
    } else {
      require_name(provider.instance(), "an instance");
    }
  }
  wires_[key_of(request.client())] = std::move(made);
}

void Model::unwire(const control::Unwire& request) {
  port(request.client(), REQUIRES);
  require_own(request.client().instance());
  if (wires_.erase(key_of(request.client())) == 1) return;
  const std::string name = text_of(request.client());
  throw Error(ErrorCode::NotFound, {.what = name + " has no wire", .where = name, .next = "ls wires"});
}

void Model::set(const control::Set& request) {
  require_own(request.instance());
  auto draft = std::make_shared<Instance>(instance(request.instance()));
  draft->parameters = changed(request.instance(), draft->parameters, request.parameters(), "get " + request.instance());
  instances_[request.instance()] = std::move(draft);
}

/// The host's own parameters: which clock the system has, and how fast a virtual one may run.
void Model::set_host(const control::Set& request) {
  bool is_virtual = virtual_clock_;
  std::optional<double> speed;
  std::optional<std::string> deliveries;
  for (const auto& argument : request.parameters()) {
    const auto& value = argument.value();
    const bool number = value.kind_case() == control::Value::kNumber || value.kind_case() == control::Value::kInteger;
    if (argument.name() == "clock" && (value.text() == "virtual" || value.text() == "system")) {
      is_virtual = value.text() == "virtual";
    } else if (argument.name() == "deliveries" && value.kind_case() == control::Value::kText) {
      deliveries = value.text();
    } else if (argument.name() == "speed" && number) {
      speed = value.kind_case() == control::Value::kNumber ? value.number() : static_cast<double>(value.integer());
    } else {
      throw Error(ErrorCode::Usage, {.what = "the host does not take '" + argument.name() + "' so",
                                     .expected = "clock=system, clock=virtual, speed=TIMES-REAL-TIME (0: as fast as it goes), "
                                                 "deliveries=FILE",
                                     .next = "get host"});
    }
  }
  if (speed && (*speed < 0 || *speed > 1e6)) {
    throw Error(ErrorCode::Usage, {.what = "the speed is out of range", .expected = "0 .. 1000000", .found = fmt::format("{}", *speed)});
  }
  if (speed && !is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "the system clock has one speed", .next = "set host clock=virtual speed=…"});
  }
  if (deliveries && !deliveries->empty() && !is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "deliveries are recorded on a virtual clock", .next = "set host clock=virtual deliveries=FILE"});
  }
  if (is_virtual != virtual_clock_ && !instances_.empty()) {
    throw Error(ErrorCode::NotAllowed, {.what = fmt::format("{} instances live by the present clock", instances_.size()),
                                        .next = "set host clock before the first load"});
  }
  if (is_virtual != virtual_clock_) {
    speed_ = 0;
    deliveries_.clear();
  }
  virtual_clock_ = is_virtual;
  if (speed) speed_ = *speed;
  if (deliveries) deliveries_ = *deliveries;
}

/// Whether the component may go there, only its life cycle can tell.
void Model::state(const control::State& request) {
  require_own(request.instance());
  auto draft = std::make_shared<Instance>(instance(request.instance()));
  draft->mode = request.mode() == "deactivated" ? "neutral" : request.mode();
  instances_[request.instance()] = std::move(draft);
}

namespace {

control::Change wiring_of(const Model::PortKey& client, const Model::Wire& wire) {
  control::Change change;
  control::Wire& request = *change.mutable_wire();
  *request.mutable_client() = port_of(client);
  *request.mutable_provider() = wire.providers.front();
  request.mutable_alternatives()->Add(wire.providers.begin() + 1, wire.providers.end());
  if (wire.prescale > 1) request.set_prescale(wire.prescale);
  if (wire.providers.size() > 1 && wire.hold_ms != Model::Wire::kHold_ms) request.set_hold_ms(wire.hold_ms);
  return change;
}

}  // namespace

// ---- swap -----------------------------------------------------------------------------------------------------

/// The port of `next` that can take the place of this one: the one of its name, or the only one of its service.
control::PortName Model::counterpart(const control::PortName& provider, const std::string& next) const {
  const std::string service = port(provider, PROVIDES).service();
  std::vector<std::string> fitting;
  for (const auto& one : instance(next).interface().ports()) {
    if (one.direction() != PROVIDES || one.service() != service) continue;
    if (one.name() == provider.port()) return port_of({next, one.name()});
    fitting.push_back(one.name());
  }
  if (fitting.size() == 1) return port_of({next, fitting.front()});
  throw Error(ErrorCode::WiringInvalid,
              {.what = fmt::format("'{}' has {} for {} of {}", next, fitting.empty() ? "no port" : "more than one port",
                                   last_part(service), text_of(provider)),
               .found = fmt::format("{}", fmt::join(fitting, ", ")),
               .next = fitting.empty() ? "show " + next : fmt::format("wire each client by hand: wire CLIENT.PORT to {}.{}", next, fitting.front())});
}

std::vector<control::Change> Model::steps_of(const control::Change& change) const {
  if (!change.has_replace()) return {change};
  const control::Replace& swap = change.replace();
  instance(swap.old());
  instance(swap.next());
  std::vector<control::Change> steps;
  for (const auto& [client, wire] : wires_) {
    if (!wire.uses(swap.old())) continue;
    Wire moved = wire;
    for (auto& provider : moved.providers) {
      if (provider.instance() == swap.old()) provider = counterpart(provider, swap.next());
    }
    // One that was an alternative already is there once, in the better place.
    auto& all = moved.providers;
    for (auto one = all.begin(); one != all.end(); ++one) {
      const std::string name = text_of(*one);
      all.erase(std::remove_if(one + 1, all.end(), [&](const auto& other) { return text_of(other) == name; }), all.end());
    }
    steps.push_back(wiring_of(client, moved));
  }
  if (!steps.empty()) return steps;
  throw Error(ErrorCode::NotFound, {.what = "nobody uses '" + swap.old() + "'", .where = swap.old(), .next = "ls wires"});
}

// ---- the way from one to another ------------------------------------------------------------------------------

namespace {

control::Change load_of(const std::string& name, const Model::Instance& instance) {
  control::Change change;
  control::Load& load = *change.mutable_load();
  load.set_plugin(instance.plugin);
  load.set_instance(name);
  if (instance.group != "main") load.set_group(instance.group);
  load.set_mode(instance.mode_at_load);
  if (!instance.parameters) return change;
  for (auto& one : differences(*instance.parameters, *default_parameters(instance))) *load.add_parameters() = std::move(one);
  return change;
}

control::Change state_of(const std::string& name, const std::string& mode) {
  control::Change change;
  change.mutable_state()->set_instance(name);
  change.mutable_state()->set_mode(mode);
  return change;
}

control::Change clock_of(const Model& from, const Model& to) {
  control::Change change;
  change.mutable_set()->set_instance(std::string(kHost));
  auto& clock = *change.mutable_set()->add_parameters();
  clock.set_name("clock");
  clock.mutable_value()->set_text(to.has_virtual_clock() ? "virtual" : "system");
  if (!to.has_virtual_clock()) return change;
  auto& pace = *change.mutable_set()->add_parameters();
  pace.set_name("speed");
  pace.mutable_value()->set_number(to.speed());
  if (from.deliveries() == to.deliveries()) return change;
  auto& deliveries = *change.mutable_set()->add_parameters();
  deliveries.set_name("deliveries");
  deliveries.mutable_value()->set_text(to.deliveries());
  return change;
}

}  // namespace

std::vector<control::Change> Model::difference(const Model& from, const Model& to) {
  std::vector<control::Change> steps;
  std::set<std::string> kept;
  std::map<std::uint64_t, std::string> leaving;
  std::map<std::uint64_t, std::string> coming;
  for (const auto& [name, one] : from.instances_) {
    if (one->led) continue;
    const Instance* same = to.find(name);
    same && is_same(*one, *same) ? void(kept.insert(name)) : void(leaving[one->order] = name);
  }
  for (const auto& [name, one] : to.instances_) {
    if (!kept.contains(name) && !one->led) coming[one->order] = name;
  }
  for (const auto& [client, wire] : from.wires_) {
    if (kept.contains(client.first) && !to.wires_.contains(client)) *steps.emplace_back().mutable_unwire()->mutable_client() = port_of(client);
  }
  for (auto it = leaving.rbegin(); it != leaving.rend(); ++it) steps.emplace_back().mutable_unload()->set_instance(it->second);
  const bool same_clock = from.virtual_clock_ == to.virtual_clock_ && from.speed_ == to.speed_ && from.deliveries_ == to.deliveries_;
  if (!same_clock) steps.push_back(clock_of(from, to));
  for (const auto& [order, name] : coming) steps.push_back(load_of(name, to.instance(name)));
  for (const auto& name : kept) {
    const Instance& target = to.instance(name);
    if (!target.parameters) continue;
    auto different = differences(*target.parameters, *from.instance(name).parameters);
    if (different.empty()) continue;
    control::Set& set = *steps.emplace_back().mutable_set();
    set.set_instance(name);
    for (auto& one : different) *set.add_parameters() = std::move(one);
  }
  for (const auto& [client, wire] : to.wires_) {
    const auto old = from.wires_.find(client);
    const bool there = kept.contains(client.first) && old != from.wires_.end() && old->second == wire;
    if (!there) steps.push_back(wiring_of(client, wire));
  }
  for (const auto& [name, one] : to.instances_) {
    if (one->led) continue;
    const std::string before = kept.contains(name) ? from.instance(name).mode : mode_after_load(*one);
    if (before != one->mode) steps.push_back(state_of(name, one->mode));
  }
  return steps;
}

}  // namespace fiona::host
