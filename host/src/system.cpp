#include "system.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iostream>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/hull_probes.hpp"
#include "fiona/probe.pb.h"
#include "link_keys.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kMain = "main";
/// Of a change of mode that names none; and how much longer than the instance itself the host waits for an end.
constexpr double kModeDeadline_ms = 10'000;
constexpr double kGrace_ms = 1'000;

std::string waiting_for(const std::string& provider) { return "there is no instance '" + provider + "' yet"; }

}  // namespace

System::System(Options options, OnEvent on_event)
    : options_(std::move(options)), on_event_(std::move(on_event)), packages_(options_.store) {
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
  if (virtual_) virtual_->stop();  // it asks the groups how far they are
  if (hosts_) hosts_->stop();
  groups_.clear();
  master_.reset();
  if (waits_) waits_->stop();
  if (clock_) clock_->stop();
  hosts_.reset();
  pool_.reset();
  waits_.reset();
}

void System::use_clock(std::unique_ptr<Clock> clock) {
  end_threads();
  deliveries_.reset();
  clock_ = std::move(clock);
  virtual_ = dynamic_cast<VirtualClock*>(clock_.get());
  pool_ = std::make_unique<Pool>(options_.threads);
  waits_ = std::make_unique<Waits>(*clock_, *pool_);
  const std::string endpoint = "ipc://" + (options_.directory / (options_.name + ".main.ipc")).string();
  auto main = std::make_unique<MainGroup>(*pool_, *clock_, libraries_, endpoint, [this](wire::GroupMessage event) { deliver(event); });
  if (virtual_) master_ = std::make_unique<ClockMaster>(*virtual_, endpoint, [&main = *main] { return main.frame_counts(); });
  groups_[std::string(kMain)] = std::move(main);
}

/// Waits first, on the thread where it happened; then whoever else listens.
void System::deliver(const wire::GroupMessage& event) {
  waits_->on_event(event, types_);
  const bool led = tell_leader(event);
  if (event.has_run_ended() && !led) waits_->end_run(event.run_ended().exit_code(), event.run_ended().reason());
  on_event_(event);
}

// ---- groups ---------------------------------------------------------------------------------------------------

Group& System::group(const std::string& name) {
  const std::string wanted = name.empty() ? std::string(kMain) : name;
  const auto found = groups_.find(wanted);
  if (found != groups_.end() && found->second->alive()) return *found->second;
  if (Group* remote = remote_group(wanted)) return *remote;
  require_name(wanted, "a group");
  require_descriptors_for("another group", child_groups().size() + attached_names());
  const std::string endpoint = "ipc://" + (options_.directory / fmt::format("{}.{}.{}.ipc", options_.name, wanted, next_order_++)).string();
  if (virtual_) virtual_->lead(*master_);
  const ChildGroup::Start start{endpoint, *clock_, master_.get(), options_.threads};
  auto made = std::make_unique<ChildGroup>(wanted, start, [this](wire::GroupMessage event) { deliver(event); });
  return *(groups_[wanted] = std::move(made));
}

Group& System::group_of(const std::string& name, const Model& model) {
  const Model::Instance& one = model.instance(name);
  const auto lost = lost_.find(name);
  if (lost == lost_.end()) return group(one.group);
  throw Error(ErrorCode::Unreachable, {.what = "'" + name + "' is lost: " + lost->second.reason,
                                       .where = name,
                                       .next = lost->second.away ? "ls hosts" : "unload " + name + ", then load it again"});
}

/// A process that was started for an instance that could not be made has no purpose.
void System::retire_if_empty(const Group& target) {
  const std::string name = target.name();
  if (!model_.uses_group(name) && name != kMain && host_of(name).empty()) groups_.erase(name);
}

// ---- instances ------------------------------------------------------------------------------------------------

control::Done System::perform(const control::Change& change) {
  settle();
  Model next = model_;
  next.make(change, packages_);
  const control::Done done = [&] {
    switch (change.what_case()) {
      case control::Change::kLoad: return load(change.load(), next);
      case control::Change::kUnload: return unload(change.unload());
      case control::Change::kWire: return wire(change.wire(), next);
      case control::Change::kUnwire: return unwire(change.unwire());
      case control::Change::kSet: return set(change.set(), next);
      default: throw Error(ErrorCode::Usage, "the change is not one step");
    }
  }();
  model_ = std::move(next);
  return done;
}

