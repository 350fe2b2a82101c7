#include "package.hpp"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>
#include <sys/stat.h>

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

/// Changes whenever the file does; empty where there is none.
std::string state_of(const std::filesystem::path& file) {
  struct stat is {};
  if (::stat(file.c_str(), &is) != 0) return "";
  return fmt::format("{}:{}:{}:{}.{}", is.st_dev, is.st_ino, is.st_size, is.st_ctim.tv_sec, is.st_ctim.tv_nsec);
}

}  // namespace

const ComponentInterface& Package::component(const std::string& component_name) const {
  const auto& all = interface.components();
  return *std::find_if(all.begin(), all.end(), [&](const ComponentInterface& c) { return c.name() == component_name; });
}

/// A library as its author builds it: "DIR/libNAME.so" beside "DIR/NAME.interface.textproto".
std::shared_ptr<const Package> Packages::library(const std::filesystem::path& file) const {
  std::string name = file.stem().string();
  if (name.starts_with("lib")) name = name.substr(3);
  const auto description = file.parent_path() / (name + ".interface.textproto");
  if (!std::filesystem::exists(file) && !std::filesystem::exists(description)) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("there is no library '{}'", file.string()),
                                      .next = "look where it was built; or load a package by its name: ls plugins"});
  }
  const auto share = file.parent_path() / (name + ".share");
  Package found;
  found.library = std::filesystem::absolute(file);
  found.state = state_of(description) + " " + state_of(share);
  if (auto same = known(found)) return same;
  std::ifstream stream(description);
  std::stringstream text;
  text << stream.rdbuf();
  if (!stream || !google::protobuf::TextFormat::ParseFromString(text.str(), &found.interface)) {
    throw Error(
        ErrorCode::NotFound,
        {.what = fmt::format("plugin '{}' has no readable interface beside it", name),
         .where = description.string(),
         .next = fmt::format("fiona_add_plugin() in its CMakeLists.txt writes it, or: fiona plugin describe {} -o {}",
                             file.string(), description.string())});
  }
  found.name = "local/" + name;
  found.version = "0";
  for (const auto& one : found.interface.components())
    found.rights.insert(found.rights.end(), one.rights().begin(), one.rights().end());
  if (std::filesystem::is_directory(share)) found.share = share;
  return keep(std::move(found));
}

std::shared_ptr<const Package> Packages::installed(const marketplace::InstalledPackage& package) const {
  Package found;
  found.library = package.library;
  found.state = package.blake2b;
  if (auto same = known(found)) return same;
  found.name = package.name();
  found.version = package.manifest.version();
  found.share = package.share;
  found.interface = package.interface();
  found.rights = {package.manifest.rights().begin(), package.manifest.rights().end()};
  found.hold = std::make_shared<marketplace::PackageHold>(store_.hold(package));
  return keep(std::move(found));
}

/// The one that is in use already, if its files have not changed since they were read.
std::shared_ptr<const Package> Packages::known(const Package& package) const {
  const std::lock_guard lock(mutex_);
  const auto found = known_.find(package.library);
  const auto same = found == known_.end() ? nullptr : found->second.lock();
  return same && same->state == package.state ? same : nullptr;
}

std::shared_ptr<const Package> Packages::keep(Package package) const {
  package.types = Types::read(package.name, package.interface);
  const auto made = std::make_shared<const Package>(std::move(package));
  const std::lock_guard lock(mutex_);
  std::erase_if(known_, [](const auto& entry) { return entry.second.expired(); });
  known_[made->library] = made;
  return made;
}

Packages::Choice Packages::find(const std::string& text) const {
  if (const std::string_view path = marketplace::library_path(text); !path.empty()) {
    auto package = library(path);
    std::string component =
        choose_component(package->interface, package->name, text.substr(std::min(text.size(), path.size() + 1)));
    return {std::move(package), std::move(component)};
  }
  // "publisher/name" and "name/component" look alike: an installed package of the whole text wins.
  std::string plugin = text;
  std::string wanted;
  const auto all = store_.installed();
  const auto matches = [&](const std::string& name) {
    return std::any_of(all.begin(), all.end(),
                       [&](const auto& p) { return p.name() == name || p.manifest.name() == name; });
  };
  const std::size_t slash = text.rfind('/');
  if (!matches(text) && slash != std::string::npos && matches(text.substr(0, slash))) {
    plugin = text.substr(0, slash);
    wanted = text.substr(slash + 1);
  }
  auto package = installed(store_.find(plugin));
  std::string component = choose_component(package->interface, package->name, wanted);
  return {std::move(package), std::move(component)};
}

}  // namespace fiona::host
