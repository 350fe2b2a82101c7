// The processes of a system: made for their instances, served, watched, and lost.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>

#include "confinement.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "system.hpp"

namespace fiona::host {

/// The one that was loaded first of those that are in a group.
const Model::Instance* System::first_in(const std::string& group) const {
  const Model::Instance* first = nullptr;
  for (const std::string& name : model_.names_in(group)) {
    const Model::Instance& one = model_.instance(name);
    if (!first || one.order < first->order) first = &one;
  }
  return first;
}

Group& System::group_for(const Model::Instance& made) {
  const Model::Instance* first = first_in(made.group);
  if (const std::string host = host_of(made.group); host.empty()) {
    require_group(first, made, made.plugin);
  } else if (const auto rights = rights_of_process(made); !rights.empty()) {
    throw Error(
        ErrorCode::NotAllowed,
        {.what = fmt::format("groups of host '{}' take no rights from this one: {}", host, fmt::join(rights, ", ")),
         .expected = "a group of this host; there a stranger's package has its sandbox, and nothing else opens it",
         .next = fmt::format("fiona --host {} load {}, on that host", host, made.plugin)});
  }
  return group(made.group, first ? first : &made);
}

wire::Confinement System::confinement_of_group(const Model::Instance* first,
                                               const std::filesystem::path& folder) const {
  wire::Confinement confinement;
  if (first) confinement = confinement_of(*first, folder.parent_path(), folder);
  confinement.set_memory(options_.group_limits.memory);
  confinement.set_threads(options_.group_limits.threads);
  const std::uint64_t descriptors = options_.group_limits.descriptors;
  confinement.set_descriptors(confinement.sandboxed() ? os::descriptors_of_stranger(descriptors) : descriptors);
  return confinement;
}

/// One whose package is not trusted is none: who knows where things lie in one copy knows it of all of them.
std::shared_ptr<os::ProcessTemplate> System::template_for(const wire::Confinement& confinement) {
  if (confinement.sandboxed() || !os::kCopiesProcesses) return nullptr;
  auto one = template_.lock();
  if (!one || !one->lives())
    template_ = one = std::make_shared<os::ProcessTemplate>(os::program_directory() / kGroupProgram);
  return one;
}

ChildGroup::Start System::start_of_group(const std::string& name, const Model::Instance* first,
                                         const std::filesystem::path& folder) {
  ClockMaster* master = virtual_time_ ? &virtual_time_->lead_groups() : nullptr;
  return {"ipc://" + (folder / "link").string(),
          *clock_,
          master,
          options_.threads,
          options_.ends_hung_groups ? parts(name) : nullptr,
          confinement_of_group(first, folder),
          folder,
          options_.group_limits.cores,
          groups_.main().endpoint(),
          memory_key_,
          options_.supervisor,
          {},
          [this] { watch_others(); }};
}

Group& System::group(const std::string& name, const Model::Instance* first) {
  const std::string wanted = name.empty() ? std::string(kMainGroup) : name;
  lose_if_gone(wanted);                              // before another one takes its place
  if (ending_.erase(wanted) > 0) end_group(wanted);  // who comes after the last one gets a process of its own
  if (Group* found = groups_.living(wanted)) return *found;
  if (Group* remote = remote_group(wanted)) return *remote;
  require_name(wanted, "a group");
  end_leaving(wanted);
  require_descriptors_for("another group", child_groups().size() + attachments_.clients(),
                          options_.group_limits.descriptors);
  const auto folder = links_directory() / fmt::format("{}.{}.{}", options_.name, wanted, next_order_++);
  auto start = start_of_group(wanted, first ? first : first_in(wanted), folder);
  start.copied = template_for(start.confinement);
  return groups_.put(std::make_unique<ChildGroup>(
      wanted, start, [this, wanted](wire::GroupMessage event) { deliver_from_child(wanted, std::move(event)); }));
}

Group& System::group_of(const std::string& name, const Model& model) {
  const Model::Instance& one = model.instance(name);
  lose_if_gone(one.group);
  const auto lost = lost_.find(name);
  if (lost == lost_.end()) return group(one.group);
  throw Error(ErrorCode::Unreachable, {.what = "'" + name + "' is lost: " + lost->second.reason,
                                       .where = name,
                                       .next = lost->second.away ? "ls hosts"
                                               : supervision_.waits(one.group) || is_being_made(name)
                                                   ? "wait for it"
                                                   : "unload " + name + ", then load it again"});
}

/// A process that was started for an instance that could not be made has no purpose.
void System::retire_if_empty(const Group& target) {
  const std::string name = target.name();
  if (!model_.names_in(name).empty() || name == kMainGroup || !host_of(name).empty()) return;
  groups_.retire(name);
}

/// The last one in it goes: its process ends too. That of another host is ended there.
void System::leave_group(const std::string& name) {
  supervision_.forget(name);
  const Group* at = groups_.find(name);
  const std::string host = host_of(name);
  if (!at || name == kMainGroup || name == host) return;
  if (host.empty()) {
    ending_.emplace(name, std::chrono::steady_clock::now());
  } else if (at->alive()) {
    groups_.retire(name);
  }
}

std::vector<ChildGroup*> System::child_groups() {
  std::vector<ChildGroup*> children;
  for (const auto& [name, one] : groups_.all()) {
    auto* child = dynamic_cast<ChildGroup*>(one.get());
    if (!child) continue;
    // A request may have found the end of the process before its socket was polled.
    if (!child->alive()) lose(*child);
    if (child->alive()) children.push_back(child);
  }
  return children;
}

/// The version of an instance that is in this group; null: none is, or it is just being made.
const Model::Instance* System::made_in(const std::string& group, const std::string& name) const {
  const Model::Instance* one = model_.find(name);
  if (one && one->group == group) return one;
  const auto is_it = [&](const Beside& other) { return other.name == name && other.made.group == group; };
  if (candidate_ && is_it(*candidate_)) return &candidate_->made;
  const auto standby = standbys_.find(name);
  if (standby != standbys_.end() && is_it(standby->second)) return &standby->second.made;
  const auto leaving = std::find_if(leaving_.begin(), leaving_.end(), is_it);
  return leaving != leaving_.end() ? &leaving->made : nullptr;
}

HangWatch::Parts System::parts(const std::string& group) const {
  return [this, group](const std::string& name) -> std::optional<HangWatch::Part> {
    const Model::Instance* one = made_in(group, name);
    if (!one) return std::nullopt;
    HangWatch::Part part{{}, one->package->hang_after};
    auto& texts = part.texts;
    for (const auto& port : one->interface().ports()) texts.push_back(port.name());
    for (const auto& task : one->interface().tasks()) texts.push_back("task '" + task.name() + "'");
    for (const auto& trigger : one->interface().triggers()) texts.push_back("trigger '" + trigger.name() + "'");
    return part;
  };
}

/// An instance of `main` does not come back. It cannot be ended; but nobody is to wait for it. Who has its name may be
/// another one by now, or live elsewhere, as the version that has taken its place does: that one is left alone.
void System::give_up(const HangOfMain& found) {
  const Hang& hang = found.hang;
  const bool has_left = groups_.main().has_left(hang.slot);
  if (!has_left && order_of(hang.instance) != found.order) return;  // it has come back since, and been unloaded
  ++kept_threads_;
  pool_->add_thread();
  const Model::Instance* one = model_.find(hang.instance);
  if (has_left || !one || one->group != kMainGroup) return;
  groups_.main().give_up(hang.instance, hang.what());
  for (auto& [client, wire] : wires_) {
    const bool uses_it = client.first == hang.instance || wire.provider.instance() == hang.instance;
    if (uses_it && wire.id != 0) wire.reason = hang.text();
  }
}

std::vector<std::string> System::watch_groups() {
  const auto now = std::chrono::steady_clock::now();
  std::vector<std::string> lines;
  const auto attempt = [&lines](const std::function<void()>& work) {
    if (auto fault = fault_of(work)) lines.push_back(std::move(*fault));
  };
  look_at_main(now);
  for (const HangOfMain& found : std::exchange(found_hangs_, {})) attempt([&] { give_up(found); });
  for (auto* child : child_groups()) {
    child->watch(now);
    if (!child->alive()) lose(*child);
  }
  if (const auto copied = template_.lock(); copied && !copied->lives()) template_.reset();
  for (const auto& work : made_.take()) attempt(work);
  look_after_versions(now);
  open_waiting(now);
  attempt([&] { led_.destroy_left(now); });
  attempt([&] { std::ranges::move(resume_late(now), std::back_inserter(lines)); });
  groups_.end_retired();
  for (const std::string& name : supervision_.take_due(now)) {
    attempt([&] {
      if (std::string line = start_again(name); !line.empty()) lines.push_back(std::move(line));
    });
  }
  return lines;
}

void System::look_at_main(std::chrono::steady_clock::time_point now) {
  groups_.main().let_failed_go();
  if (!main_hangs_) return;
  for (Hang& hang : main_hangs_->look(now, ::getpid())) {
    const auto order = order_of(hang.instance);
    found_hangs_.push_back({std::move(hang), order});
  }
}

std::optional<std::uint64_t> System::order_of(const std::string& instance) const {
  const Model::Instance* found = model_.find(instance);
  return found ? std::optional(found->order) : std::nullopt;
}

/// While one group is waited for: another that hangs is ended, and who uses one that has ended is told. What else
/// follows from that comes once nobody waits: the model may be in the middle of a change.
void System::watch_others() {
  const auto now = std::chrono::steady_clock::now();
  if (now - watched_others_ < kWatchWaiting) return;
  watched_others_ = now;
  look_at_main(now);
  for (const auto& [name, one] : groups_.all()) {
    auto* child = dynamic_cast<ChildGroup*>(one.get());
    if (!child || !child->alive() || child->is_waited_for()) continue;
    if (!child->is_read_later()) child->serve();  // else who has asked reads the answer
    child->watch(now);
    if (!child->alive()) tell_ended(*child);
  }
}

void System::tell_ended(ChildGroup& gone) {
  if (!gone.is_told_first()) return;
  groups_.tell_ended(gone.endpoint(), "group '" + gone.name() + "' " + gone.end());
}

void System::serve_group(ChildGroup& group) {
  if (!group.serve()) lose(group);
}

/// Which may have ended meanwhile.
void System::serve_group(const std::string& name) {
  if (ChildGroup* group = groups_.child(name)) serve_group(*group);
}

/// A request may have found its end before its socket was polled.
void System::lose_if_gone(const std::string& name) {
  ChildGroup* child = groups_.child(name);
  if (child && !child->alive()) lose(*child);
}

void System::lose(ChildGroup& gone) {
  if (!gone.is_lost_first()) return;
  const std::string reason = "group '" + gone.name() + "' " + gone.end();
  lose_what_is_made(gone.name(), gone.end());
  std::erase_if(standbys_, [&](const auto& one) { return one.second.made.group == gone.name(); });
  // Also those that have come since it was told first: to be told twice changes nothing.
  groups_.tell_ended(gone.endpoint(), reason);
  for (const std::string& name : model_.names_in(gone.name())) {
    if (lost_.emplace(name, Lost{reason}).second) tell_failed(name, reason);
  }
  taps_.lose(gone.name(), reason);
  attachments_.lose(gone.name(), reason);
  if (virtual_time_) virtual_time_->forget(gone.endpoint());  // from here on it goes on without it
  lose_wires(gone.name(), reason);
  tell_group_ended(gone.name(), reason);
  forget_led(gone.name(), reason);
  start_again_later(gone.name(), reason);
}

/// Whoever waits for something in it, and the leader.
void System::tell_group_ended(const std::string& group, const std::string& reason) {
  wire::GroupMessage event;
  event.mutable_group_ended()->set_group(group);
  event.mutable_group_ended()->set_reason(reason);
  deliver(event);
}

void System::tell_failed(const std::string& instance, const std::string& reason) {
  wire::GroupMessage event;
  event.mutable_mode_changed()->set_instance(instance);
  event.mutable_mode_changed()->set_mode(std::string(kModeFailed));
  event.mutable_mode_changed()->set_reason(reason);
  deliver(event);
}

}  // namespace fiona::host
