// Instances: loading, unloading, their parameters and their modes.
#include <fmt/format.h>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/probe.pb.h"
#include "system.hpp"

namespace fiona::host {

control::Done System::load(const control::Load& request, const Model& next) {
  const std::string name = request.instance().empty() ? packages_.find(request.plugin()).component : request.instance();
  const Model::Instance& made = next.instance(name);
  Group& target = group_for(made);
  create(target, name, made, request);
  control::Done done;
  done.set_note(fmt::format("{} {} as {}{}{}", made.package->name, made.package->version, name,
                            target.name() == kMainGroup ? "" : " in " + target.name(), connect_waiting(name, next)));
  return done;
}

void System::create(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request) {
  target.require_answer();
  if (host_of(target.name()).empty()) packages_.require_not_revoked(*made.package);  // since it was loaded, perhaps
  wire::GroupRequest create;
  auto& c = *create.mutable_create();
  c.set_instance(name);
  c.set_plugin(made.package->name);
  c.set_version(made.package->version);
  if (host_of(target.name()).empty()) {  // another host has files of its own
    c.set_library(made.package->library.string());
    c.set_share(made.package->share.string());
    *c.mutable_files() = made.package->files;
  }
  c.set_component(made.component);
  *c.mutable_interface() = made.package->interface;
  *c.mutable_parameters() = request.parameters();
  c.set_mode(request.mode());
  if (target.name() == kMainGroup && options_.tries_libraries) trials_.require(made.package->name, made.package->files);
  try {
    target.request(std::move(create));
  } catch (const Error&) {
    const auto* child = dynamic_cast<const ChildGroup*>(&target);
    const std::string end = child ? child->end() : "";
    const std::string at = target.name();
    retire_if_empty(target);
    if (end.empty()) throw;
    throw Error(ErrorCode::ComponentFailed,
                {.what = "plugin '" + made.package->name + "' has ended group '" + at + "' while it was loaded",
                 .where = made.package->library.string(),
                 .found = end,
                 .next = "tell the publisher"});
  }
  types_.add(made.package->name, made.package->types);
}

control::Done System::unload(const control::Unload& request) {
  const std::string& name = request.instance();
  const std::string at = model_.instance(name).group;
  lose_if_gone(at);
  if (!lost_.contains(name) && !silent_group(at)) group(at).require_answer();  // before anything is touched
  // First: a change of mode that waits in the instance is answered, before what it waits for ends with the wires.
  control::Done done;
  std::string note = "unloaded " + name;
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(name);
  if (RemoteGroup* silent = silent_group(at)) {
    silent->owe(std::move(destroy));
    note += ", which its host will do when it is back";
  } else if (!lost_.contains(name)) {
    note += destroyed(group(at), std::move(destroy));
  }
  const std::vector<std::string> dependents = leave_wires(name);
  lost_.erase(name);
  if (model_.names_in(at).size() == 1) supervision_.forget(at);
  if (!dependents.empty()) note += fmt::format("; waiting for it: {}", fmt::join(dependents, ", "));
  done.set_note(note);
  return done;
}

/// What there is to say of it. A process that ends meanwhile has destroyed it too.
std::string System::destroyed(Group& target, wire::GroupRequest destroy) {
  try {
    const auto reply = target.request(std::move(destroy));
    return reply.done().note().empty() || !host_of(target.name()).empty() ? "" : "; " + reply.done().note();
  } catch (const Error&) {
    if (target.alive()) throw;
    return "; " + target.name() + " has ended";
  }
}

control::Done System::set(const control::Set& request, const Model& next) {
  control::Done done;
  done.set_note("set " + request.instance());
  if (request.instance() == kHostItself) {
    set_clock(next.clock());
    return done;
  }
  wire::GroupRequest change;
  change.mutable_set_parameters()->set_instance(request.instance());
  *change.mutable_set_parameters()->mutable_parameters() = request.parameters();
  group_of(request.instance(), next).request(std::move(change));
  return done;
}

void System::note_state(const control::State& request) {
  control::Change change;
  *change.mutable_state() = request;
  if (model_.find(request.instance())) model_.make(change, packages_);
}

std::pair<bool, std::string> System::has_mode(const std::string& name, const std::string& mode) {
  model_.instance(name);
  std::string now(kModeFailed);
  try {
    control::PortName probe;
    probe.set_instance(name);
    probe.set_port("mode");
    probe::Text text;
    if (!lost_.contains(name) && text.ParseFromString(read(probe).object())) now = text.value();
  } catch (const Error& error) {
    if (error.code() != ErrorCode::Unreachable) throw;
    now = lost_.contains(name) ? std::string(kModeFailed) : "";  // a process that is silent may come back
  }
  return {now == mode, now};
}

}  // namespace fiona::host
