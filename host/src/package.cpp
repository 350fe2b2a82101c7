#include "package.hpp"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>
#include <sys/stat.h>

#include <algorithm>
#include <fstream>
#include <sstream>

#include "fiona/error.hpp"
#include "fiona/marketplace/compiled_protos.hpp"
#include "fiona/marketplace/manifest.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

/// `typed`: how the plugin is named in a `load`.
std::string choose_component(const Interface& interface, const std::string& plugin, const std::string& typed,
                             const std::string& wanted) {
  std::vector<std::string> names;
  for (const auto& component : interface.components()) names.push_back(component.name());
  const std::string short_name = plugin.substr(plugin.rfind('/') + 1);
  const std::string choice = !wanted.empty() ? wanted : names.size() == 1 ? names.front() : short_name;
  if (std::find(names.begin(), names.end(), choice) != names.end()) return choice;
  throw Error(ErrorCode::NotFound,
              {.what = fmt::format("plugin '{}' has no component '{}'", plugin, choice),
               .expected = fmt::format("one of {}", fmt::join(names, ", ")),
               .next = fmt::format("load {}/{}", typed, names.empty() ? "COMPONENT" : names.front()),
               .near = nearest_names(choice, names)});
}

/// Changes whenever the file does; empty where there is none.
std::string state_of(const std::filesystem::path& file) {
  struct stat is {};
  if (::stat(file.c_str(), &is) != 0) return "";
  return fmt::format("{}:{}:{}:{}.{}", is.st_dev, is.st_ino, is.st_size, is.st_ctim.tv_sec, is.st_ctim.tv_nsec);
}

/// Changes whenever a file of these packages does: what is in use already is looked at again then.
std::string state_of(const std::vector<marketplace::InstalledPackage>& parts) {
  std::string state;
  for (const auto& part : parts) {
    state += " " + part.blake2b;
    for (const auto& file : part.manifest.files()) state += " " + state_of(part.directory / file.path());
  }
  return state;
}

}  // namespace

const ComponentInterface& Package::component(const std::string& component_name) const {
  const auto& all = interface.components();
  return *std::find_if(all.begin(), all.end(), [&](const ComponentInterface& c) { return c.name() == component_name; });
}

Packages::Packages(const std::filesystem::path& store, const std::filesystem::path& unsigned_packages)
    : store_(store),
      unsigned_(unsigned_packages.empty()
                    ? std::nullopt
                    : std::make_optional<marketplace::Store>(unsigned_packages, marketplace::Store::Kind::Unsigned)) {}

namespace {

Interface read_interface(const std::filesystem::path& description, const std::string& name,
                         const std::filesystem::path& library) {
  Interface interface;
  std::ifstream stream(description);
  std::stringstream text;
  text << stream.rdbuf();
  if (stream && google::protobuf::TextFormat::ParseFromString(text.str(), &interface)) return interface;
  throw Error(
      ErrorCode::NotFound,
      {.what = fmt::format("plugin '{}' has no readable interface beside it", name),
       .where = description.string(),
       .next = fmt::format("fiona_add_plugin() in its CMakeLists.txt writes it, or: fiona plugin describe {} -o {}",
                           library.string(), description.string())});
}

}  // namespace

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
  // To read it takes longer than all else here.
  const std::string own = state_of(file) + " " + state_of(description) + " " + state_of(share);
  const auto before = known(found.library, own);
  found.interface = before ? Interface() : read_interface(description, name, file);
  found.name = std::string(kTypedByPath) + name;
  found.version = "0";
  Manifest derived;
  marketplace::list_protos(before ? before->interface : found.interface, derived);
  add_messages(found, derived, all());
  require_not_revoked(found);
  found.state = own + state_of(found.parts);
  if (before && before->state == found.state) return before;
  if (before) found.interface = before->interface;
  hold(found);
  found.files.Add()->set_path(found.library);
  for (const auto& one : found.interface.components())
    found.rights.insert(found.rights.end(), one.rights().begin(), one.rights().end());
  if (std::filesystem::is_directory(share)) found.share = share;
  return keep(std::move(found));
}

std::shared_ptr<const Package> Packages::installed(const marketplace::InstalledPackage& package,
                                                   const Installed& packages) const {
  using Origin = Package::Origin;
  Package found;
  found.name = package.name();
  found.library = package.library;
  auto among = packages;
  if (!package.is_unsigned) std::erase_if(among, [](const auto& one) { return one.is_unsigned; });
  add_messages(found, package.manifest, among);
  found.parts.push_back(package);
  require_not_revoked(found);
  found.state = state_of(found.parts);
  if (auto same = known(found.library, found.state); same && same->state == found.state) return same;
  found.version = package.manifest.version();
  found.share = package.share;
  found.rights = {package.manifest.rights().begin(), package.manifest.rights().end()};
  if (const auto time = package.manifest.hang_after_ms()) found.hang_after = std::chrono::milliseconds(time);
  found.origin = package.is_unsigned ? Origin::Unsigned : package.first_party ? Origin::FirstParty : Origin::Signed;
  hold(found);
  found.interface = package.interface();
  return keep(std::move(found));
}

