#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/manifest.pb.h"
#include "grammar.hpp"
#include "types.hpp"

namespace fiona::console {

/// A plugin that is installed or can be: its manifest, and its interface without opening the library.
struct KnownPlugin {
  fiona::Manifest manifest;
  fiona::Interface interface;
  bool installed = false;
  std::string mark{};  ///< "unsigned", or "revoked: " and why; empty: nothing speaks against it

  std::string name() const { return manifest.publisher() + "/" + manifest.name(); }
};

/// A component of a plugin, as `load` would create it.
struct KnownComponent {
  const KnownPlugin* plugin = nullptr;
  const fiona::ComponentInterface* component = nullptr;

  /// What to type after `load`: "publisher/name", with "/component" where there are several.
  std::string load_name() const;
};

/// What a line is to load, the path of a library made absolute: it does not begin where a host runs.
std::string loadable(const WordLine& line, const std::string& plugin);

/// What could be loaded: the user's store and the marketplace directory, read once. What cannot be read is left out
/// and told by problems(), so that one damaged package does not hide the others.
class Catalogue {
 public:
  /// `unsigned_packages`: a store of what nobody has signed for; empty: there is none.
  explicit Catalogue(const std::filesystem::path& store, const std::filesystem::path& unsigned_packages = {});

  const std::vector<KnownPlugin>& plugins() const { return plugins_; }
  const std::vector<std::string>& problems() const { return problems_; }

  /// What "publisher/name", "name" or "name/component" means, installed ones before those of the marketplace; empty:
  /// unknown.
  std::vector<KnownComponent> find(std::string_view name) const;

  /// Components with a port of that direction and service: installed ones first, and first of all who does little else.
  std::vector<KnownComponent> with_port(fiona::Direction direction, std::string_view service) const;

  /// The names that find() knows.
  std::vector<std::string> names() const;

  /// The types of a plugin and the platform's; made when first asked for.
  const TypeSet& types_of(const KnownPlugin& plugin) const;

 private:
  std::vector<KnownPlugin> plugins_;
  std::vector<std::string> problems_;
  mutable std::map<const KnownPlugin*, std::unique_ptr<TypeSet>> types_;
};

/// The system file that somebody means: `typed`, or if there is no such file (a folder is none) that of an installed
/// package of this name.
std::filesystem::path system_path(const std::string& typed, const std::filesystem::path& store);

}  // namespace fiona::console
