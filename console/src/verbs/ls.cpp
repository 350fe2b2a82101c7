#include <algorithm>
#include <map>

#include <fmt/format.h>
#include <fiona/marketplace/store.hpp>

#include "../catalogue.hpp"
#include "../locations.hpp"
#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// What speaks against a package that something runs of: "NAME VERSION" and why.
std::map<std::string, std::string> marks_of(const Session& session) {
  using marketplace::Store;
  std::map<std::string, std::string> marks;
  const auto& chosen = session.options.store;
  const Store store(chosen.empty() ? Store::default_directory() : chosen);
  for (const auto& revoked : store.revoked()) marks[revoked.package() + " " + revoked.version()] = "revoked";
  // Another marketplace may have one of this name and version, with other content.
  for (const auto& package : store.installed()) {
    if (!store.revocation(package)) marks.erase(package.name() + " " + package.manifest.version());
  }
  return marks;
}

std::string plugin_text(const control::InstanceStatus& instance, const std::map<std::string, std::string>& marks) {
  const std::string name = short_name(instance.plugin().substr(instance.plugin().find('/') + 1));
  if (instance.plugin().starts_with("unsigned/")) return name + " (unsigned)";
  const auto mark = marks.find(instance.plugin() + " " + instance.version());
  return mark == marks.end() ? name : fmt::format("{} ({})", name, mark->second);
}

void ls_instances(Session& session) {
  const control::System system = session.snapshot();
  const auto marks = marks_of(session);
  Table table({"instance", "plugin", "mode", "health", "wires", "rate", "group"});
  for (const auto& instance : system.instances()) {
    int required = 0;
    int connected = 0;
    double rate_hz = 0;
    for (const auto& port : instance.ports()) {
      if (port.direction() == fiona::REQUIRES) ++required;
      if (port.direction() == fiona::REQUIRES && port.connection() == control::CONNECTED) ++connected;
      if (port.direction() == fiona::PROVIDES) rate_hz = std::max(rate_hz, port.rate_hz());
    }
    table.add({instance.name(),
               plugin_text(instance, marks),
               instance.mode(),
               health_text(instance),
               required == 0 ? "-" : fmt::format("{}/{}", connected, required),
               {rate_text(rate_hz), rate_hz},
               instance.group()});
  }
  session.out.table(table, "nothing is loaded\n  next: load PLUGIN [as NAME]   (ls plugins)");
}

void ls_plugins(Session& session) {
  const Catalogue catalogue = session.catalogue();
  Table table({"plugin", "component", "version", "where", "summary"});
  for (const KnownPlugin& plugin : catalogue.plugins()) {
    for (const auto& component : plugin.interface.components()) {
      const std::string where = plugin.installed ? "installed" : "market";
      table.add({plugin.name(), component.name(), plugin.manifest.version(),
                 plugin.mark.empty() ? where : where + ", " + plugin.mark, plugin.manifest.summary()});
    }
  }
  session.out.table(table, "no plugin is installed, and there is no marketplace\n  next: market search --from DIR");
  for (const std::string& problem : catalogue.problems()) session.out.remark(problem);
}

/// The wire of a process outside, as far as its provider knows.
void add_attached(Table& table, const control::AttachedClient& client, const std::string& provider,
                  const control::PortStatus& port) {
  table.add({client.name(),
             provider,
             short_name(port.service()),
             "attached",
             {fmt::format("{}", client.prescale()), client.prescale()},
             {rate_text(port.rate_hz()), port.rate_hz()},
             {age_text(port.age_ms()), port.age_ms()},
             ""});
}

void ls_wires(Session& session) {
  const control::System system = session.snapshot();
  Table table(
      {"client", "provider", "service", "connection", "every", "rate", "age", "dropped", "alternatives", "flaps"});
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      for (const auto& client : port.attached()) add_attached(table, client, instance.name() + "." + port.name(), port);
      if (port.direction() != fiona::REQUIRES || port.connection() == control::UNWIRED) continue;
      table.add({instance.name() + "." + port.name(),
                 text_of(port.peer()),
                 short_name(port.service()),
                 connection_text(port),
                 {fmt::format("{}", std::max(1U, port.prescale())), std::max(1U, port.prescale())},
                 {rate_text(port.rate_hz()), port.rate_hz()},
                 {age_text(port.age_ms()), port.age_ms()},
                 {fmt::format("{}", port.dropped()), port.dropped()},
                 alternatives_text(port),
                 port.providers().empty() ? Table::Cell{"", nullptr}
                                          : Table::Cell{fmt::format("{}", port.flaps()), port.flaps()}});
    }
  }
  session.out.table(table, "no port is wired\n  next: spots");
}

