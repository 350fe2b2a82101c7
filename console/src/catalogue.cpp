#include "catalogue.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fiona/error.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/open.hpp>
#include <fiona/marketplace/store.hpp>

namespace fiona::console {
namespace {

void add_installed(std::vector<KnownPlugin>& plugins, std::vector<std::string>& problems,
                   const marketplace::Store& store) {
  for (const auto& package : store.installed()) {
    if (package.manifest.kind() != fiona::PLUGIN) continue;
    try {
      plugins.push_back({package.manifest, package.interface(), true});
      KnownPlugin& added = plugins.back();
      if (package.is_unsigned) {
        added.mark = "unsigned";
        added.manifest.set_publisher(added.mark);
      }
      if (const auto revoked = store.revocation(package)) added.mark = "revoked: " + revoked->reason();
    } catch (const Error& problem) {
      problems.push_back(problem.what());
    }
  }
}

void add_offered(std::vector<KnownPlugin>& plugins) {
  // Completion and white spots must not wait for a server: of one, they know what was fetched before.
  const auto market = marketplace::open_marketplace({}, {.ask_network = false});
  for (const auto& entry : market.search({})) {
    const auto same = [&entry](const KnownPlugin& known) {
      return known.manifest.publisher() == entry.manifest().publisher() &&
             known.manifest.name() == entry.manifest().name();
    };
    const bool there = std::any_of(plugins.begin(), plugins.end(), same);
    if (!there && entry.manifest().kind() == fiona::PLUGIN)
      plugins.push_back({entry.manifest(), entry.interface(), false});
  }
}

}  // namespace

std::string KnownComponent::load_name() const {
  return plugin->interface.components_size() == 1 ? plugin->name() : plugin->name() + "/" + component->name();
}

Catalogue::Catalogue(const std::filesystem::path& store, const std::filesystem::path& unsigned_packages) {
  using marketplace::Store;
  try {
    add_installed(plugins_, problems_, Store(store.empty() ? Store::default_directory() : store));
    if (!unsigned_packages.empty()) add_installed(plugins_, problems_, Store(unsigned_packages, Store::Kind::Unsigned));
  } catch (const Error& problem) {
    problems_.push_back(problem.what());
  }
  try {
    add_offered(plugins_);
  } catch (const Error& problem) {
    // A machine without a marketplace directory is a normal one.
    if (problem.code() != ErrorCode::NotFound) problems_.push_back(problem.what());
  }
}

std::vector<KnownComponent> Catalogue::find(std::string_view name) const {
  std::vector<KnownComponent> found;
  for (const KnownPlugin& plugin : plugins_) {
    for (const auto& component : plugin.interface.components()) {
      const std::string tail = "/" + component.name();
      const bool whole = name == plugin.name() || name == plugin.manifest.name();
      if (whole || name == plugin.name() + tail || name == plugin.manifest.name() + tail)
        found.push_back({&plugin, &component});
    }
  }
  return found;
}

std::vector<KnownComponent> Catalogue::with_port(fiona::Direction direction, std::string_view service) const {
  std::vector<KnownComponent> found;
  for (const KnownPlugin& plugin : plugins_) {
    for (const auto& component : plugin.interface.components()) {
      const bool fits = std::any_of(component.ports().begin(), component.ports().end(), [&](const auto& port) {
        return port.direction() == direction && port.service() == service;
      });
      if (fits) found.push_back({&plugin, &component});
    }
  }
  const auto order = [direction](const KnownComponent& one) {
    const auto& ports = one.component->ports();
    const auto others =
        std::count_if(ports.begin(), ports.end(), [&](const auto& p) { return p.direction() == direction; });
    return std::pair(!one.plugin->installed, others);
  };
  std::stable_sort(found.begin(), found.end(), [&](const auto& a, const auto& b) { return order(a) < order(b); });
  return found;
}

std::vector<std::string> Catalogue::names() const {
  std::vector<std::string> names;
  for (const KnownPlugin& plugin : plugins_) {
    names.push_back(plugin.manifest.name());
    names.push_back(plugin.name());
  }
  return names;
}

const TypeSet& Catalogue::types_of(const KnownPlugin& plugin) const {
  auto& types = types_[&plugin];
  if (!types) types = std::make_unique<TypeSet>(plugin.interface.descriptors());
  return *types;
}

std::string loadable(const WordLine& line, const std::string& plugin) {
  if (marketplace::library_path(plugin).empty()) return plugin;
  return std::filesystem::absolute(named_file(line, plugin)).lexically_normal().string();
}

std::filesystem::path system_path(const std::string& typed, const std::filesystem::path& store) {
  std::error_code failure;
  // A folder is no system: one of a package's name, as its author has it, does not hide the package.
  if (std::filesystem::exists(typed, failure) && !std::filesystem::is_directory(typed, failure)) return typed;
  const marketplace::Store installed(store.empty() ? marketplace::Store::default_directory() : store);
  for (const auto& package : installed.installed()) {
    const bool meant = package.name() == typed || package.manifest.name() == typed;
    if (meant && package.manifest.kind() == fiona::SYSTEM)
      return package.directory / marketplace::system_file(package.manifest);
  }
  return typed;
}

}  // namespace fiona::console
