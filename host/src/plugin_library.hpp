#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "fiona/manifest.pb.h"
#include "fiona/plugin.hpp"

namespace fiona::host {

/// The plugin libraries of this process. A library stays until the process ends: what protobuf registered from it
/// cannot be taken back (architecture 5), so another build of a loaded plugin needs a fresh process.
class PluginLibraries {
 public:
  /// Opens it as `open` would, in a process that does nothing else, and ends. What the loader says does not matter
  /// here. How it was, for `Trials`: "+", and what was thrown.
  static std::string tried(const std::filesystem::path& path);

  PluginLibraries();
  ~PluginLibraries();

  /// The plugin in the library at `path`, opened once. `interface` is what its package says of it: the ABI tag and
  /// the names of its protos are checked before the library is opened. Throws Error saying what is wrong and what to
  /// do: another ABI, a proto file that another plugin has brought already, a missing symbol (the loader's words),
  /// no entry.
  const Plugin& open(const std::string& name, const std::filesystem::path& path, const Interface& interface);

 private:
  struct Library;
  Library& opened(const std::string& name, const std::filesystem::path& path, const Interface& interface);
  void check_before_opening(const std::string& name, const std::filesystem::path& path,
                            const Interface& interface) const;

  std::map<std::filesystem::path, std::unique_ptr<Library>> libraries_;
  std::map<std::string, std::string> proto_owners_;  ///< descriptor file -> plugin
};

}  // namespace fiona::host
