#include "system_view.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <fiona/hull_probes.hpp>

namespace fiona::console {

std::vector<std::string> instance_names(const control::System& system) {
  std::vector<std::string> names;
  for (const auto& instance : system.instances()) names.push_back(instance.name());
  return names;
}

const control::InstanceStatus* find_instance(const control::System& system, std::string_view name) {
  const auto found = std::find_if(system.instances().begin(), system.instances().end(),
                                  [name](const auto& instance) { return instance.name() == name; });
  return found == system.instances().end() ? nullptr : &*found;
}

const control::PortStatus* find_port(const control::InstanceStatus& instance, std::string_view name) {
  const auto found = std::find_if(instance.ports().begin(), instance.ports().end(),
                                  [name](const auto& port) { return port.name() == name; });
  return found == instance.ports().end() ? nullptr : &*found;
}

const control::InstanceStatus& instance_at(const control::System& system, const Word& word, const Line& line) {
  const std::string name = word.text.substr(0, word.text.find('.'));
  if (const auto* instance = find_instance(system, name)) return *instance;
  throw line.error(word,
                   {.what = fmt::format("there is no instance '{}'", name),
                    .next = "ls",
                    .near = nearest_names(name, instance_names(system))},
                   ErrorCode::NotFound);
}

const control::PortStatus& port_at(const control::System& system, const Word& word, const Line& line) {
  const control::PortName name = watched_name(word, line.words);
  const auto& instance = instance_at(system, word, line);
  if (const auto* port = find_port(instance, name.port())) return *port;
  std::vector<std::string> known;
  for (const auto& port : instance.ports()) known.push_back(port.name());
  for (const ProbeInfo& probe : probes_of(instance)) known.push_back(probe.name);
  throw line.error(word,
                   {.what = fmt::format("{} has no port or probe '{}'", instance.name(), name.port()),
                    .next = fmt::format("show {}", instance.name()),
                    .near = nearest_names(name.port(), known)},
                   ErrorCode::NotFound);
}

namespace {

const std::string& name_of(const control::TaskStatus& task) { return task.task().name(); }
const std::string& name_of(const fiona::TaskInterface& task) { return task.name(); }

template <class Owner>
std::vector<ProbeInfo> probes_of_any(const Owner& instance) {
  std::vector<ProbeInfo> found;
  for (const auto& probe : instance.probes()) found.push_back({probe.name(), probe.type(), probe.unit(), probe.doc()});
  const auto add = [&found](const std::string& of, const HullProbe& one) {
    found.push_back({of + std::string(one.name), std::string(one.type), std::string(one.unit), std::string(one.doc)});
  };
  for (const HullProbe& one : hull_probes()) {
    if (one.of == HullProbe::Of::Instance) add("", one);
    for (int i = 0; one.of == HullProbe::Of::Port && i < instance.ports_size(); ++i)
      add(instance.ports(i).name() + ".", one);
    for (int i = 0; one.of == HullProbe::Of::Task && i < instance.tasks_size(); ++i)
      add(name_of(instance.tasks(i)) + ".", one);
  }
  return found;
}

}  // namespace

std::vector<ProbeInfo> probes_of(const control::InstanceStatus& instance) { return probes_of_any(instance); }
std::vector<ProbeInfo> probes_of(const fiona::ComponentInterface& component) { return probes_of_any(component); }

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

std::string clients_text(const control::PortStatus& port) {
  std::vector<std::string> clients;
  for (const auto& client : port.clients()) clients.push_back(text_of(client));
  for (const auto& client : port.attached()) clients.push_back(client.name() + " (attached)");
  return fmt::format("{}", fmt::join(clients, ", "));
}

std::string short_name(std::string_view full_name) {
  const std::size_t dot = full_name.rfind('.');
  return std::string(dot == std::string_view::npos ? full_name : full_name.substr(dot + 1));
}

std::string connection_text(const control::PortStatus& port) {
  const auto with_reason = [&port](const char* word) {
    return port.reason().empty() ? std::string(word) : fmt::format("{}: {}", word, port.reason());
  };
  switch (port.connection()) {
    case control::UNWIRED: return "unwired";
    case control::WAITING: return with_reason("waiting");
    case control::CONNECTED: return "connected";
    case control::LOST: return with_reason("lost");
    default: return "unknown";
  }
}

std::string alternative_text(const control::ProviderStatus& provider) {
  const std::string name = text_of(provider.provider());
  if (provider.fit()) return name + (provider.serves() ? " serves" : " ready");
  if (provider.reason().empty()) return name + " unknown";
  // The reason begins with the name: "gps.location has been silent for 500 ms".
  return provider.reason().starts_with(name) ? provider.reason() : name + ": " + provider.reason();
}

std::string alternatives_text(const control::PortStatus& port) {
  std::string text;
  for (const auto& provider : port.providers()) text += (text.empty() ? "" : "; ") + alternative_text(provider);
  return text;
}

std::string health_text(const control::InstanceStatus& instance) {
  if (instance.silent_s() > 0) return "silent: " + instance.reason();
  if (instance.mode() == "failed") return instance.reason().empty() ? "failed" : "failed: " + instance.reason();
  for (const auto connection : {control::LOST, control::WAITING}) {
    for (const auto& port : instance.ports()) {
      if (port.direction() == fiona::REQUIRES && port.connection() == connection)
        return fmt::format("{} {}", connection == control::LOST ? "lost" : "waiting", port.name());
    }
  }
  for (const auto& port : instance.ports()) {
    if (port.direction() == fiona::REQUIRES && !port.optional() && port.connection() == control::UNWIRED)
      return fmt::format("unwired {}", port.name());
  }
  return "ok";
}

std::string rate_text(double rate_hz) {
  if (rate_hz <= 0) return "-";
  return rate_hz >= 10 ? fmt::format("{:.0f} Hz", rate_hz) : fmt::format("{:.2g} Hz", rate_hz);
}

std::vector<std::string> split_lines(std::string_view text) {
  std::vector<std::string> lines;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    if (end > 0) lines.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::string latency_text(double latency_ms) {
  if (latency_ms < 1) return fmt::format("{:.0f} us", 1000 * latency_ms);
  return latency_ms < 10 ? fmt::format("{:.1f} ms", latency_ms) : age_text(latency_ms);
}

std::string age_text(double age_ms) {
  if (age_ms < 0) return "never";
  return age_ms < 1000 ? fmt::format("{:.0f} ms", age_ms) : fmt::format("{:.1f} s", age_ms / 1000);
}

}  // namespace fiona::console
