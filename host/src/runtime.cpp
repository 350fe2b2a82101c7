#include "runtime.hpp"

#include <algorithm>

#include "fiona/describe.hpp"
#include "fiona/error.hpp"
#include "fiona/push.hpp"

namespace fiona::host {
namespace {

/// How long a life-cycle call of a component may take before the host gives up on it.
constexpr Duration kLifeCycleDeadline = std::chrono::seconds(10);

void make_component(Hull& hull, const Plugin::Entry& entry, const std::string& library) {
  try {
    hull.create(entry.make);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    throw Error(ErrorCode::ComponentFailed,
                {.what = "component '" + entry.name + "' cannot be made: " + error.what(),
                 .where = library,
                 .expected = "a constructor that only declares; on_start() opens files and devices",
                 .next = "tell the publisher"});
  }
}

/// The text of what went wrong at a load: there is no instance afterwards that one could look at.
ErrorText without_instance(ErrorText text, const std::string& instance) {
  if (text.where.empty()) text.where = instance;
  if (text.next == "show " + instance || text.next == "get " + instance) {
    text.next = "'" + instance + "' was not loaded: correct that, then load it again";
  }
  return text;
}

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

/// How long a port has neither the old wire nor the new one, on the machine's clock, and what it loses meanwhile.
class SwitchCost {
 public:
  explicit SwitchCost(Port& client) : client_(client) {}
  void begin() {
    dropped_ = client_.counters().dropped;
    since_ = std::chrono::steady_clock::now();
  }
  void end(wire::Switched& switched) const {
    switched.set_gap_ns(std::chrono::nanoseconds(std::chrono::steady_clock::now() - since_).count());
    switched.set_lost(client_.counters().dropped - dropped_);
  }

