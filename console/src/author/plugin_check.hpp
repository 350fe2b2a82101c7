#pragma once

#include <string>
#include <vector>

#include <fiona/error.hpp>

#include "author/plugin_files.hpp"
#include "catalogue.hpp"

namespace fiona::console {

/// What was looked at, and what would keep a plugin from being published.
struct PluginCheck {
  std::vector<ErrorText> findings{};
  std::vector<std::string> passed{};
  std::string name{};  ///< "publisher/name", where the manifest says so
};

/// Reads all that there is of a package; a system file is read against what `catalogue` knows. Its code runs only to be
/// asked what it declares: describe_library().
PluginCheck check_plugin(Reactor& reactor, const PluginFiles& files, const Catalogue& catalogue,
                         Confinement confinement);

}  // namespace fiona::console
