#include "saved_system.hpp"

#include <fmt/format.h>

#include "grammar.hpp"

namespace fiona::console {
namespace {

std::string load_line(const control::InstanceStatus& instance) {
  std::string plugin = instance.plugin();
  // A plugin with several components is loaded by publisher/name/component; its own name is enough otherwise, and
  // both are understood.
  const std::size_t slash = plugin.rfind('/');
  const std::string own = slash == std::string::npos ? plugin : plugin.substr(slash + 1);
  if (!instance.component().empty() && instance.component() != own) plugin += "/" + instance.component();
  std::string line = fmt::format("load {} as {}", typed_text(plugin), typed_text(instance.name()));
  if (!instance.group().empty() && instance.group() != "main")
    line += fmt::format(" in {}", typed_text(instance.group()));
  if (!instance.mode_at_load().empty()) line += fmt::format(" at {}", typed_text(instance.mode_at_load()));
  for (const auto& parameter : instance.set_parameters())
    line += fmt::format(" {}={}", parameter.name(), typed(parameter.value()));
  return line + "\n";
}

std::string wire_lines(const control::InstanceStatus& instance) {
  std::string lines;
  for (const auto& port : instance.ports()) {
    if (port.direction() != fiona::REQUIRES || port.peer().instance().empty()) continue;
    const std::string client = instance.name() + "." + port.name();
    const std::string provider = port.peer().instance() + "." + port.peer().port();
    lines += fmt::format("wire {} to {}", typed_text(client), typed_text(provider));
    if (port.prescale() > 1) lines += fmt::format(" every {}", port.prescale());
    lines += "\n";
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
  if (system.clock() == "virtual") text += fmt::format("set host clock=virtual speed={:g}\n", system.speed());
  for (const auto& instance : system.instances()) text += load_line(instance);
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