 private:
  Port& client_;
  std::uint64_t dropped_ = 0;
  std::chrono::steady_clock::time_point since_{};
};

control::Connection to_proto(Connection connection) { return static_cast<control::Connection>(connection); }

}  // namespace

struct Runtime::Instance {
  std::string plugin;
  std::string version;
  std::string component;
  std::string mode_at_load;
  std::string doc;
  std::unique_ptr<Hull> hull;
};

/// A wire of which this process holds at least one end.
struct Runtime::Wire {
  std::shared_ptr<LocalWire> local;            ///< both ends here
  detail::PushProvider* provider = nullptr;    ///< of a local push
  std::shared_ptr<WireEnd> client;             ///< of a local wire
  const Hull* provider_hull = nullptr;
};

control::Failure failure_of(const Error& error) {
  control::Failure failure;
  failure.set_code(static_cast<std::uint32_t>(error.code()));
  failure.set_what(error.text().what);
  failure.set_where(error.text().where);
  failure.set_expected(error.text().expected);
  failure.set_found(error.text().found);
  failure.set_next(error.text().next);
  for (const auto& name : error.text().near) failure.add_near(name);
  return failure;
}

control::Failure failure_of_exception() {
  control::Failure failure;
  try {
    throw;
  } catch (const Error& error) {
    return failure_of(error);
  } catch (const std::exception& error) {
    failure.set_code(static_cast<std::uint32_t>(ErrorCode::Failed));
    failure.set_what(error.what());
  } catch (...) {
    failure.set_code(static_cast<std::uint32_t>(ErrorCode::Failed));
    failure.set_what("something that is not a std::exception was thrown");
  }
  return failure;
}

void throw_failure(const control::Failure& failure) {
  throw Error(static_cast<ErrorCode>(failure.code()),
              {.what = failure.what(),
               .where = failure.where(),
               .expected = failure.expected(),
               .found = failure.found(),
               .next = failure.next(),
               .near = {failure.near().begin(), failure.near().end()}});
}

Runtime::Runtime(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, std::string link_key,
                 OnEvent on_event)
    : pool_(pool),
      clock_(clock),
      on_event_(std::move(on_event)),
      libraries_(libraries),
      taps_(on_event_),
      links_(pool, clock, std::move(endpoint), std::move(link_key), [this](std::uint64_t wire, const std::string& reason) {
        wire::GroupMessage message;
        message.mutable_wire_lost()->set_wire(wire);
        message.mutable_wire_lost()->set_reason(reason);
        emit(std::move(message));
      }) {}

Runtime::~Runtime() {
  links_.stop();
  for (auto& [id, wire] : wires_) wire.local->cut();
  for (const auto& retired : retired_) {
    if (const auto wire = retired.lock()) wire->cut();
  }
  for (auto& [name, instance] : instances_) {
    // One whose handler still runs keeps its memory: the process ends soon.
    if (!instance->hull->shut_down(kLifeCycleDeadline)) static_cast<void>(instance->hull.release());
  }
}

wire::GroupMessage Runtime::handle(const wire::GroupRequest& request) {
  wire::GroupMessage reply;
  reply.mutable_done();
  try {
    dispatch(request, reply);
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(request.id());
  return reply;
}

void Runtime::dispatch(const wire::GroupRequest& request, wire::GroupMessage& reply) {
  using Request = wire::GroupRequest;
  switch (request.what_case()) {
    case Request::kCreate: return create(request.create());
    case Request::kDestroy: return destroy(request.destroy(), reply);
    case Request::kSetParameters: {
      const auto& arguments = request.set_parameters().parameters();
      const std::vector<control::Argument> changes(arguments.begin(), arguments.end());
      return find(request.set_parameters().instance()).hull->set_parameters(changes, kDefaultDeadline);
    }
    case Request::kSetMode: return set_mode(request.set_mode());
    case Request::kWireLocal: return wire_local(request.wire_local(), *reply.mutable_switched());
    case Request::kWireProvide: {
      const auto& wire = request.wire_provide();
      return links_.provide(wire.wire(), wire.token(), wire.peer(), provided(wire.provider()), wire.prescale(),
                            wire.attached() ? wire.client().instance() : text_of(wire.client()), wire.attached());
    }
    case Request::kWireRequire: {
      const auto& wire = request.wire_require();
      RequiredPort& client = required(wire.client());
      SwitchCost cost(client);
      links_.require(wire.wire(), wire.token(), client.end_for(text_of(wire.provider())), {wire.endpoint(), wire.name(), wire.key()},
                     wire.replaces(), wire.resumes_every(), [&] {
        cost.begin();
        retire(wire.replaces());
      });
      return cost.end(*reply.mutable_switched());
    }
    case Request::kAwait:
      return required(request.await().client()).end_for(text_of(request.await().provider()))
          ->set_connection(Connection::Waiting, request.await().reason());
    case Request::kArrange: return arrange(request.arrange(), *reply.mutable_switched());
    case Request::kWireRelay:
      return links_.relay(request.wire_relay().wire(), request.wire_relay().token(), request.wire_relay().peer(),
                          {request.wire_relay().endpoint(), request.wire_relay().name(), request.wire_relay().key()});
    case Request::kCut: return cut(request.cut());
    case Request::kStatus: return status(*reply.mutable_status());
    case Request::kTap: return taps_.tap(request.tap(), *find(request.tap().watch().port().instance()).hull);
    case Request::kUntap: return taps_.untap(request.untap().tap());
    case Request::kRead: {
      const auto& probe = request.read().probe();
      *reply.mutable_tapped() = read_probe(*find(probe.instance()).hull, probe.port());
      return;
    }
    case Request::kCall: return call(request.call());
    case Request::kPeerLost: {
      const auto& gone = request.peer_lost();
      return links_.peer_lost(gone.endpoint(), gone.name(), gone.reason());
    }
    case Request::kWelcome: throw Error(ErrorCode::Usage, "the group has its key already");
    case Request::WHAT_NOT_SET: throw Error(ErrorCode::Usage, "the request is empty, or newer than this program");
  }
}

void Runtime::create(const wire::Create& request) {
  const Plugin& plugin = libraries_.open(request.plugin(), request.library(), request.interface());
  const auto entry = std::find_if(plugin.entries().begin(), plugin.entries().end(),
                                  [&](const Plugin::Entry& e) { return e.name == request.component(); });
  const auto& components = request.interface().components();
  const auto packaged = std::find_if(components.begin(), components.end(),
                                     [&](const ComponentInterface& c) { return c.name() == request.component(); });
  if (entry == plugin.entries().end() || packaged == components.end()) {
    std::vector<std::string> known;
    for (const auto& e : plugin.entries()) known.push_back(e.name);
    throw Error(ErrorCode::NotFound, {.what = "plugin '" + request.plugin() + "' has no component '" + request.component() + "'",
                                      .where = request.library(),
                                      .near = known});
  }
  auto instance = std::make_unique<Instance>();
  instance->plugin = request.plugin();
  instance->version = request.version();
  instance->component = request.component();
  instance->mode_at_load = request.mode();
  instance->doc = entry->doc;
  instance->hull = std::make_unique<Hull>(request.instance(), Hull::Surroundings{pool_, clock_, *this, request.share()});
  Hull& hull = *instance->hull;
  try {
    make_component(hull, *entry, request.library());
    const auto difference = interface_difference(interface_of(hull, entry->name, entry->doc), *packaged);
    if (!difference.empty()) {
      throw Error(ErrorCode::Failed, {.what = "component '" + request.component() + "' is not what its package says: " + difference,
                                      .where = request.library(),
                                      .next = "install the package again, or ask the publisher to pack it again"});
    }
    const std::vector<control::Argument> parameters(request.parameters().begin(), request.parameters().end());
    hull.set_parameters(parameters, kDefaultDeadline);
    hull.set_mode(request.mode().empty() ? hull.main_modes().front() : request.mode(), kLifeCycleDeadline);
  } catch (const Error& error) {
    hull.shut_down(kLifeCycleDeadline);
    throw Error(error.code(), without_instance(error.text(), request.instance()));
  }
  instances_.emplace(request.instance(), std::move(instance));
}

void Runtime::set_mode(const wire::SetMode& request) {
  const auto done = [this, change = request.change()](const std::optional<Error>& error) {
    wire::GroupMessage message;
    message.mutable_mode_set()->set_change(change);
    if (error) *message.mutable_mode_set()->mutable_failure() = failure_of(*error);
    emit(std::move(message));
  };
  const std::chrono::duration<double, std::milli> asked(request.within_ms());
  const Duration within = asked.count() > 0 ? std::chrono::duration_cast<Duration>(asked) : kLifeCycleDeadline;
  find(request.instance()).hull->change_mode(request.mode(), within, done);
}

void Runtime::destroy(const wire::Destroy& request, wire::GroupMessage& reply) {
  Instance& instance = find(request.instance());
  taps_.release(*instance.hull);
  links_.release(*instance.hull);
  // Whoever asked has cut its wires, unless he did not know of the instance any more.
  std::vector<std::uint64_t> left;
  for (const auto& [id, wire] : wires_) {
    if (wire.provider_hull == instance.hull.get() || &wire.client->port().hull() == instance.hull.get()) left.push_back(id);
  }
  for (const std::uint64_t id : left) {
    wire::Cut cut_it;
    cut_it.set_wire(id);
    cut_it.set_reason("'" + request.instance() + "' has ended");
    cut(cut_it);
  }
  for (const auto& retired : retired_) {
    if (const auto wire = retired.lock()) wire->cut_from(*instance.hull);
  }
  const bool clean = instance.hull->shut_down(kLifeCycleDeadline);
  if (!clean) {
    reply.mutable_done()->set_note("'" + request.instance() +
                                   "' did not come free: its handler still runs, and its memory stays until the process ends");
    static_cast<void>(instance.hull.release());
  }
  instances_.erase(request.instance());
}

Runtime::Instance& Runtime::find(const std::string& name) {
  const auto found = instances_.find(name);
  if (found != instances_.end()) return *found->second;
  throw Error(ErrorCode::NotFound, "there is no instance '" + name + "' in this process");
}

ProvidedPort& Runtime::provided(const control::PortName& name) {
  auto* port = dynamic_cast<ProvidedPort*>(find(name.instance()).hull->find_port(name.port()));
  if (port) return *port;
  throw Error(ErrorCode::NotFound, text_of(name) + " is no provided port");
}

RequiredPort& Runtime::required(const control::PortName& name) {
  auto* port = dynamic_cast<RequiredPort*>(find(name.instance()).hull->find_port(name.port()));
  if (port) return *port;
  throw Error(ErrorCode::NotFound, text_of(name) + " is no required port");
}

void Runtime::wire_local(const wire::WireLocal& request, wire::Switched& switched) {
  ProvidedPort& provider = provided(request.provider());
  RequiredPort& client = required(request.client());
  auto* push = dynamic_cast<detail::PushProvider*>(&provider);
  const auto end = client.end_for(provider.full_name());
  const std::string name = client.full_name() + "<" + provider.full_name();
  auto local = push ? std::make_shared<LocalWire>(name, end, request.prescale())
                    : std::make_shared<LocalWire>(name, *provider.inbox());
  SwitchCost cost(client);
  cost.begin();
  // The new one first: a request that is being made has somewhere to go at every moment.
  if (!push) end->set_target(local);
  retire(request.replaces());
  end->set_connection(Connection::Connected, provider.full_name());
  if (push) push->attach(local);
  wires_[request.wire()] = Wire{std::move(local), push, end, &provider.hull()};
  cost.end(switched);
}

void Runtime::arrange(const wire::Arrange& request, wire::Switched& switched) {
  RequiredPort& client = required(request.client());
  std::vector<std::string> providers;
  for (const auto& name : request.providers()) providers.push_back(text_of(name));
  const std::chrono::duration<double, std::milli> hold(request.hold_ms());
  SwitchCost cost(client);
  cost.begin();
  client.arrange(providers, std::chrono::duration_cast<Duration>(hold));
  cost.end(switched);
  for (const std::uint64_t wire : request.retires()) retire(wire);
}

void Runtime::cut(const wire::Cut& request) {
  const auto found = wires_.find(request.wire());
  if (found == wires_.end()) return links_.cut(request.wire(), request.reason());
  const auto client = found->second.client;
  client->set_target(nullptr);
  found->second.local->cut();
  retire(request.wire());
  client->set_connection(Connection::Unwired, request.reason());
}

/// Lets go of a wire whose client goes on with another one, or with none. What is on its way over a local wire still
/// reaches the provider and ends there; a push has its cut here.
void Runtime::retire(std::uint64_t id) {
  const auto found = wires_.find(id);
  if (found == wires_.end()) return links_.retire(id);
  if (found->second.provider) {
    found->second.provider->detach(*found->second.local);
    found->second.local->cut();
  } else {
    std::erase_if(retired_, [](const auto& wire) { return wire.expired(); });
    retired_.push_back(found->second.local);
  }
  wires_.erase(found);
}

/// Tells the host, once, how a call by hand has ended.
class Runtime::CallReply final : public ReplySink {
 public:
  CallReply(std::uint64_t run, const OnEvent& on_event) : run_(run), on_event_(on_event) {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (ended_.exchange(true)) return;
    wire::GroupMessage message;
    auto& ended = *message.mutable_call_ended();
    ended.set_run(run_);
    ended.set_outcome(static_cast<std::uint32_t>(outcome));
    ended.set_reason(std::move(reason));
    if (object) ended.set_type(object->GetDescriptor()->full_name());
    if (object) object->SerializeToString(ended.mutable_object());
    on_event_(std::move(message));
  }

 private:
  const std::uint64_t run_;
  const OnEvent& on_event_;
  std::atomic<bool> ended_{false};
};

namespace {

std::shared_ptr<Object> object_from(const google::protobuf::Descriptor& type,
                                    const google::protobuf::RepeatedPtrField<control::Argument>& arguments) {
  std::shared_ptr<Object> object(google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type)->New());
  set_fields(*object, std::vector<control::Argument>(arguments.begin(), arguments.end()));
  return object;
}

}  // namespace

void Runtime::call(const wire::Call& request) {
  Hull& hull = *find(request.target().instance()).hull;
  auto reply = std::make_shared<CallReply>(request.run(), on_event_);
  if (auto* trigger = hull.find_trigger(request.target().port())) {
    trigger->call(object_from(trigger->argument(), request.arguments()), reply);
  } else {
    call_port(hull, request, reply);
  }
  const auto within = std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(request.within_ms()));
  clock_.schedule(clock_.now() + within, hull.shared_strand(), [reply] {
    reply->answer(Outcome::Timeout, {}, nullptr);
    reply->abandon();
  });
}