void ls_services(Session& session) {
  const control::System system = session.snapshot();
  struct Use {
    int provided = 0;
    int required = 0;
    int pattern = 0;
  };
  std::map<std::string, Use> services;
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      Use& use = services[port.service()];
      use.pattern = port.pattern();
      ++(port.direction() == fiona::PROVIDES ? use.provided : use.required);
    }
  }
  Table table({"service", "pattern", "provided", "required"});
  for (const auto& [name, use] : services)
    table.add({name,
               pattern_text(use.pattern),
               {fmt::format("{}", use.provided), use.provided},
               {fmt::format("{}", use.required), use.required}});
  session.out.table(table, "nothing is loaded, so no service is spoken");
}

std::string answer_of(const control::System& system) {
  std::string text = "ok";
  const std::uint64_t refused = system.refused_hosts() + system.refused_consoles();
  if (refused > 0) text += fmt::format(", refused {} connections", refused);
  if (system.restarts() > 0) text += fmt::format(", restarted {}x: {}", system.restarts(), system.restart_reason());
  return text;
}

/// What a host says of itself and of the hosts that it works with; keys by their first letters.
void add_host(Table& table, const std::string& name, const Endpoint& endpoint, const control::System& system) {
  constexpr std::size_t kShown = 8;
  std::string where = endpoint.text();
  for (const std::string& also : {system.listens(), system.serves()}) {
    if (!also.empty() && also != endpoint.text()) where += " " + also;
  }
  table.add({name,
             system.version(),
             system.clock(),
             {fmt::format("{}", system.instances_size()), system.instances_size()},
             answer_of(system),
             where,
             system.key().substr(0, kShown),
             "",
             ""});
  for (const auto& host : system.hosts()) {
    table.add({fmt::format("{}>{}", name, host.name()),
               host.version(),
               fmt::format("{:+.1f} ms", host.clock_offset_ms()),
               {fmt::format("{}", host.instances()), host.instances()},
               host.reason().empty() ? "ok" : host.reason(),
               host.address(),
               host.key().substr(0, kShown),
               host.state(),
               {fmt::format("{:.0f} s", host.since_s()), host.since_s()}});
  }
  for (const auto& console : system.consoles()) {
    table.add({fmt::format("{}<{}", name, console.name()),
               "",
               "",
               "",
               "ok",
               console.address(),
               console.key().substr(0, kShown),
               trust::access_text(static_cast<trust::Access>(console.level())),
               {fmt::format("{:.0f} s", console.since_s()), console.since_s()}});
  }
}

void ls_hosts(Session& session) {
  Table table({"host", "version", "clock", "instances", "answer", "endpoint", "key", "state", "since"});
  if (!session.options.at.empty()) {
    const control::System system = session.snapshot();
    add_host(table, system.host(), session.host().endpoint(), system);
    return session.out.table(table, "");
  }
  for (const RunningHost& running : running_hosts()) {
    const Endpoint endpoint{running.socket};
    try {
      ControlClient client(session.reactor, endpoint, session.options.timeout);
      control::Request request;
      request.mutable_snapshot();
      const control::Reply reply = client.call(std::move(request));
      add_host(table, running.name, endpoint, reply.system());
    } catch (const Error& problem) {
      table.add({running.name, "", "", "", problem.text().what, endpoint.text(), "", "", ""});
    }
  }
  session.out.table(table, "no host runs\n  next: fiona run FILE");
}

}  // namespace

void ls(Session& session, const Line& line) {
  const std::string what = line.positional.empty() ? "instances" : line.positional[0].text;
  if (what == "plugins") return ls_plugins(session);
  if (what == "wires") return ls_wires(session);
  if (what == "services") return ls_services(session);
  if (what == "hosts") return ls_hosts(session);
  ls_instances(session);
}

}  // namespace fiona::console::verbs
