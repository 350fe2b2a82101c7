#include "fiona/describe.hpp"

#include <google/protobuf/descriptor.h>

#include <deque>
#include <set>
#include <sstream>

#include "fiona/clock.hpp"
#include "fiona/testing/inline_executor.hpp"

namespace fiona {
namespace {

using google::protobuf::FileDescriptor;

/// The files that libfiona-msgs carries; every other file is a plugin's own.
const std::set<std::string>& platform_files() {
  static const std::set<std::string> files = [] {
    std::istringstream names(FIONA_PLATFORM_PROTOS);
    std::set<std::string> all;
    for (std::string name; names >> name;) all.insert(name);
    return all;
  }();
  return files;
}

}  // namespace

bool is_platform_proto(const std::string& file) {
  return platform_files().contains(file) || file.starts_with("google/protobuf/");
}

namespace {

/// Appends `file` and what it imports, dependencies before users, leaving out the platform's.
void add_files(const FileDescriptor& file, std::set<std::string>& seen, google::protobuf::FileDescriptorSet& set) {
  if (is_platform_proto(file.name()) || !seen.insert(file.name()).second) return;
  for (int i = 0; i < file.dependency_count(); ++i) add_files(*file.dependency(i), seen, set);
  file.CopyTo(set.add_file());
}

void name_shared(const std::set<std::string>& shared, Interface& interface) {
  for (const auto& file : interface.descriptors().file()) {
    if (shared.contains(file.name())) interface.add_shared(file.name());
  }
}

class SilentEvents final : public HullEvents {
 public:
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
};

}  // namespace

TaskInterface interface_of(const Task& task) {
  const When& when = task.when();
  TaskInterface interface;
  interface.set_name(task.name());
  interface.set_start(static_cast<TaskStart>(when.kind()));
  interface.set_period_ms(1e3 * to_seconds(when.period()));
  interface.set_of(when.of());
  if (when.kind() == When::Kind::OnPort) interface.set_every(when.every());
  interface.set_activity(task.activity());
  return interface;
}

TriggerInterface interface_of(const detail::TriggerBase& trigger) {
  TriggerInterface interface;
  interface.set_name(trigger.name());
  interface.set_argument(trigger.argument().full_name());
  interface.set_result(trigger.result().full_name());
  interface.set_doc(trigger.doc());
  interface.set_activity(trigger.activity());
  return interface;
}

ProbeInterface interface_of(const detail::ProbeBase& probe) {
  ProbeInterface interface;
  interface.set_name(probe.name());
  interface.set_type(probe.type());
  interface.set_unit(probe.unit());
  interface.set_doc(probe.doc());
  return interface;
}

ComponentInterface interface_of(const Hull& hull, std::string_view component, std::string_view doc) {
  ComponentInterface interface;
  interface.set_name(std::string(component));
  interface.set_doc(std::string(doc));
  for (const Port* port : hull.ports()) {
    auto& one = *interface.add_ports();
    one.set_name(port->name());
    one.set_direction(port->direction() == PortDirection::Provides ? PROVIDES : REQUIRES);
    one.set_service(port->service().name());
    one.set_optional(port->optional());
    one.set_doc(port->doc());
    one.set_activity(port->activity());
  }
  if (hull.parameters()) interface.set_parameters(hull.parameters()->snapshot()->GetDescriptor()->full_name());
  for (const auto& mode : hull.modes()) {
    auto& one = *interface.add_modes();
    one.set_name(mode.name);
    one.mutable_activities()->Add(mode.activities.begin(), mode.activities.end());
  }
  for (const Task* task : hull.tasks()) *interface.add_tasks() = interface_of(*task);
  for (const auto* trigger : hull.triggers()) *interface.add_triggers() = interface_of(*trigger);
  for (const auto* probe : hull.probes()) *interface.add_probes() = interface_of(*probe);
  if (hull.asks_to_be_master()) interface.add_rights("master");
  return interface;
}

Interface describe(const Plugin& plugin, const std::set<std::string>& shared) {
  Interface interface;
  interface.set_abi(kAbiTag);
  std::set<std::string> seen;
  testing::InlineExecutor executor;
  VirtualClock clock;
  SilentEvents events;
  for (const auto& entry : plugin.entries()) {
    Hull hull(entry.name, {executor, clock, events, {}});
    hull.create(entry.make);
    *interface.add_components() = interface_of(hull, entry.name, entry.doc);
    for (const Port* port : hull.ports()) {
      add_files(*port->service().descriptor().file(), seen, *interface.mutable_descriptors());
    }
    for (const auto* trigger : hull.triggers()) {
      add_files(*trigger->argument().file(), seen, *interface.mutable_descriptors());
      add_files(*trigger->result().file(), seen, *interface.mutable_descriptors());
    }
    for (const auto* probe : hull.probes()) add_files(*probe->object().file(), seen, *interface.mutable_descriptors());
    if (hull.parameters()) {
      add_files(*hull.parameters()->snapshot()->GetDescriptor()->file(), seen, *interface.mutable_descriptors());
    }
    hull.shut_down(std::chrono::seconds(2));
  }
  name_shared(shared, interface);
  return interface;
}

Interface describe_messages(const std::set<std::string>& proto_files, const std::set<std::string>& shared) {
  Interface interface;
  interface.set_abi(kAbiTag);
  std::set<std::string> seen;
  for (const auto& name : proto_files) {
    const auto* file = google::protobuf::DescriptorPool::generated_pool()->FindFileByName(name);
    if (!file)
      throw Error(ErrorCode::Failed, {.what = "the message library does not bring the proto file '" + name + "'",
                                      .next = "build it again: fiona_add_messages compiles what PROTOS names"});
    add_files(*file, seen, *interface.mutable_descriptors());
  }
  name_shared(shared, interface);
  return interface;
}

std::string interface_difference(const ComponentInterface& declared, const ComponentInterface& packaged) {
  const auto text = [](const PortInterface& port) {
    return (port.direction() == PROVIDES ? "provides " : "requires ") + port.name() + " (" + port.service() + ")" +
           (port.optional() ? ", optional" : "");
  };
  for (int i = 0; i < std::max(declared.ports_size(), packaged.ports_size()); ++i) {
    const std::string is = i < declared.ports_size() ? text(declared.ports(i)) : "no further port";
    const std::string said = i < packaged.ports_size() ? text(packaged.ports(i)) : "no further port";
    if (is != said) return "it " + is + "; its interface says: " + said;
  }
  if (declared.parameters() != packaged.parameters()) {
    return "its parameters are '" + declared.parameters() + "'; its interface says '" + packaged.parameters() + "'";
  }
  if (declared.rights_size() > packaged.rights_size()) {
    return "it uses the right '" + declared.rights(0) + "'; its interface does not say so";
  }
  return {};
}

}  // namespace fiona
