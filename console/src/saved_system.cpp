#include "saved_system.hpp"

#include <fmt/format.h>

#include "changes.hpp"
#include "grammar.hpp"
#include "inert.hpp"
#include "system_view.hpp"

namespace fiona::console {
namespace {

control::Change load_of(const control::InstanceStatus& instance) {
  control::Change change;
  control::Load& load = *change.mutable_load();
  load.set_plugin(instance.library().empty() ? instance.plugin() : instance.library());
  // A plugin with several components is loaded by publisher/name/component; its own name is enough otherwise, and
  // both are understood.
  const std::string own = instance.plugin().substr(instance.plugin().rfind('/') + 1);
  if (!instance.component().empty() && instance.component() != own)
    load.set_plugin(load.plugin() + "/" + instance.component());
  load.set_instance(instance.name());
  load.set_group(instance.group());
  load.set_mode(instance.mode_at_load());
  *load.mutable_rights() = instance.rights();
  *load.mutable_parameters() = instance.set_parameters();
  return change;
}

void add_alternatives(const control::PortStatus& port, control::Wire& wire) {
  if (port.providers().empty()) return;
  *wire.mutable_provider() = port.providers(0).provider();
  for (int i = 1; i < port.providers_size(); ++i) *wire.add_alternatives() = port.providers(i).provider();
  wire.set_hold_ms(port.hold_ms());
}

std::string wire_lines(const control::InstanceStatus& instance) {
  std::string lines;
  for (const auto& port : instance.ports()) {
    if (port.direction() != fiona::REQUIRES || port.peer().instance().empty()) continue;
    control::Change change;
    change.mutable_wire()->mutable_client()->set_instance(instance.name());
    change.mutable_wire()->mutable_client()->set_port(port.name());
    *change.mutable_wire()->mutable_provider() = port.peer();
    if (port.prescale() > 1) change.mutable_wire()->set_prescale(port.prescale());
    add_alternatives(port, *change.mutable_wire());
    lines += line_of(change) + "\n";
  }
  return lines;
}

bool is_main_mode(const control::InstanceStatus& instance) {
  return instance.mode() != "init" && instance.mode() != "failed" && instance.mode() != "shutdown" &&
         !instance.mode().empty();
}

}  // namespace

std::string saved_system(const control::System& system) {
  std::string text;
  if (system.clock() == "virtual") {
    const std::string start = system.clock_start().empty() ? "" : " start=" + system.clock_start();
    text += fmt::format("set host clock=virtual{} speed={}\n", start, system.speed());
  }
  for (const auto& instance : system.instances()) {
    for (const std::string& line : split_lines(instance.comment())) text += "# " + inert(line) + "\n";
    text += line_of(load_of(instance)) + "\n";
  }
  for (const auto& instance : system.instances()) text += wire_lines(instance);
  for (const auto& instance : system.instances()) {
    const std::string first = instance.modes().empty() ? "active" : instance.modes(0);
    const std::string at_load = instance.mode_at_load().empty() ? first : instance.mode_at_load();
    if (is_main_mode(instance) && instance.mode() != at_load)
      text += fmt::format("state {} {}\n", typed_text(instance.name()), typed_text(instance.mode()));
  }
  return text;
}

}  // namespace fiona::console