control::Done System::load(const control::Load& request, const Model& next) {
  const std::string name = request.instance().empty() ? packages_.find(request.plugin()).component : request.instance();
  const Model::Instance& made = next.instance(name);
  Group& target = group(made.group);
  create(target, name, made, request);
  control::Done done;
  done.set_note(fmt::format("{} {} as {}{}{}", made.package->name, made.package->version, name,
                            target.name() == kMain ? "" : " in " + target.name(), connect_waiting(name, next)));
  return done;
}

void System::create(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request) {
  wire::GroupRequest create;
  auto& c = *create.mutable_create();
  c.set_instance(name);
  c.set_plugin(made.package->name);
  c.set_version(made.package->version);
  if (host_of(target.name()).empty()) {  // another host has files of its own
    c.set_library(made.package->library.string());
    c.set_share(made.package->share.string());
  }
  c.set_component(made.component);
  *c.mutable_interface() = made.package->interface;
  *c.mutable_parameters() = request.parameters();
  c.set_mode(request.mode());
  try {
    target.request(std::move(create));
  } catch (...) {
    retire_if_empty(target);
    throw;
  }
  types_.add(made.package->name, made.package->types);
}

control::Done System::unload(const control::Unload& request) {
  const std::string& name = request.instance();
  std::vector<std::string> dependents;
  for (auto it = wires_.begin(); it != wires_.end();) {
    const control::PortName client = port_of(it->first);
    const bool is_client = client.instance() == name;
    const bool is_provider = it->second.provider.instance() == name;
    if (is_client || is_provider) disconnect(client, it->second, name + " was unloaded");
    if (!is_client && is_provider) {
      const bool alone = model_.wire_of(client)->providers.size() == 1;
      dependents.push_back(text_of(client) + (alone ? "" : ", which has alternatives"));
      it->second = Wire{it->second.provider, 0, false, waiting_for(name), {}};
      await_provider(client, it->second, model_);
    }
    it = is_client ? wires_.erase(it) : std::next(it);
  }
  control::Done done;
  std::string note = "unloaded " + name;
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(name);
  const std::string& at = model_.instance(name).group;
  if (RemoteGroup* silent = silent_group(at)) {
    silent->owe(std::move(destroy));
    note += ", which its host will do when it is back";
  } else if (!lost_.contains(name)) {
    const auto reply = group(at).request(std::move(destroy));
    if (!reply.done().note().empty() && host_of(at).empty()) note += "; " + reply.done().note();
  }
  lost_.erase(name);
  if (!dependents.empty()) note += fmt::format("; waiting for it: {}", fmt::join(dependents, ", "));
  done.set_note(note);
  return done;
}

void System::note_state(const control::State& request) {
  control::Change change;
  *change.mutable_state() = request;
  if (model_.find(request.instance())) model_.make(change, packages_);
}

