// What a marketplace has: by name, text, service, and for white spots; and a package in full before it is installed.
#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/package.hpp>
#include <fiona/marketplace/plan.hpp>
#include <fiona/marketplace/requirement.hpp>

#include "../catalogue.hpp"
#include "../system_check.hpp"
#include "../system_view.hpp"
#include "../types.hpp"
#include "../white_spots.hpp"
#include "interface_view.hpp"
#include "market.hpp"

namespace fiona::console::verbs {
namespace {

using marketplace::Marketplace;

/// Names of services in a row of a table for people.
constexpr std::size_t kMostServices = 6;

/// "GetIMUService, RFSignalRSSIService": what the components of a package provide, or require.
Table::Cell services_of(const IndexEntry& entry, fiona::Direction direction) {
  std::vector<std::string> names;
  for (const auto& component : entry.interface().components()) {
    for (const auto& port : component.ports()) {
      const std::string name = short_name(port.service());
      if (port.direction() == direction && std::find(names.begin(), names.end(), name) == names.end())
        names.push_back(name);
    }
  }
  const std::string all = fmt::format("{}", fmt::join(names, ", "));
  if (names.size() <= kMostServices) return all;
  const std::size_t left = names.size() - kMostServices;
  names.resize(kMostServices);
  return {fmt::format("{} and {} more", fmt::join(names, ", "), left), all};
}

bool has_port(const IndexEntry& entry, fiona::Direction direction, const std::string& service) {
  for (const auto& component : entry.interface().components()) {
    for (const auto& port : component.ports()) {
      if (port.direction() == direction && port.service() == service) return true;
    }
  }
  return false;
}

/// The full name of a service that some package of the marketplace provides or requires, as it was typed in full or
/// without its proto package.
std::string service_named(const Marketplace& market, const Line& line, const Word& typed) {
  std::set<std::string> known;
  for (const IndexEntry& entry : market.search({})) {
    for (const auto& component : entry.interface().components()) {
      for (const auto& port : component.ports()) {
        if (port.service() == typed.text || short_name(port.service()) == typed.text) return port.service();
        known.insert(short_name(port.service()));
      }
    }
  }
  throw line.error(
      typed,
      {.what = fmt::format("no package of the marketplace provides or requires a service '{}'", typed.text),
       .next = "market search" + market.option(),
       .near = nearest_names(typed.text, std::vector<std::string>{known.begin(), known.end()})},
      ErrorCode::NotFound);
}

std::vector<std::string> words_in(const Line& line) {
  std::vector<std::string> words;
  for (std::size_t i = 1; i < line.positional.size(); ++i) words.push_back(line.positional[i].text);
  return words;
}

/// Those with every word and a port for every service that is named.
std::vector<IndexEntry> found_by(const Marketplace& market, const Line& line) {
  std::vector<IndexEntry> entries = market.search(words_in(line));
  for (const auto& [option, direction] : {std::pair{"--provides", fiona::PROVIDES}, {"--requires", fiona::REQUIRES}}) {
    const auto [begin, end] = line.options.equal_range(option);
    for (auto given = begin; given != end; ++given) {
      const std::string service = service_named(market, line, given->second.value);
      std::erase_if(entries, [&, way = direction](const IndexEntry& entry) { return !has_port(entry, way, service); });
    }
  }
  return entries;
}

struct Spot {
  std::string port;
  std::string service;
};

/// The required ports without a provider, of the running host or of a system file.
std::vector<Spot> spots_of(Session& session, const Word& of) {
  std::vector<Spot> spots;
  const Catalogue catalogue = session.catalogue();
  if (of.text == "spots") {
    for (const WhiteSpot& spot : white_spots(session.snapshot(), catalogue)) {
      if (spot.required) spots.push_back({spot.port, spot.service});
    }
    return spots;
  }
  const CheckResult result = check_system(system_path(of.text, session.options.store), catalogue);
  if (!result.errors.empty()) throw LineError(result.errors.front());
  for (const auto& spot : result.spots) spots.push_back({spot.port, spot.service});
  return spots;
}

void search_spots(Session& session, const Line& line, const Marketplace& market, const Word& of) {
  const std::vector<IndexEntry> entries = found_by(market, line);
  const std::vector<Spot> spots = spots_of(session, of);
  Table table({"port", "service", "package", "version", "summary"});
  for (const Spot& spot : spots) {
    for (const IndexEntry& entry : entries) {
      if (has_port(entry, fiona::PROVIDES, spot.service))
        table.add({spot.port, short_name(spot.service), marketplace::full_name(entry.manifest()),
                   entry.manifest().version(), entry.manifest().summary()});
    }
  }
  session.out.table(table, spots.empty() ? "there are no required ports that nobody serves"
                                         : "no package fills any of the white spots");
}

/// "2.0.0 (for FIONA >= 1.0.0), 1.4.0": what does not fit here says why.
std::string versions_text(const std::vector<IndexEntry>& entries) {
  const marketplace::Platform here = marketplace::Platform::here();
  std::vector<std::string> texts;
  for (const IndexEntry& entry : entries) {
    const Manifest& manifest = entry.manifest();
    std::string fault;
    if (!manifest.architecture().empty() && manifest.architecture() != here.architecture)
      fault = "for " + manifest.architecture();
    else if (!manifest.library().empty() && manifest.abi() != here.abi)
      fault = "for another ABI: " + manifest.abi();
    else if (!marketplace::VersionRange::parse(manifest.host(), "").has(*marketplace::Version::parse(here.version)))
      fault = "for FIONA " + manifest.host();
    texts.push_back(fault.empty() ? manifest.version() : fmt::format("{} ({})", manifest.version(), fault));
  }
  return fmt::format("{}", fmt::join(texts, ", "));
}

/// Of one of the versions.
void show_facts(Session& session, const IndexEntry& shown, const std::vector<IndexEntry>& entries) {
  const Manifest& manifest = shown.manifest();
  Table facts({"fact", "value"});
  facts.add({"package", marketplace::full_name(manifest)});
  if (&shown != &entries.front()) facts.add({"version", manifest.version()});
  facts.add({"versions", versions_text(entries)});
  facts.add({"summary", manifest.summary()});
  facts.add({"license", manifest.license()});
  std::vector<std::string> rights;
  for (const std::string& right : manifest.rights()) rights.push_back(right_text(right));
  facts.add({"rights", rights.empty() ? "none beyond a sandbox" : fmt::format("{}", fmt::join(rights, "; "))});
  for (const std::string& text : manifest.requirements()) facts.add({"requires", text});
  for (const std::string& text : manifest.conflicts()) facts.add({"not with", text});
  if (!manifest.host().empty()) facts.add({"works with", "FIONA " + manifest.host()});
  facts.add({"size", {fmt::format("{} KiB", shown.size() / 1024), shown.size()}});
  for (const std::string& try_line : split_lines(manifest.try_())) facts.add({"try", try_line});
  session.out.table(facts, "", false);
}

}  // namespace

void market_search(Session& session, const Line& line) {
  const Marketplace market = chosen_market(session, line);
  if (const Word* of = line.clause("for")) return search_spots(session, line, market, *of);
  Table table({"package", "version", "provides", "requires", "summary"});
  for (const IndexEntry& entry : found_by(market, line)) {
    table.add({marketplace::full_name(entry.manifest()), entry.manifest().version(),
               services_of(entry, fiona::PROVIDES), services_of(entry, fiona::REQUIRES), entry.manifest().summary()});
  }
  const std::vector<std::string> words = words_in(line);
  session.out.table(table, words.empty() && line.options.count("--provides") + line.options.count("--requires") == 0
                               ? "the marketplace is empty"
                           : words.empty() ? "no package does"
                                           : fmt::format("no package has {}", fmt::join(words, " and ")));
}

void market_info(Session& session, const Line& line) {
  const Marketplace market = chosen_market(session, line);
  const marketplace::PackageRequest asked = market.resolve(line.positional[1].text);
  const std::vector<IndexEntry> entries = market.info(asked.package);
  const auto is_asked = [&](const IndexEntry& entry) {
    return !asked.version || marketplace::Version::parse(entry.manifest().version()) == asked.version;
  };
  const IndexEntry& shown = *std::find_if(entries.begin(), entries.end(), is_asked);
  // The interface with its types is in the package; reading it checks the whole file and opens no library.
  const auto contents = marketplace::inspect_package(market.package(shown));
  show_facts(session, shown, entries);
  const TypeSet types(contents.interface.descriptors());
  for (const auto& component : contents.interface.components()) show_component(session, component, types);
}

}  // namespace fiona::console::verbs
