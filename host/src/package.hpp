#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/marketplace/store.hpp"
#include "hang_watch.hpp"
#include "plugin_library.hpp"
#include "types.hpp"

namespace fiona::host {

/// A plugin that can be loaded: an installed package, or a library as its author builds it. Nothing of it runs.
struct Package {
  /// Where it comes from, and so how far it is trusted.
  enum class Origin {
    Path,        ///< a library that somebody typed by its path: whoever's who typed it
    FirstParty,  ///< of this project, from the marketplace that comes with this program
    Signed,      ///< of another publisher
    Unsigned,    ///< from the directory that the host was started with for such ones
  };

  std::string name;  ///< "publisher/name"
  std::string version;
  std::filesystem::path library;
  std::filesystem::path share;
  Interface interface;
  std::string state;                ///< of the files that it was read from
  std::vector<std::string> rights;  ///< that its manifest asks for; of a library without one, those that it uses
  std::chrono::milliseconds hang_after = HangWatch::kWork;  ///< its work hangs, as its manifest has it
  Origin origin = Origin::Path;
  PluginLibraries::Files files{};  ///< what is opened: what it needs, and its library last
  std::shared_ptr<const Types::Source> types{};
  /// Installed: those whose libraries it needs, and itself; each is kept from being removed.
  std::vector<marketplace::InstalledPackage> parts{};
  std::vector<std::shared_ptr<marketplace::PackageHold>> holds{};

  bool installed() const { return origin != Origin::Path; }
  /// What the component of this name declares; it must be one of the plugin's.
  const ComponentInterface& component(const std::string& component_name) const;
};

/// Finds what `load` names, and checks that it is what was installed: all its files.
class Packages {
 public:
  /// `unsigned_packages`: a store of packages that nobody signs for; empty: there are none.
  explicit Packages(const std::filesystem::path& store, const std::filesystem::path& unsigned_packages = {});

  struct Choice {
    std::shared_ptr<const Package> package;
    std::string component;
  };
  /// "publisher/name", "name", "name/component", "DIR/libNAME.so", "DIR/libNAME.so/component". Throws Error: NotFound
  /// with what would be found; BadSignature for a package that was changed since it was installed, or revoked. Of a
  /// package the version that is installed, unless another is asked for that is kept and was not revoked.
  Choice find(const std::string& text, const std::string& version = "") const;

  /// Throws Error BadSignature if a package of it has been revoked, since it was found or before.
  void require_not_revoked(const Package& package) const;

 private:
  using Installed = std::vector<marketplace::InstalledPackage>;

  std::shared_ptr<const Package> library(const std::filesystem::path& file) const;
  std::shared_ptr<const Package> installed(const marketplace::InstalledPackage& package,
                                           const Installed& packages) const;
  void add_messages(Package& package, const Manifest& of, const Installed& among) const;
  void hold(Package& package) const;
  void add_files(Package& package, const marketplace::InstalledPackage& of) const;
  Installed all() const;
  void take_kept(marketplace::InstalledPackage& package, Installed& packages, const std::string& version) const;
  const marketplace::Store& store_of(const marketplace::InstalledPackage& package) const;
  /// One that is in use, of which what its state begins with is so still.
  std::shared_ptr<const Package> known(const std::filesystem::path& library, const std::string& state) const;
  std::shared_ptr<const Package> keep(Package package) const;

  const marketplace::Store store_;
  const std::optional<marketplace::Store> unsigned_;
  mutable std::mutex mutex_;
  /// By library: all instances of a package share it.
  mutable std::map<std::filesystem::path, std::weak_ptr<const Package>> known_;
};

}  // namespace fiona::host
