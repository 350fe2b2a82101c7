// Instances: loading, unloading, their parameters and their modes.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/probe.pb.h"
#include "system.hpp"

namespace fiona::host {
namespace {

Error ended_while_loaded(const Package& package, const std::string& group, const std::string& end) {
  return Error(ErrorCode::ComponentFailed,
               {.what = "plugin '" + package.name + "' has ended group '" + group + "' while it was loaded",
                .where = package.library.string(),
                .found = end,
                .next = "tell the publisher"});
}

}  // namespace

bool System::loads_later(const control::Load& request) const {
  return !virtual_time_ && host_of(request.group()).empty();
}

/// Part of the system from here on: whoever asked takes it away again where it does not get to its mode.
void System::begin_load(const control::Load& request, Waits::Answer answer) {
  if (options_.supervisor) options_.supervisor->beat();
  control::Change change;
  *change.mutable_load() = request;
  Model next = model_;
  next.make(change, packages_);
  const std::string name = name_of(request);
  const Model::Instance& made = next.instance(name);
  const auto ended = [name, answer = std::move(answer)](control::Reply reply) {
    if (reply.has_failure()) {
      const Error error = error_of(reply.failure());
      *reply.mutable_failure() = failure_of(Error(error.code(), without_instance(error.text(), name)));
    }
    answer(std::move(reply));
  };
  bring_up(group_for(made), name, made, request, ended);
  model_ = std::move(next);
}

control::Done System::end_load(const control::Load& request) {
  const std::string name = name_of(request);
  made_known(model_.instance(name).group, name);
  return told_of_load(name, model_);
}

control::Done System::told_of_load(const std::string& name, const Model& next) {
  const Model::Instance& made = next.instance(name);
  control::Done done;
  done.set_note(fmt::format("{} {} as {}{}{}", made.package->name, made.package->version, name,
                            made.group == kMainGroup ? "" : " in " + made.group, connect_waiting(name, next)));
  return done;
}

std::string System::name_of(const control::Load& request) const {
  return request.instance().empty() ? packages_.find(request.plugin()).component : request.instance();
}

/// Made in this group, and on its way to its mode; answered, under the number of the change, once it is there, or why
/// it does not get there. Nobody waits meanwhile: what a component does in its life-cycle calls may take ten seconds.
/// Throws Error if it cannot be made.
void System::bring_up(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request,
                      Waits::Answer answer, double within_ms) {
  const std::uint64_t change = next_work_++;
  made_known(target.name(), name);
  const auto begin = [&] {
    create(target, name, made, request, change);
    making_[{target.name(), name}] = {change, made.package};
  };
  const auto expired = failure_reply(
      ErrorCode::Unreachable, {.what = fmt::format("'{}' did not reach its mode within {:g} s", name, within_ms / 1e3),
                               .where = name,
                               .next = "show " + name});
  waits_->work(kNobody, change, within_ms, begin, end_of_mode(change), expired, std::move(answer));
}

/// The one that serves, or is to; not another version of it.
bool System::is_being_made(const std::string& name) const {
  const Model::Instance* one = model_.find(name);
  return one && making_.contains({one->group, name});
}

/// What is being made in a group that has gone does not get there.
void System::lose_what_is_made(const std::string& group, const std::string& end) {
  for (const auto& [key, one] : making_) {
    if (key.first != group) continue;
    wire::GroupMessage event;
    event.mutable_mode_set()->set_change(one.change);
    *event.mutable_mode_set()->mutable_failure() = failure_of(ended_while_loaded(*one.package, group, end));
    deliver(event);
  }
  std::erase_if(making_, [&](const auto& one) { return one.first.first == group; });
}

control::Done System::load(const control::Load& request, const Model& next) {
  const std::string name = name_of(request);
  const Model::Instance& made = next.instance(name);
  create(group_for(made), name, made, request);
  return told_of_load(name, next);
}

void System::create(Group& target, const std::string& name, const Model::Instance& made, const control::Load& request,
                    std::uint64_t change) {
  target.require_answer();
  if (host_of(target.name()).empty()) packages_.require_not_revoked(*made.package);  // since it was loaded, perhaps
  const bool is_candidate = candidate_ && candidate_->name == name && candidate_->made.group == target.name();
  set_beside(target.name(), name, is_candidate);
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
  c.set_change(change);
  if (target.name() == kMainGroup && options_.tries_libraries) trials_.require(made.package->name, made.package->files);
  creating_ = {name, &made};
  try {
    target.request(std::move(create));
    creating_ = {};
  } catch (const Error&) {
    creating_ = {};
    const auto* child = dynamic_cast<const ChildGroup*>(&target);
    const std::string end = child ? child->end() : "";
    const std::string at = target.name();
    retire_if_empty(target);
    if (end.empty()) throw;
    throw ended_while_loaded(*made.package, at, end);
  }
  types_.add(made.package->name, made.package->types);
}

control::Done System::unload(const control::Unload& request) {
  const std::string& name = request.instance();
  const std::string at = model_.instance(name).group;
  dispose_standby(name);
  lose_if_gone(at);
  control::Done done;
  if (!model_.find(name)) {  // of a leader: it has gone with its group
    done.set_note(name + " has ended with " + at);
    return done;
  }
  if (!lost_.contains(name) && !groups_.silent(at)) group(at).require_answer();  // before anything is touched
  // First: a change of mode that waits in the instance is answered, before what it waits for ends with the wires.
  std::string note = "unloaded " + name;
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(name);
  if (RemoteGroup* silent = groups_.silent(at)) {
    silent->owe(std::move(destroy));
    note += ", which its host will do when it is back";
  } else if (!lost_.contains(name)) {
    note += destroyed(group(at), std::move(destroy));
  }
  const std::vector<std::string> dependents = leave_wires(name);
  // It may just be made again where its group was started again.
  if (making_.contains({at, name}) && lost_.contains(name)) discard(at, name);
  lost_.erase(name);
  if (model_.instance(name).led) led_.forget(name);
  made_known(at, name);
  if (model_.names_in(at).size() == 1) leave_group(at);
  if (!dependents.empty()) note += fmt::format("; waiting for it: {}", fmt::join(dependents, ", "));
  done.set_note(note);
  return done;
}

/// What there is to say of it. A process that ends meanwhile has destroyed it too, and so has one that knows of none:
/// it came to its end when nobody waited for that any more.
std::string System::destroyed(Group& target, wire::GroupRequest destroy) {
  try {
    const auto reply = target.request(std::move(destroy));
    return reply.done().note().empty() || !host_of(target.name()).empty() ? "" : "; " + reply.done().note();
  } catch (const Error& error) {
    if (!target.alive()) return "; " + target.name() + " has ended";
    if (error.code() != ErrorCode::NotFound) throw;
    return "; it had ended already";
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
  const auto& own = model_.instance(name).interface().modes();
  std::vector<std::string> known{std::string(kModeNeutral), std::string(kModeDeactivated), std::string(kModeInit),
                                 std::string(kModeFailed)};
  if (own.empty()) known.emplace_back(kModeActive);
  for (const auto& one : own) known.push_back(one.name());
  if (std::find(known.begin(), known.end(), mode) == known.end()) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("'{}' has no mode '{}'", name, mode),
                                      .expected = fmt::format("{}", fmt::join(known, ", ")),
                                      .near = nearest_names(mode, known)});
  }
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
