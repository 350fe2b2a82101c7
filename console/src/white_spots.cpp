#include "white_spots.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "system_view.hpp"

namespace fiona::console {
namespace {

constexpr std::size_t kMostOfAKind = 3;

bool is_unserved(const control::PortStatus& port) {
  return port.direction() == fiona::REQUIRES && port.connection() != control::CONNECTED;
}
bool is_unused(const control::PortStatus& port) {
  return port.direction() == fiona::PROVIDES && port.clients().empty() && port.attached().empty();
}

/// It is wired to somebody who is there and says nothing just now, as before their first word: `expect` is for that.
bool is_quiet(const control::PortStatus& port, const control::InstanceStatus* provider) {
  return port.connection() == control::LOST && provider && provider->mode() != "failed" && provider->silent_s() <= 0;
}

/// That there are more than are named, and where.
void add_rest(WhiteSpot& spot, const char* from, std::size_t count, std::string line) {
  if (count > kMostOfAKind)
    spot.fillers.push_back({from, fmt::format("{} more", count - kMostOfAKind), std::move(line)});
}

/// Nobody is served by what they provide themselves.
void add_running(WhiteSpot& spot, const control::System& system, const std::string& own) {
  std::size_t count = 0;
  for (const auto& instance : system.instances()) {
    if (instance.name() == own) continue;
    for (const auto& port : instance.ports()) {
      const std::string name = instance.name() + "." + port.name();
      const bool fits =
          port.service() == spot.service && (spot.required ? port.direction() == fiona::PROVIDES : is_unserved(port));
      if (!fits || ++count > kMostOfAKind) continue;
      spot.fillers.push_back({"running", name,
                              spot.required ? fmt::format("wire {} to {}", spot.port, name)
                                            : fmt::format("wire {} to {}", name, spot.port)});
    }
  }
  add_rest(spot, "running", count, "ls services");
}

void add_known(WhiteSpot& spot, const Catalogue& catalogue) {
  std::size_t installed = 0;
  std::size_t offered = 0;
  for (const KnownComponent& known :
       catalogue.with_port(spot.required ? fiona::PROVIDES : fiona::REQUIRES, spot.service)) {
    if (known.plugin->mark.starts_with("revoked")) continue;  // nobody could load it
    if (++(known.plugin->installed ? installed : offered) > kMostOfAKind) continue;
    const std::string& mark = known.plugin->mark;
    const std::string what = fmt::format("{} {}{}", known.load_name(), known.plugin->manifest.version(),
                                         mark.empty() ? "" : " (" + mark + ")");
    spot.fillers.push_back({known.plugin->installed ? "installed" : "market", what,
                            known.plugin->installed ? fmt::format("load {}", known.load_name())
                                                    : fmt::format("market install {}", known.plugin->name())});
  }
  add_rest(spot, "installed", installed, "ls plugins");
  add_rest(spot, "market", offered,
           fmt::format("market search {} {}", spot.required ? "--provides" : "--requires", short_name(spot.service)));
}

/// Of a port that is served: those that could not take over.
void add_missing_alternatives(std::vector<WhiteSpot>& spots, const control::InstanceStatus& instance,
                              const control::PortStatus& port) {
  if (port.connection() != control::CONNECTED) return;
  for (const auto& provider : port.providers()) {
    if (provider.connection() == control::CONNECTED) continue;
    const std::string state = "served, an alternative is missing";
    spots.push_back({true,
                     false,
                     instance.name() + "." + port.name(),
                     port.service(),
                     state,
                     {{"alternative", alternative_text(provider), ""}}});
  }
}

}  // namespace

std::vector<WhiteSpot> white_spots(const control::System& system, const Catalogue& catalogue) {
  std::vector<WhiteSpot> spots;
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      add_missing_alternatives(spots, instance, port);
      if (!is_unserved(port) && !is_unused(port)) continue;
      const bool required = port.direction() == fiona::REQUIRES;
      WhiteSpot& spot = spots.emplace_back(WhiteSpot{required,
                                                     port.optional(),
                                                     instance.name() + "." + port.name(),
                                                     port.service(),
                                                     required ? connection_text(port) : "",
                                                     {}});
      add_running(spot, system, instance.name());
      add_known(spot, catalogue);
    }
  }
  std::stable_sort(spots.begin(), spots.end(),
                   [](const WhiteSpot& a, const WhiteSpot& b) { return a.required > b.required; });
  return spots;
}

std::vector<std::string> strict_spots(const control::System& system) {
  std::vector<std::string> ports;
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      const std::string& wanted = port.peer().instance();
      const auto* provider = wanted.empty() ? nullptr : find_instance(system, wanted);
      const bool waits_for_nobody = !wanted.empty() && provider == nullptr;
      if (is_unserved(port) && !is_quiet(port, provider) && (!port.optional() || waits_for_nobody))
        ports.push_back(instance.name() + "." + port.name());
    }
  }
  return ports;
}

}  // namespace fiona::console