void Runtime::call_port(const Hull& hull, const wire::Call& request, const std::shared_ptr<ReplySink>& reply) {
  Port* port = hull.find_port(request.target().port());
  if (!port) {
    std::vector<std::string> known;
    for (const auto* one : hull.triggers()) known.push_back(one->name());
    for (const auto* one : hull.ports()) known.push_back(one->name());
    throw Error(ErrorCode::NotFound, {.what = "'" + hull.name() + "' has no port or trigger '" + request.target().port() + "'",
                                      .next = "show " + hull.name(),
                                      .near = nearest_names(request.target().port(), known)});
  }
  auto* provided = dynamic_cast<ProvidedPort*>(port);
  const Pattern pattern = port->service().pattern();
  if (!provided || (pattern != QUERY && pattern != SEND)) {
    throw Error(ErrorCode::Usage, {.what = port->full_name() + " speaks " + std::string(to_string(pattern)) + ": it cannot be called",
                                   .expected = "a query or send port, or a trigger",
                                   .next = "watch " + port->full_name()});
  }
  auto object = object_from(port->service().object(), request.arguments());
  const std::size_t bytes = object->ByteSizeLong();
  const Outcome outcome = provided->inbox()->push({Envelope{std::move(object), request.run(), clock_.now(), bytes}, reply});
  if (outcome != Outcome::Ok || pattern == SEND) reply->answer(outcome, {}, nullptr);
}

