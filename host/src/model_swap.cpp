// Swaps: what takes the place of each port of an instance, and the wires that are moved.
#include <fmt/format.h>

#include <algorithm>

#include "fiona/contract.hpp"
#include "fiona/error.hpp"
#include "model.hpp"

namespace fiona::host {

std::vector<std::pair<control::PortName, control::PortName>> Model::replaced_by(const control::Replace& swap) const {
  instance(swap.old());
  instance(swap.next());
  std::map<PortKey, control::PortName> found;
  for (const auto& [client, wire] : wires_) {
    for (const auto& provider : wire.providers) {
      if (provider.instance() == swap.old()) found.emplace(key_of(provider), counterpart(provider, swap.next()));
    }
  }
  std::vector<std::pair<control::PortName, control::PortName>> pairs;
  for (const auto& [old, next] : found) pairs.emplace_back(port_of(old), next);
  return pairs;
}

std::vector<control::Change> Model::steps_of(const control::Change& change) const {
  if (!change.has_replace()) return {change};
  const control::Replace& swap = change.replace();
  instance(swap.old());
  instance(swap.next());
  std::vector<control::Change> steps;
  for (const auto& [client, wire] : wires_) {
    if (!wire.uses(swap.old())) continue;
    Wire moved = wire;
    for (auto& provider : moved.providers) {
      if (provider.instance() == swap.old()) provider = counterpart(provider, swap.next());
    }
    // One that was an alternative already is there once, in the better place.
    auto& all = moved.providers;
    for (auto one = all.begin(); one != all.end(); ++one) {
      const std::string name = text_of(*one);
      all.erase(std::remove_if(one + 1, all.end(), [&](const auto& other) { return text_of(other) == name; }),
                all.end());
    }
    steps.push_back(moved.change_for(client, &wire));
  }
  if (!steps.empty()) return steps;
  throw Error(ErrorCode::NotFound,
              {.what = "nobody uses '" + swap.old() + "'", .where = swap.old(), .next = "ls wires"});
}

/// The port of `next` that can take the place of this one: the one of its name, or the only one of its service.
control::PortName Model::counterpart(const control::PortName& provider, const std::string& next) const {
  const std::string service = port(provider, PROVIDES).service();
  std::vector<std::string> fitting;
  for (const auto& one : instance(next).interface().ports()) {
    if (one.direction() != PROVIDES || one.service() != service) continue;
    if (one.name() == provider.port()) return port_of({next, one.name()});
    fitting.push_back(one.name());
  }
  if (fitting.size() == 1) return port_of({next, fitting.front()});
  throw Error(ErrorCode::WiringInvalid,
              {.what = fmt::format("'{}' has {} for {} of {}", next, fitting.empty() ? "no port" : "more than one port",
                                   last_part(service), text_of(provider)),
               .found = fmt::format("{}", fmt::join(fitting, ", ")),
               .next = fitting.empty() ? "show " + next
                                       : fmt::format("wire each client by hand: wire CLIENT.PORT to {}.{}", next,
                                                     fitting.front())});
}

}  // namespace fiona::host
