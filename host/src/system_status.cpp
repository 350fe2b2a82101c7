// How a system is doing: what the groups tell, completed by what only the whole system knows.
#include <fmt/format.h>

#include <algorithm>

#include "fiona/hull.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

control::PortStatus as_declared(const PortInterface& declared) {
  control::PortStatus status;
  status.set_name(declared.name());
  status.set_direction(declared.direction());
  status.set_service(declared.service());
  status.set_optional(declared.optional());
  status.set_doc(declared.doc());
  status.set_age_ms(-1);
  status.set_latency_p50_ms(-1);
  status.set_latency_p99_ms(-1);
  return status;
}

/// Of `main` there is no limit to tell.
void add_process(control::GroupStatus& status, const Group& group) {
  const auto* child = dynamic_cast<const ChildGroup*>(&group);
  const auto usage = group.process() > 0 ? os::usage_of(group.process()) : std::nullopt;
  status.set_memory(usage ? usage->memory : 0);
  status.set_threads(usage ? usage->threads : 0);
  status.set_descriptors(usage ? usage->descriptors : 0);
  if (!child) return;
  *status.mutable_sandbox() = child->ready().sandbox();
  status.set_memory_limit(child->confinement().memory());
  status.set_threads_limit(child->confinement().threads());
  status.set_descriptors_limit(child->confinement().descriptors());
  status.set_cpu(child->cpu().cores());
  status.set_cpu_limit(child->cpu().most());
  status.set_cpu_held_by(child->cpu_held_by());
  status.set_dropped_output(child->dropped_output());
  status.set_adopted(child->adopted().has_value());
}

}  // namespace

control::System System::snapshot() {
  child_groups();  // notes those that a request found dead
  control::System all;
  all.set_host(options_.name);
  all.set_version(FIONA_VERSION);
  all.set_supervised(options_.supervisor != nullptr);
  all.set_restarts(options_.restarts);
  all.set_restart_reason(options_.restart_reason);
  all.set_taken_back(options_.taken_back);
  all.set_clock(virtual_time_ ? "virtual" : "system");
  if (virtual_time_ && clock_->start() != TimePoint{}) all.set_clock_start(text_of_time(clock_->start()));
  all.set_speed(virtual_time_ ? virtual_time_->clock().speed() : 1);
  if (virtual_time_) all.set_deliveries(virtual_time_->deliveries());
  all.set_time_s(to_seconds(clock_->now() - clock_->start()));
  auto ordered = status_of_groups(all);
  for (const std::string& name : model_.names()) {
    const std::uint64_t order = model_.instance(name).order;
    if (lost_.contains(name) || !ordered.contains(order)) ordered[order] = status_as_asked_for(name);
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
    one.set_abi(interface->abi());
    one.set_planned(interface->planned());
    *one.mutable_components() = interface->components();
  }
  add_hosts(all);
  for (auto& status : *all.mutable_groups()) status.set_instances(members[status.name()]);
  return all;
}

/// All groups are asked at once: together they take no longer than the slowest, and no longer than `patience`.
std::map<std::uint64_t, control::InstanceStatus> System::status_of_groups(control::System& all) {
  for (const auto& [name, one] : groups_.all()) one->ask_status();
  std::map<std::uint64_t, control::InstanceStatus> ordered;
  for (const auto& [name, one] : groups_.all()) {
    auto& status = *all.add_groups();
    status.set_name(name);
    status.set_process(one->process());
    add_process(status, *one);
    auto reply = one->status(options_.patience);
    status.set_alive(one->alive());
    if (!reply) continue;
    *status.mutable_links() = reply->links();
    for (auto& instance : *reply->mutable_instances()) {
      // Another version of it may stand by in another group.
      const auto* known = model_.find(instance.name());
      if (known && known->group == name) ordered[known->order] = std::move(instance);
    }
  }
  child_groups();  // notes those that turned out to be gone
  return ordered;
}

/// Of an instance that is lost, or whose process does not answer: what the model knows.
control::InstanceStatus System::status_as_asked_for(const std::string& name) const {
  const Model::Instance& one = model_.instance(name);
  control::InstanceStatus status;
  status.set_name(name);
  status.set_plugin(one.package->name);
  status.set_component(one.component);
  status.set_version(one.package->version);
  const control::Load load = model_.load_of(name);
  *status.mutable_rights() = load.rights();
  *status.mutable_set_parameters() = load.parameters();
  const Group* group = groups_.find(one.group);
  const auto silent = group ? group->silent_since() : std::nullopt;
  if (const auto lost = lost_.find(name); lost != lost_.end() || !silent) {
    status.set_mode(std::string(kModeFailed));
    status.set_reason(lost == lost_.end() ? "its process does not answer" : lost->second.reason);
    const auto since = lost == lost_.end() ? std::chrono::steady_clock::now() : lost->second.since;
    status.set_mode_since_s(std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count());
  } else {
    status.set_mode(one.mode);
    status.set_silent_s(std::chrono::duration<double>(std::chrono::steady_clock::now() - *silent).count());
    status.set_reason(fmt::format("its process does not answer, since {:.1f} s", status.silent_s()));
  }
  for (const auto& mode : one.interface().modes()) status.add_modes(mode.name());
  for (const auto& declared : one.interface().ports()) {
    auto& port = *status.add_ports() = as_declared(declared);
    if (declared.direction() == REQUIRES && model_.wire_of(port_of({name, declared.name()})))
      port.set_connection(control::LOST);
  }
  return status;
}

/// What only the whole system knows: groups, wires seen from both ends.
void System::complete_status(control::InstanceStatus& status) const {
  const Model::Instance& known = model_.instance(status.name());
  status.set_group(known.group);
  status.set_restarts(known.group == kMainGroup ? options_.restarts : supervision_.restarts(known.group));
  if (const auto last = supervision_.last_restart(known.group)) {
    status.set_restarted_s(std::chrono::duration<double>(std::chrono::steady_clock::now() - last->at).count());
    status.set_restart_reason(last->reason);
  }
  if (const auto standby = standbys_.find(status.name()); standby != standbys_.end())
    status.set_stands_by(standby->second.made.package->version);
  *status.mutable_rights() = {known.rights.begin(), known.rights.end()};
  // Of one that is away the mode that was asked for last would be lost to who saves the system: it is loaded at that.
  const bool is_elsewhere = status.mode() == kModeFailed && known.mode != known.mode_after_load();
  status.set_mode_at_load(is_elsewhere ? known.mode : known.mode_at_load);
  status.set_comment(known.comment);
  if (known.package->origin == Package::Origin::Path) status.set_library(known.package->library.string());
  for (auto& p : *status.mutable_ports()) {
    for (const auto& [client, wanted] : model_.wires()) {
      if (client.first == status.name() && client.second == p.name()) complete_port(client, wanted, p);
      const auto is_this = [&](const auto& one) { return one.instance() == status.name() && one.port() == p.name(); };
      if (std::any_of(wanted.providers.begin(), wanted.providers.end(), is_this)) *p.add_clients() = port_of(client);
    }
    attachments_.add_clients(status.name(), p);
  }
}

/// A required port's wires, as they are meant to be and as they are.
void System::complete_port(const PortKey& client, const Model::Wire& wanted, control::PortStatus& status) const {
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

const char* System::transport(const std::string& client, const Wire& wire) const {
  if (wire.local) return "process";
  return host_of_instance(client) != host_of_instance(wire.provider.instance()) ? "tcp" : "ipc";
}

}  // namespace fiona::host