namespace {

void fill_port(control::PortStatus& status, Port& port, TimePoint now) {
  PortCounters& counters = port.counters();
  status.set_name(port.name());
  status.set_direction(port.direction() == PortDirection::Provides ? PROVIDES : REQUIRES);
  status.set_service(port.service().name());
  status.set_pattern(port.service().pattern());
  status.set_optional(port.optional());
  status.set_doc(port.doc());
  status.set_activity(port.activity());
  status.set_messages(counters.messages);
  status.set_superseded(counters.superseded);
  status.set_dropped(counters.dropped);
  status.set_refused(counters.refused);
  const auto age = counters.age(now);
  status.set_age_ms(age ? 1e3 * to_seconds(*age) : -1);
  status.set_rate_hz(counters.rate_now_hz(now));
  if (auto* required = dynamic_cast<RequiredPort*>(&port)) {
    status.set_connection(to_proto(required->connection()));
    status.set_reason(required->connection_reason());
    status.set_since_s(to_seconds(now - required->connection_since()));
    status.set_flaps(required->flaps());
    for (const auto& one : required->alternatives()) {
      auto& provider = *status.add_providers();
      provider.mutable_provider()->set_instance(one.provider.substr(0, one.provider.find('.')));
      provider.mutable_provider()->set_port(one.provider.substr(one.provider.find('.') + 1));
      provider.set_connection(to_proto(one.connection));
      provider.set_reason(one.reason);
      provider.set_fit(one.fit);
      provider.set_serves(one.serves);
    }
  }
}

}  // namespace