void System::state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer) {
  settle();
  const std::string name = request.instance();
  Group& target = group_of(name, model_);
  model_.require_own(name);
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

/// The provider of a wired port; of several the one that serves now.
control::PortName System::served_by(const control::PortName& client) {
  const Model::Wire& wire = *model_.wire_of(client);
  if (wire.providers.size() == 1) return wire.providers.front();
  control::PortName probe = client;
  probe.set_port(client.port() + ".serving");
  probe::Text serving;
  serving.ParseFromString(read(probe).object());
  const auto found = std::find_if(wire.providers.begin(), wire.providers.end(),
                                  [&](const auto& one) { return text_of(one) == serving.value(); });
  return found == wire.providers.end() ? wire.providers.front() : *found;
}

/// What a call by hand reaches: the port or trigger that is named, of a required port the provider at its wire's end.
control::PortName System::callee(const control::PortName& name) {
  for (const auto& one : model_.instance(name.instance()).interface().ports()) {
    if (one.name() != name.port() || one.direction() != REQUIRES) continue;
    if (model_.wire_of(name)) return served_by(name);
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: there is nobody to call", .next = "spots"});
  }
  return name;
}

void System::call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer) {
  const control::PortName name = callee(request.target());
  Group& target = group_of(name.instance(), model_);
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

control::Done System::set(const control::Set& request, const Model& next) {
  control::Done done;
  done.set_note("set " + request.instance());
  if (request.instance() != "host") {
    wire::GroupRequest change;
    change.mutable_set_parameters()->set_instance(request.instance());
    *change.mutable_set_parameters()->mutable_parameters() = request.parameters();
    group_of(request.instance(), next).request(std::move(change));
    return done;
  }
  if (next.has_virtual_clock() && hosts_) {
    throw Error(ErrorCode::NotAllowed, {.what = "a virtual clock drives one host, and this one works with others over tcp",
                                        .next = "start it without --listen and --peer"});
  }
  const bool records_anew = next.deliveries() != (deliveries_ ? deliveries_->file().string() : "");
  std::shared_ptr<DeliveryLog> log;  // first: a file that cannot be written changes nothing
  if (records_anew && !next.deliveries().empty()) log = std::make_shared<DeliveryLog>(next.deliveries());
  if (next.has_virtual_clock() != has_virtual_clock()) {
    use_clock(has_virtual_clock() ? std::unique_ptr<Clock>(std::make_unique<SystemClock>()) : std::make_unique<VirtualClock>());
  }
  if (virtual_) virtual_->set_speed(next.speed());
  if (virtual_ && records_anew) record_to(std::move(log));
  return done;
}

void System::record_to(std::shared_ptr<DeliveryLog> log) {
  deliveries_ = std::move(log);
  virtual_->set_recorder(deliveries_);
  master_->set_recorder(deliveries_);
}

void System::settle() {
  if (!virtual_ || virtual_->released() || progress() == unsettled_) return;
  const auto end = std::chrono::steady_clock::now() + options_.standstill;
  // The groups wait until what they told has been heard.
  do {
    for (auto* child : child_groups()) serve_group(*child);
    if (virtual_->settle(master_->empty() ? options_.standstill : std::chrono::milliseconds(1))) return;
  } while (std::chrono::steady_clock::now() < end);
  unsettled_ = progress();
}

std::uint64_t System::progress() const { return virtual_->progress() + master_->progress(); }

void System::watch_time() {
  const auto now = std::chrono::steady_clock::now();
  if (!virtual_ || !virtual_->released()) {
    standing_ = {0, now, false};
    return;
  }
  if (deliveries_ && !deliveries_->failure().empty()) {
    const std::string failure = deliveries_->failure();
    const std::string file = deliveries_->file().string();
    record_to(nullptr);
    return waits_->fail_all(Error(ErrorCode::Failed, {.what = "the delivery log cannot be written", .where = file, .found = failure}));
  }
  const bool waits = !virtual_->busy_strands().empty() || !master_->situation().quiet;
  if (!waits || progress() != standing_.progress) {
    standing_ = {progress(), now, false};
    return;
  }
  if (!standing_.asked && now - standing_.since > options_.standstill * 4 / 5) {
    standing_.asked = true;
    master_->ask_what_runs();
  }
  if (now - standing_.since < options_.standstill) return;
  waits_->fail_all(standstill());
  standing_ = {progress(), now, false};
}

Error System::standstill() const {
  std::vector<std::string> blockers;
  for (const auto& name : virtual_->busy_strands()) blockers.push_back("'" + name + "' runs");
  for (auto& text : master_->blockers()) blockers.push_back(std::move(text));
  return Error(ErrorCode::Unreachable,
               {.what = fmt::format("virtual time has stood at {:.3f} s for {:.3g} s", to_seconds(clock_->now() - clock_->start()),
                                    std::chrono::duration<double>(options_.standstill).count()),
                .expected = "a handler that ends: time goes on when nothing runs",
                .found = fmt::format("{}", fmt::join(blockers, "; ")),
                .next = "show the instance, or unload it; then wait again"});
}

std::pair<bool, std::string> System::has_mode(const std::string& name, const std::string& mode) {
  model_.instance(name);
  const auto snapshot_now = snapshot();
  for (const auto& one : snapshot_now.instances()) {
    if (one.name() == name) return {one.mode() == mode, one.mode()};
  }
  return {false, ""};
}

// ---- wires ----------------------------------------------------------------------------------------------------

/// Make before break: the client's side lets go of the wire `replaces` once the new one is open; if it does not open,
/// all is as before.
System::Wire System::connect(const control::PortName& client, const control::PortName& provider, const Model& model,
                             std::uint64_t replaces, control::Done& done, bool resumes) {
  const std::uint32_t prescale = model.wire_of(client)->prescale;
  Group& client_group = group_of(client.instance(), model);
  Group& provider_group = group_of(provider.instance(), model);
  Wire wire{provider, next_wire_++, &client_group == &provider_group, {}, {}};
  const auto note_cost = [&](const wire::GroupMessage& reply) {
    if (replaces == 0) return;
    done.set_switched(done.switched() + 1);
    done.set_gap_ms(std::max(done.gap_ms(), static_cast<double>(reply.switched().gap_ns()) / 1e6));
    done.set_lost(done.lost() + reply.switched().lost());
  };
  wire::GroupRequest request;
  if (wire.local) {
    auto& local = *request.mutable_wire_local();
    local.set_wire(wire.id);
    *local.mutable_client() = client;
    *local.mutable_provider() = provider;
    local.set_prescale(prescale);
    local.set_replaces(replaces);
    note_cost(client_group.request(std::move(request)));
    return wire;
  }
  const std::string token = os::random_token();
  const std::vector<Group*> path = way(client_group, provider_group);
  auto& provide = *request.mutable_wire_provide();
  provide.set_wire(wire.id);
  provide.set_token(token);
  *provide.mutable_provider() = provider;
  *provide.mutable_client() = client;
  provide.set_prescale(prescale);
  provide.set_peer(known_as(*path[path.size() - 2], provider_group));
  provider_group.request(request);
  try {
    for (std::size_t i = path.size() - 2; i > 0; --i) {
      wire.relays.push_back(path[i]->name());
      auto& relay = *request.mutable_wire_relay();
      relay.set_wire(wire.id);
      relay.set_token(token);
      relay.set_peer(known_as(*path[i - 1], *path[i]));
      set_endpoint(relay, endpoint_for(*path[i], *path[i + 1]));
      path[i]->request(request);
    }
    auto& require = *request.mutable_wire_require();
    require.set_wire(wire.id);
    require.set_token(token);
    *require.mutable_client() = client;
    *require.mutable_provider() = provider;
    require.set_replaces(replaces);
    if (resumes) require.set_resumes_every(prescale);
    set_endpoint(require, endpoint_for(client_group, *path[1]));
    note_cost(client_group.request(std::move(request)));
  } catch (...) {
    for (const auto& relay : wire.relays) cut_at(relay, wire.id, "the wire did not open");
    cut_at(provider_group.name(), wire.id, "the wire did not open");
    throw;
  }
  return wire;
}

void System::disconnect(const control::PortName& client, const Wire& wire, const std::string& reason) {
  if (wire.id == 0) return;
  // The client first: told by its host it is unwired; told by the provider it would be lost.
  for (const auto& name : {client.instance(), wire.provider.instance()}) {
    if (const auto* one = model_.find(name)) cut_at(one->group, wire.id, reason);
    if (wire.local) return;
  }
  for (const auto& relay : wire.relays) cut_at(relay, wire.id, reason);
}

void System::await_provider(const control::PortName& client, const Wire& wire, const Model& model) {
  if (lost_.contains(client.instance())) return;
  wire::GroupRequest request;
  *request.mutable_await()->mutable_client() = client;
  *request.mutable_await()->mutable_provider() = wire.provider;
  request.mutable_await()->set_reason(wire.reason);
  group_of(client.instance(), model).request(std::move(request));
}

/// The wires that have waited for an instance that is there now; what came of it, as a note.
std::string System::connect_waiting(const std::string& provider, const Model& next) {
  std::vector<std::string> connected;
  std::string note;
  for (auto& [key, wire] : wires_) {
    const control::PortName client = port_of(key);
    if (wire.id != 0 || wire.provider.instance() != provider || !next.wire_of(client)) continue;
    try {
      control::Done ignored;
      wire = connect(client, wire.provider, next, 0, ignored);
      connected.push_back(text_of(client));
    } catch (const Error& error) {
      wire.reason = error.text().what;
      note += fmt::format("; {} still waits: {}", text_of(client), wire.reason);
    }
  }
  return connected.empty() ? note : fmt::format("; had waited for it: {}", fmt::join(connected, ", ")) + note;
}

control::Done System::wire(const control::Wire& request, const Model& next) {
  const Model::Wire* before = model_.wire_of(request.client());
  const Model::Wire& wanted = *next.wire_of(request.client());
  const auto [first, last] = wires_.equal_range(key_of(request.client()));
  const bool all_well = std::all_of(first, last, [](const auto& one) { return one.second.reason.empty(); });
  if (before && all_well && *before == wanted) {
    control::Done done;
    done.set_note("wired so already");
    return done;
  }
  const bool several = wanted.providers.size() > 1 || (before && before->providers.size() > 1);
  control::Done done = several ? wire_several(request.client(), next) : wire_one(request.client(), next);
  std::string note = text_of(request.client()) + (done.warnings_size() > 0 && !several ? " waits for " : " to ") + text_of(request.provider());
  for (const auto& provider : request.alternatives()) note += " else " + text_of(provider);
  done.set_note(note);
  return done;
}

namespace {

std::string waiting_warning(const control::PortName& client, const std::string& provider, const Model& next) {
  const auto near = nearest_names(provider, next.names());
  return text_of(client) + " waits: " + waiting_for(provider) +
         (near.empty() ? "" : fmt::format("; did you mean {}?", fmt::join(near, ", ")));
}

}  // namespace

control::Done System::wire_one(const control::PortName& client, const Model& next) {
  const control::PortName& provider = next.wire_of(client)->providers.front();
  const auto old = wires_.find(key_of(client));
  control::Done done;
  Wire made{provider, 0, false, waiting_for(provider.instance()), {}};
  if (next.find(provider.instance())) {
    made = connect(client, provider, next, old == wires_.end() ? 0 : old->second.id, done);
  } else {
    if (old != wires_.end()) disconnect(client, old->second, made.reason);
    await_provider(client, made, next);
    done.add_warnings(waiting_warning(client, provider.instance(), next));
  }
  wires_.erase(key_of(client));
  wires_.emplace(key_of(client), std::move(made));
  return done;
}

/// Those that it keeps stay as they are. The new ones are opened before those that go are let go of, so that at every
/// moment somebody serves. One that does not open waits: that is what its alternatives are for.
control::Done System::wire_several(const control::PortName& client, const Model& next) {
  const Model::Wire& wanted = *next.wire_of(client);
  const Model::Wire* before = model_.wire_of(client);
  const bool as_before = before && before->prescale == wanted.prescale;
  std::vector<Wire> old;
  for (auto [it, last] = wires_.equal_range(key_of(client)); it != last; ++it) old.push_back(it->second);
  std::vector<control::PortName> meanwhile = wanted.providers;
  std::vector<std::uint64_t> retires;
  for (const Wire& one : old) {
    const auto same = [&](const auto& name) { return key_of(name) == key_of(one.provider); };
    if (std::any_of(wanted.providers.begin(), wanted.providers.end(), same)) continue;
    meanwhile.push_back(one.provider);
    if (one.id != 0) retires.push_back(one.id);
  }
  control::Done done;
  arrange(client, meanwhile, wanted.hold_ms, {}, next, nullptr);
  std::vector<Wire> now;
  for (const auto& provider : wanted.providers) {
    const Wire* known = wire_to(key_of(client), provider);
    const bool stays = known && known->reason.empty() && as_before;
    now.push_back(stays ? *known : open_or_wait(client, provider, next, known ? *known : Wire{provider}, done));
  }
  arrange(client, wanted.providers, wanted.hold_ms, retires, next, &done);
  wires_.erase(key_of(client));
  for (Wire& one : now) wires_.emplace(key_of(client), std::move(one));
  return done;
}

System::Wire System::open_or_wait(const control::PortName& client, const control::PortName& provider, const Model& next,
                                  const Wire& old, control::Done& done) {
  Wire waiting{provider, 0, false, waiting_for(provider.instance()), {}};
  try {
    if (next.find(provider.instance())) return connect(client, provider, next, old.id, done);
    done.add_warnings(waiting_warning(client, provider.instance(), next));
  } catch (const Error& error) {
    waiting.reason = error.text().what;
    done.add_warnings(fmt::format("{} waits for {}: {}", text_of(client), text_of(provider), waiting.reason));
  }
  disconnect(client, old, waiting.reason);
  await_provider(client, waiting, next);
  return waiting;
}

void System::arrange(const control::PortName& client, const std::vector<control::PortName>& providers, double hold_ms,
                     const std::vector<std::uint64_t>& retires, const Model& model, control::Done* cost) {
  wire::GroupRequest request;
  auto& arrange = *request.mutable_arrange();
  *arrange.mutable_client() = client;
  arrange.mutable_providers()->Add(providers.begin(), providers.end());
  arrange.set_hold_ms(hold_ms);
  arrange.mutable_retires()->Add(retires.begin(), retires.end());
  const auto reply = group_of(client.instance(), model).request(std::move(request));
  if (!cost || retires.empty()) return;
  cost->set_switched(cost->switched() + static_cast<std::uint32_t>(retires.size()));
  cost->set_gap_ms(std::max(cost->gap_ms(), static_cast<double>(reply.switched().gap_ns()) / 1e6));
  cost->set_lost(cost->lost() + reply.switched().lost());
}

control::Done System::unwire(const control::Unwire& request) {
  const auto [first, last] = wires_.equal_range(key_of(request.client()));
  // Of several, or cut from nothing: the port is told that it has none from now on.
  const bool tells = std::next(first) != last || first->second.id == 0;
  if (tells && !lost_.contains(request.client().instance())) arrange(request.client(), {}, Model::Wire::kHold_ms, {}, model_, nullptr);
  for (auto it = first; it != last; ++it) disconnect(request.client(), it->second, "unwired");
  wires_.erase(first, last);
  control::Done done;
  done.set_note(text_of(request.client()) + " unwired");
  return done;
}

void System::on_wire_lost(std::uint64_t id, const std::string& reason) {
  for (auto& [client, wire] : wires_) {
    if (wire.id == id) wire.reason = reason;
  }
  end_attachment(id);
}

// ---- watching -------------------------------------------------------------------------------------------------

void System::tap(std::uint64_t id, const control::Watch& request) {
  const control::PortName& name = request.port();
  control::PortName target = name;
  if (model_.wire_of(name) && model_.find(served_by(name).instance())) target = served_by(name);
  const auto& ports = model_.instance(target.instance()).interface().ports();
  const bool unwired = std::any_of(ports.begin(), ports.end(), [&](const PortInterface& p) {
    return p.name() == target.port() && p.direction() == REQUIRES;
  });
  if (unwired) {
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: nothing comes to it", .next = "spots"});
  }
  Group& target_group = group_of(target.instance(), model_);
  wire::GroupRequest tap;
  tap.mutable_tap()->set_tap(id);
  *tap.mutable_tap()->mutable_watch() = request;
  *tap.mutable_tap()->mutable_watch()->mutable_port() = target;
  taps_.emplace(id, target_group.name());
  try {
    target_group.request(std::move(tap));
  } catch (...) {
    taps_.erase(id);
    throw;
  }
}

wire::Tapped System::read(const control::PortName& name) {
  wire::GroupRequest request;
  *request.mutable_read()->mutable_probe() = name;
  return group_of(name.instance(), model_).request(std::move(request)).tapped();
}

control::Expect System::expected(control::Expect request) {
  control::PortName& name = *request.mutable_port();
  const Model::Instance& owner = model_.instance(name.instance());
  const auto& component = owner.interface();
  const auto probes = hull_probes();
  const auto has = [&](HullProbe::Of of) {
    return std::any_of(probes.begin(), probes.end(), [&](const auto& one) { return one.of == of && one.name == request.field(); });
  };
  const auto named = [&name](const auto& one) { return one.name() == name.port(); };
  const auto port = std::find_if(component.ports().begin(), component.ports().end(), named);
  const bool is_task = std::any_of(component.tasks().begin(), component.tasks().end(), named);
  const auto* service = port == component.ports().end() ? nullptr : Types::service(*owner.package->types, port->service());
  const bool is_field = service && ServiceInfo(*service).object().FindFieldByName(request.field());
  if (service && request.field().empty()) {
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " is a port: '" + text_of(name) + "' names no field of its object",
                                   .expected = "INSTANCE.PORT.FIELD",
                                   .next = "show " + text_of(name)});
  }
  if ((service && has(HullProbe::Of::Port) && !is_field) || (is_task && has(HullProbe::Of::Task))) {
    name.set_port(name.port() + "." + request.field());
    request.clear_field();
  }
  return request;
}

