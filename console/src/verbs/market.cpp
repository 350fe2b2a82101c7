// The only verb that changes a store; with catalogue.cpp the only file that knows the marketplace library.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>

#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

marketplace::Marketplace chosen_market(const Line& line) {
  const Word* from = line.option("--from");
  return from == nullptr ? marketplace::Marketplace() : marketplace::Marketplace(from->text);
}

std::string components_text(const IndexEntry& entry) {
  std::vector<std::string> names;
  for (const auto& component : entry.interface().components()) names.push_back(component.name());
  return fmt::format("{}", fmt::join(names, ", "));
}

void search(Session& session, const Line& line) {
  std::vector<std::string> words;
  for (std::size_t i = 1; i < line.positional.size(); ++i) words.push_back(line.positional[i].text);
  Table table({"package", "version", "components", "summary"});
  for (const IndexEntry& entry : chosen_market(line).search(words)) {
    table.add({marketplace::full_name(entry.manifest()), entry.manifest().version(), components_text(entry),
               entry.manifest().summary()});
  }
  session.out.table(
      table, words.empty() ? "the marketplace is empty" : fmt::format("no package has {}", fmt::join(words, " and ")));
}

void info(Session& session, const Line& line) {
  const std::vector<IndexEntry> entries = chosen_market(line).info(line.positional[1].text);
  const Manifest& newest = entries.front().manifest();
  std::vector<std::string> versions;
  for (const IndexEntry& entry : entries) versions.push_back(entry.manifest().version());
  Table facts({"fact", "value"});
  facts.add({"package", marketplace::full_name(newest)});
  facts.add({"versions", fmt::format("{}", fmt::join(versions, ", "))});
  facts.add({"summary", newest.summary()});
  facts.add({"license", newest.license()});
  facts.add({"rights",
             newest.rights().empty() ? "none beyond a sandbox" : fmt::format("{}", fmt::join(newest.rights(), ", "))});
  facts.add({"size", {fmt::format("{} KiB", entries.front().size() / 1024), entries.front().size()}});
  facts.add({"signed", entries.front().signature().empty() ? "no" : "yes"});
  for (const std::string& hello : split_lines(newest.hello())) facts.add({"try", hello});
  session.out.table(facts, "", false);
  for (const auto& component : entries.front().interface().components()) {
    Table ports({"port", "direction", "service", "doc"});
    for (const auto& port : component.ports())
      ports.add({port.name(),
                 port.direction() == PROVIDES ? "provides"
                 : port.optional()            ? "requires, optional"
                                              : "requires",
                 short_name(port.service()), port.doc()});
    session.out.text(fmt::format("\n{}  {}", component.name(), component.doc()));
    session.out.table(ports, "it has no ports");
  }
}

std::string outcome_text(const marketplace::InstallResult& result) {
  const std::string package = fmt::format("{} {}", result.package.name(), result.package.manifest.version());
  switch (result.outcome) {
    case marketplace::InstallOutcome::Installed: return "installed " + package;
    case marketplace::InstallOutcome::Replaced:
      return fmt::format("installed {} in place of {}", package, result.previous_version);
    case marketplace::InstallOutcome::Repaired: return "repaired " + package;
    case marketplace::InstallOutcome::AlreadyInstalled: return package + " is installed already";
  }
  return package;
}

void install(Session& session, const Line& line) {
  const marketplace::Marketplace market = chosen_market(line);
  const std::filesystem::path store =
      session.options.store.empty() ? marketplace::Store::default_directory() : session.options.store;
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    const marketplace::InstallResult result = marketplace::install(line.positional[i].text, market, store);
    session.out.done(outcome_text(result),
                     {{"package", result.package.name()}, {"version", result.package.manifest.version()}});
    if (result.outcome != marketplace::InstallOutcome::Installed) continue;
    for (const std::string& hello : split_lines(result.package.manifest.hello())) session.out.remark("  try: " + hello);
  }
}

}  // namespace

void market(Session& session, const Line& line) {
  const std::string& action = line.positional[0].text;
  if (action == "search") return search(session, line);
  if (action == "info") return info(session, line);
  install(session, line);
}

}  // namespace fiona::console::verbs
