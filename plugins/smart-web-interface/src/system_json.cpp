#include "system_json.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "to_json.hpp"

namespace fiona::smart_web_interface {
namespace {

using nlohmann::json;

std::string name_of(const std::string& instance, const std::string& port) { return instance + "." + port; }

std::string_view word_of(control::Connection connection) {
  switch (connection) {
    case control::CONNECTED: return "connected";
    case control::WAITING: return "waiting";
    case control::LOST: return "lost";
    default: return "unwired";
  }
}

json instance_of(const control::InstanceStatus& one) {
  json value{{"name", one.name()}, {"plugin", one.plugin()}, {"version", one.version()},  {"group", one.group()},
             {"mode", one.mode()}, {"reason", one.reason()}, {"restarts", one.restarts()}};
  if (one.silent_s() > 0) value["silent"] = std::round(one.silent_s());
  return value;
}

/// Those that provide the service, but for who serves already and the instance itself.
json fitting(const control::System& system, const std::string& instance, const control::PortStatus& port) {
  json found = json::array();
  for (const control::InstanceStatus& other : system.instances()) {
    if (other.name() == instance) continue;
    for (const control::PortStatus& provided : other.ports()) {
      const bool serves = port.peer().instance() == other.name() && port.peer().port() == provided.name();
      if (provided.direction() == PROVIDES && provided.service() == port.service() && !serves) {
        found.push_back(name_of(other.name(), provided.name()));
      }
    }
  }
  return found;
}

json wire_of(const control::System& system, const std::string& instance, const control::PortStatus& port) {
  const bool wired = !port.peer().instance().empty();
  json value{{"client", name_of(instance, port.name())},
             {"service", port.service().substr(port.service().rfind('.') + 1)},
             {"provider", wired ? json(name_of(port.peer().instance(), port.peer().port())) : json(nullptr)},
             {"optional", port.optional()},
             {"state", word_of(port.connection())},
             {"reason", port.reason()},
             {"messages", port.messages()},
             {"dropped", port.dropped() + port.refused()},
             // One with alternatives has its own rule of who serves.
             {"fits", port.providers_size() > 1 ? json::array() : fitting(system, instance, port)}};
  if (port.rate_hz() > 0) value["rate"] = std::round(port.rate_hz() * 10) / 10;
  if (port.age_ms() >= 0) value["age"] = std::round(port.age_ms());
  return value;
}

}  // namespace

std::string system_json(const control::System& system, bool may_change) {
  json instances = json::array();
  json wires = json::array();
  for (const control::InstanceStatus& one : system.instances()) {
    instances.push_back(instance_of(one));
    for (const control::PortStatus& port : one.ports()) {
      if (port.direction() == REQUIRES) wires.push_back(wire_of(system, one.name(), port));
    }
  }
  return text_of({{"host", system.host()},
                  {"clock", system.clock()},
                  {"mayChange", may_change},
                  {"instances", instances},
                  {"wires", wires}});
}

const control::PortStatus* port_of(const control::System& system, std::string_view name) {
  for (const control::InstanceStatus& one : system.instances()) {
    for (const control::PortStatus& port : one.ports()) {
      if (name_of(one.name(), port.name()) == name) return &port;
    }
  }
  return nullptr;
}

}  // namespace fiona::smart_web_interface
