#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "fiona/marketplace/store.hpp"
#include "types.hpp"

namespace fiona::host {

/// A plugin that can be loaded: an installed package, or a library as its author builds it. Nothing of it runs.
struct Package {
  std::string name;  ///< "publisher/name"
  std::string version;
  std::filesystem::path library;
  std::filesystem::path share;
  Interface interface;
  std::string state;                ///< of the files that it was read from
  std::vector<std::string> rights;  ///< that its manifest asks for; of a library without one, those that it uses
  std::shared_ptr<const Types::Source> types;
  std::shared_ptr<marketplace::PackageHold> hold;  ///< keeps an installed one from being removed

  /// What the component of this name declares; it must be one of the plugin's.
  const ComponentInterface& component(const std::string& component_name) const;
};

/// Finds what `load` names.
class Packages {
 public:
  explicit Packages(const std::filesystem::path& store) : store_(store) {}

  struct Choice {
    std::shared_ptr<const Package> package;
    std::string component;
  };
  /// "publisher/name", "name", "name/component", "DIR/libNAME.so", "DIR/libNAME.so/component". Throws Error NotFound
  /// with what would be found.
  Choice find(const std::string& text) const;

 private:
  std::shared_ptr<const Package> library(const std::filesystem::path& file) const;
  std::shared_ptr<const Package> installed(const marketplace::InstalledPackage& package) const;
  std::shared_ptr<const Package> known(const Package& package) const;
  std::shared_ptr<const Package> keep(Package package) const;

  const marketplace::Store store_;
  mutable std::mutex mutex_;
  /// By library: all instances of a package share it.
  mutable std::map<std::filesystem::path, std::weak_ptr<const Package>> known_;
};

}  // namespace fiona::host