void Runtime::status(wire::GroupStatusReply& reply) {
  *reply.mutable_links() = links_.status();
  const TimePoint now = clock_.now();
  for (const auto& [name, instance] : instances_) {
    const Hull& hull = *instance->hull;
    auto& status = *reply.add_instances();
    status.set_name(name);
    status.set_plugin(instance->plugin);
    status.set_component(instance->component);
    status.set_version(instance->version);
    status.set_mode(hull.mode());
    for (const auto& mode : hull.main_modes()) status.add_modes(mode);
    status.set_reason(hull.reason());
    if (const auto pending = hull.pending_change()) {
      status.mutable_pending()->set_to(pending->to);
      status.mutable_pending()->set_blocked_by(pending->blocked_by);
      status.mutable_pending()->set_blocked_s(to_seconds(now - pending->since));
    }
    status.set_doc(instance->doc);
    status.set_mode_at_load(instance->mode_at_load);
    for (Port* port : hull.ports()) fill_port(*status.add_ports(), *port, now);
    if (hull.parameters()) {
      for (auto& one : hull.parameters()->status()) *status.add_parameters() = std::move(one);
      for (auto& one : hull.parameters()->differences()) *status.add_set_parameters() = std::move(one);
    }
    for (const auto* trigger : hull.triggers()) *status.add_triggers() = interface_of(*trigger);
    fill_probes(status, hull, now);
    for (const Task* task : hull.tasks()) {
      auto& one = *status.add_tasks();
      one.set_name(task->name());
      one.set_period_ms(1e3 * to_seconds(task->period()));
      one.set_runs(task->runs());
      one.set_overruns(task->overruns());
      one.set_activity(task->activity());
    }
    status.set_handler_ms(1e3 * to_seconds(hull.strand().busy_time()));
    status.set_queue_depth(hull.strand().queue_depth());
  }
}

void Runtime::mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) {
  wire::GroupMessage message;
  auto& changed = *message.mutable_mode_changed();
  changed.set_instance(instance);
  changed.set_mode(mode);
  changed.set_reason(reason);
  emit(std::move(message));
}

void Runtime::run_ended(const std::string& instance, int exit_code, const std::string& reason) {
  wire::GroupMessage message;
  auto& ended = *message.mutable_run_ended();
  ended.set_instance(instance);
  ended.set_exit_code(exit_code);
  ended.set_reason(reason);
  emit(std::move(message));
}

void Runtime::logged(const std::string& instance, LogLevel level, std::string_view text) {
  wire::GroupMessage message;
  auto& log = *message.mutable_logged();
  log.set_instance(instance);
  log.set_level(static_cast<std::uint32_t>(level));
  log.set_text(std::string(text));
  emit(std::move(message));
}

}  // namespace fiona::host