void Packages::require_not_revoked(const Package& package) const {
  for (const auto& part : package.parts) store_of(part).require_not_revoked(part);
}

/// With the message packages that it was compiled with. Whose an unsigned one is, nobody knows: those who are
/// somebody's do without.
void Packages::add_messages(Package& package, const Manifest& of, const Installed& among) const {
  package.parts = marketplace::messages_of(of, package.name, among);
}

/// Its parts do not go away any more, and are as they were installed.
void Packages::hold(Package& package) const {
  for (const auto& part : package.parts) {
    package.holds.push_back(std::make_shared<marketplace::PackageHold>(store_of(part).hold(part)));
    store_of(part).verify(part);
  }
  for (const auto& part : package.parts) add_files(package, part);
}

/// The libraries that a package brings, its own after those that come with it.
void Packages::add_files(Package& package, const marketplace::InstalledPackage& of) const {
  google::protobuf::FileDescriptorSet brought;
  const Interface interface = of.manifest.kind() == MESSAGES ? of.interface() : Interface{};
  for (const auto& proto : interface.descriptors().file()) {
    const auto is_it = [&proto](const auto& offered) { return offered.name() == proto.name(); };
    const auto& offered = of.manifest.offered();
    if (std::any_of(offered.begin(), offered.end(), is_it)) *brought.add_file() = proto;
  }
  wire::LibraryFile own;
  for (const auto& listed : of.manifest.files()) {
    if (!listed.path().starts_with("lib/")) continue;
    wire::LibraryFile file;
    file.set_path(of.directory / listed.path());
    file.set_blake2b(listed.blake2b());
    file.set_size(listed.size());
    file.set_package(of.name());
    const bool is_own = listed.path() == of.manifest.library();
    *file.mutable_descriptors() = brought;
    (is_own ? own : *package.files.Add()) = file;
  }
  if (!own.path().empty()) *package.files.Add() = own;
}

Packages::Installed Packages::all() const {
  auto packages = store_.installed();
  if (!unsigned_) return packages;
  for (auto& package : unsigned_->installed()) packages.push_back(std::move(package));
  return packages;
}

/// Another version of it, with all that was installed beside that one, where they are kept and it may be started.
void Packages::take_kept(marketplace::InstalledPackage& package, Installed& packages,
                         const std::string& version) const {
  auto kept = store_.installed_with(package.name(), version);
  const auto found =
      std::find_if(kept.begin(), kept.end(), [&](const auto& one) { return one.name() == package.name(); });
  if (found == kept.end() || store_.revocation(*found)) return;
  package = *found;
  packages = std::move(kept);
}

const marketplace::Store& Packages::store_of(const marketplace::InstalledPackage& package) const {
  return package.is_unsigned ? *unsigned_ : store_;
}

/// The one that is in use already, if its files have not changed since they were read.
std::shared_ptr<const Package> Packages::known(const std::filesystem::path& library, const std::string& state) const {
  const std::lock_guard lock(mutex_);
  const auto found = known_.find(library);
  const auto same = found == known_.end() ? nullptr : found->second.lock();
  return same && same->state.starts_with(state) ? same : nullptr;
}

std::shared_ptr<const Package> Packages::keep(Package package) const {
  package.types = Types::read(package.name, package.interface);
  const auto made = std::make_shared<const Package>(std::move(package));
  const std::lock_guard lock(mutex_);
  std::erase_if(known_, [](const auto& entry) { return entry.second.expired(); });
  known_[made->library] = made;
  return made;
}

Packages::Choice Packages::find(const std::string& text, const std::string& version) const {
  if (const std::string_view path = marketplace::library_path(text); !path.empty()) {
    auto package = library(path);
    std::string component = choose_component(package->interface, package->name, std::string(path),
                                             text.substr(std::min(text.size(), path.size() + 1)));
    return {std::move(package), std::move(component)};
  }
  // "publisher/name" and "name/component" look alike: an installed package of the whole text wins.
  std::string plugin = text;
  std::string wanted;
  auto packages = all();
  const auto matches = [&](const std::string& name) {
    return std::any_of(packages.begin(), packages.end(),
                       [&](const auto& p) { return p.name() == name || p.manifest.name() == name; });
  };
  const std::size_t slash = text.rfind('/');
  if (!matches(text) && slash != std::string::npos && matches(text.substr(0, slash))) {
    plugin = text.substr(0, slash);
    wanted = text.substr(slash + 1);
  }
  auto package = marketplace::Store::chosen(packages, plugin, store_.directory());
  if (!version.empty() && version != package.manifest.version() && !package.is_unsigned)
    take_kept(package, packages, version);
  auto found = installed(package, packages);
  std::string component = choose_component(found->interface, found->name, found->name, wanted);
  return {std::move(found), std::move(component)};
}

}  // namespace fiona::host