void System::untap(std::uint64_t id) {
  const auto found = taps_.find(id);
  if (found == taps_.end()) return;
  const auto owner = groups_.find(found->second);
  taps_.erase(found);
  if (owner == groups_.end() || !owner->second->alive()) return;
  wire::GroupRequest request;
  request.mutable_untap()->set_tap(id);
  owner->second->tell(std::move(request));
}

// ---- the processes of groups ----------------------------------------------------------------------------------

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
  wire::PeerLost lost;
  lost.set_endpoint(gone.endpoint());
  lost.set_name(gone.link_name());
  lost.set_reason(reason);
  for (auto& [name, one] : groups_) {
    if (one.get() != &gone && one->alive()) one->peer_lost(lost);
  }
  for (const std::string& name : model_.names()) {
    const bool dies = model_.instance(name).group == gone.name() && lost_.emplace(name, Lost{reason}).second;
    if (dies) tell_failed(name, reason);
  }
  end_taps(gone.name(), reason);
  lose_attachments(gone.name(), reason);
  if (master_) master_->remove(gone.endpoint());  // from here on virtual time goes on without it
  for (auto& [key, wire] : wires_) {
    const std::string& provider = wire.provider.instance();
    const bool client_gone = model_.instance(key.first).group == gone.name();
    const bool provider_gone = model_.find(provider) && model_.instance(provider).group == gone.name();
    if (wire.id != 0 && (client_gone || provider_gone)) wire.reason = reason;
    // Another host's process, which has lost nothing, must not go on sending to nobody.
    const bool far = client_gone && !provider_gone && model_.find(provider) && !host_of_instance(provider).empty();
    if (wire.id != 0 && far) cut_at(model_.instance(provider).group, wire.id, reason);
  }
  wire::GroupMessage event;
  event.mutable_group_ended()->set_group(gone.name());
  event.mutable_group_ended()->set_reason(reason);
  tell_leader(event);
  // What was the leader's there is told; the names are his to use again.
  for (const std::string& name : model_.names()) {
    if (!model_.instance(name).led || model_.instance(name).group != gone.name()) continue;
    note_led(name, false);
    lost_.erase(name);
    model_.drop(name);
  }
}

