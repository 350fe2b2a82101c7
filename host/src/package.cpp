#include "package.hpp"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <fstream>
#include <sstream>

#include "fiona/error.hpp"
#include "fiona/marketplace/manifest.hpp"

namespace fiona::host {
namespace {

std::string choose_component(const Interface& interface, const std::string& plugin, const std::string& wanted) {
  std::vector<std::string> names;
  for (const auto& component : interface.components()) names.push_back(component.name());
  const std::string short_name = plugin.substr(plugin.rfind('/') + 1);
  const std::string choice = !wanted.empty() ? wanted : names.size() == 1 ? names.front() : short_name;
  if (std::find(names.begin(), names.end(), choice) != names.end()) return choice;
  throw Error(ErrorCode::NotFound,
              {.what = fmt::format("plugin '{}' has no component '{}'", plugin, choice),
               .expected = fmt::format("one of {}", fmt::join(names, ", ")),
               .next = fmt::format("load {}/{}", plugin, names.empty() ? "COMPONENT" : names.front()),
               .near = nearest_names(choice, names)});
}

}  // namespace

const ComponentInterface& Package::component(const std::string& component_name) const {
  const auto& all = interface.components();
  return *std::find_if(all.begin(), all.end(), [&](const ComponentInterface& c) { return c.name() == component_name; });
}

/// A library as its author builds it: "DIR/libNAME.so" beside "DIR/NAME.interface.textproto".
Package Packages::library(const std::filesystem::path& file) const {
  std::string name = file.stem().string();
  if (name.starts_with("lib")) name = name.substr(3);
  const auto description = file.parent_path() / (name + ".interface.textproto");
  if (!std::filesystem::exists(file) && !std::filesystem::exists(description)) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("there is no library '{}'", file.string()),
                                      .next = "look where it was built; or load a package by its name: ls plugins"});
  }
  Package found{"local/" + name, "0", std::filesystem::absolute(file), {}, {}, {}, nullptr, nullptr};
  std::ifstream stream(description);
  std::stringstream text;
  text << stream.rdbuf();
  if (!stream || !google::protobuf::TextFormat::ParseFromString(text.str(), &found.interface)) {
    throw Error(ErrorCode::NotFound,
                {.what = fmt::format("plugin '{}' has no readable interface beside it", name),
                 .where = description.string(),
                 .next = "fiona_add_plugin() in its CMakeLists.txt writes it, or: fiona-describe " + file.string()});
  }
  for (const auto& one : found.interface.components())
    found.rights.insert(found.rights.end(), one.rights().begin(), one.rights().end());
  const auto share = file.parent_path() / (name + ".share");
  if (std::filesystem::is_directory(share)) found.share = share;
  return found;
}

std::shared_ptr<const Package> Packages::shared(Package package) const {
  const std::lock_guard lock(mutex_);
  auto& known = known_[package.library];
  const auto same = known.lock();
  const bool unchanged = same && same->name == package.name && same->version == package.version &&
                         same->interface.SerializeAsString() == package.interface.SerializeAsString();
  if (unchanged) return same;
  package.types = Types::read(package.name, package.interface);
  std::erase_if(known_, [&](const auto& entry) { return entry.first != package.library && entry.second.expired(); });
  auto made = std::make_shared<const Package>(std::move(package));
  known = made;
  return made;
}

Packages::Choice Packages::find(const std::string& text) const {
  if (const std::string_view path = marketplace::library_path(text); !path.empty()) {
    Package found = library(path);
    std::string component =
        choose_component(found.interface, found.name, text.substr(std::min(text.size(), path.size() + 1)));
    return {shared(std::move(found)), std::move(component)};
  }
  // "publisher/name" and "name/component" look alike: an installed package of the whole text wins.
  std::string plugin = text;
  std::string wanted;
  const auto known = store_.installed();
  const auto matches = [&](const std::string& name) {
    return std::any_of(known.begin(), known.end(),
                       [&](const auto& p) { return p.name() == name || p.manifest.name() == name; });
  };
  const std::size_t slash = text.rfind('/');
  if (!matches(text) && slash != std::string::npos && matches(text.substr(0, slash))) {
    plugin = text.substr(0, slash);
    wanted = text.substr(slash + 1);
  }
  const auto installed = store_.find(plugin);
  Package found{installed.name(),
                installed.manifest.version(),
                installed.library,
                installed.share,
                installed.interface(),
                {installed.manifest.rights().begin(), installed.manifest.rights().end()},
                nullptr,
                std::make_shared<marketplace::PackageHold>(store_.hold(installed))};
  std::string component = choose_component(found.interface, found.name, wanted);
  return {shared(std::move(found)), std::move(component)};
}

}  // namespace fiona::host