void System::tell_failed(const std::string& instance, const std::string& reason) {
  wire::GroupMessage event;
  event.mutable_mode_changed()->set_instance(instance);
  event.mutable_mode_changed()->set_mode(std::string(kModeFailed));
  event.mutable_mode_changed()->set_reason(reason);
  deliver(event);
}

void System::end_taps(const std::string& group, const std::string& reason) {
  for (const auto& [tap, owner] : taps_) {
    if (owner != group) continue;
    wire::GroupMessage event;
    event.mutable_tap_ended()->set_tap(tap);
    *event.mutable_tap_ended()->mutable_failure() = failure_of(Error(ErrorCode::Unreachable, {.what = reason}));
    deliver(event);
  }
  std::erase_if(taps_, [&group](const auto& tap) { return tap.second == group; });
}

// ---- snapshot -------------------------------------------------------------------------------------------------

control::InstanceStatus System::status_of_lost(const std::string& name) const {
  const Model::Instance& one = model_.instance(name);
  control::InstanceStatus status;
  status.set_name(name);
  status.set_plugin(one.package->name);
  status.set_component(one.component);
  status.set_version(one.package->version);
  status.set_mode(std::string(kModeFailed));
  const auto lost = lost_.find(name);
  status.set_reason(lost == lost_.end() ? "its process does not answer" : lost->second.reason);
  for (const auto& declared : one.interface().ports()) {
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

const System::Wire* System::wire_to(const Model::PortKey& client, const control::PortName& provider) const {
  const auto [first, last] = wires_.equal_range(client);
  const auto found = std::find_if(first, last, [&](const auto& one) { return key_of(one.second.provider) == key_of(provider); });
  return found == last ? nullptr : &found->second;
}

/// A required port's wires, as they are meant to be and as they are.
void System::complete_port(const Model::PortKey& client, const Model::Wire& wanted, control::PortStatus& status) const {
  status.set_prescale(wanted.prescale);
  *status.mutable_peer() = wanted.providers.front();
  const Wire* wire = wire_to(client, wanted.providers.front());
  if (wanted.providers.size() == 1) {
    if (wire && wire->id != 0) status.set_transport(transport(client.first, *wire));
    if (wire && wire->id != 0 && !wire->reason.empty()) status.set_connection(control::LOST);
    if (wire && !wire->reason.empty()) status.set_reason(wire->reason);
    return;
  }
  status.set_hold_ms(wanted.hold_ms);
  if (status.providers().empty()) {  // its process is gone
    for (const auto& provider : wanted.providers) *status.add_providers()->mutable_provider() = provider;
  }
  for (auto& one : *status.mutable_providers()) {
    wire = wire_to(client, one.provider());
    if (wire && wire->id != 0) one.set_transport(transport(client.first, *wire));
    if (!one.serves() || !one.fit()) continue;
    *status.mutable_peer() = one.provider();
    status.set_transport(one.transport());
  }
}

/// What only the whole system knows: groups, wires seen from both ends.
void System::complete_status(control::InstanceStatus& status) const {
  status.set_group(model_.instance(status.name()).group);
  for (auto& p : *status.mutable_ports()) {
    for (const auto& [client, wanted] : model_.wires()) {
      if (client.first == status.name() && client.second == p.name()) complete_port(client, wanted, p);
      const auto is_this = [&](const auto& one) { return one.instance() == status.name() && one.port() == p.name(); };
      if (std::any_of(wanted.providers.begin(), wanted.providers.end(), is_this)) *p.add_clients() = port_of(client);
    }
    add_attached(status.name(), p);
  }
}

/// The instances of a group; none when the process turns out to be gone, which is then noted.
std::vector<control::InstanceStatus> System::status_of_group(Group& target, control::LinkStatus& links) {
  std::vector<control::InstanceStatus> found;
  if (!target.alive()) return found;
  wire::GroupRequest request;
  request.mutable_status();
  try {
    const auto reply = target.request(std::move(request));
    links = reply.status().links();
    std::copy_if(reply.status().instances().begin(), reply.status().instances().end(), std::back_inserter(found),
                 [this](const auto& one) { return model_.find(one.name()) != nullptr; });
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
  const auto* simulated = virtual_;
  all.set_clock(simulated ? "virtual" : "system");
  all.set_speed(simulated ? simulated->speed() : 1);
  if (deliveries_) all.set_deliveries(deliveries_->file().string());
  all.set_time_s(to_seconds(clock_->now() - clock_->start()));
  std::map<std::uint64_t, control::InstanceStatus> ordered;
  for (auto& [name, one] : groups_) {
    auto& status = *all.add_groups();
    status.set_name(name);
    status.set_process(one->process());
    for (auto& in_group : status_of_group(*one, *status.mutable_links())) ordered[model_.instance(in_group.name()).order] = std::move(in_group);
    status.set_alive(one->alive());
  }
  for (const std::string& name : model_.names()) {
    const std::uint64_t order = model_.instance(name).order;
    if (lost_.contains(name) || !ordered.contains(order)) ordered[order] = status_of_lost(name);
  }
  std::map<std::string, const Interface*> interfaces;
  std::map<std::string, std::uint64_t> members;
  for (auto& [order, status] : ordered) {
    complete_status(status);
    ++members[status.group()];
    interfaces[status.plugin()] = &model_.instance(status.name()).package->interface;
    *all.add_instances() = std::move(status);
  }
  for (const auto& [name, interface] : interfaces) {
    auto& one = *all.add_interfaces();
    one = *interface;
    one.clear_descriptors();
  }
  add_hosts(all);
  for (auto& status : *all.mutable_groups()) status.set_instances(members[status.name()]);
  return all;
}

}  // namespace fiona::host
