#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <fiona/marketplace/store.hpp>

#include "fiona/manifest.pb.h"
#include "reactor.hpp"

namespace fiona::console {

/// A directory of its own below the system's temporary one; gone with this object.
class ScratchDirectory {
 public:
  ScratchDirectory();
  ScratchDirectory(const ScratchDirectory&) = delete;
  ScratchDirectory& operator=(const ScratchDirectory&) = delete;
  ~ScratchDirectory();
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Where the parts of a plugin are. Empty: there is none, or it is not known.
struct PluginFiles {
  std::filesystem::path manifest{};
  std::filesystem::path readme{};
  std::filesystem::path protos{};  ///< folder of the author's proto files
  std::filesystem::path library{};
  std::filesystem::path interface {};                     ///< beside the library
  std::vector<std::filesystem::path> brought{};           ///< libraries that the package brings along, or `messages` do
  std::vector<marketplace::InstalledPackage> messages{};  ///< packages of messages that the library needs
  std::filesystem::path system{};                         ///< of a package of kind SYSTEM: its system file
  std::filesystem::path share{};
  bool packed = false;  ///< the manifest is that of a package, with the list of files
};

/// The parts of an author's folder, whose build is in its folder `build`. Throws fiona::Error (NotFound) where there is
/// no manifest.
PluginFiles files_of_folder(const std::filesystem::path& folder);

/// Of a library: its interface.
PluginFiles files_of_library(const std::filesystem::path& library);

/// Unpacks a package, whose files are checked against its manifest meanwhile, into a directory that is empty. Throws as
/// marketplace::read_package.
PluginFiles files_of_package(const std::filesystem::path& package, const std::filesystem::path& into);

/// Finds the packages of messages in this store that a library needs. Throws fiona::Error (Failed) where it is none.
void find_messages(PluginFiles& files, const marketplace::Store& store);

/// The content of a file. Throws fiona::Error (NotFound, Failed).
std::string file_text(const std::filesystem::path& file);

/// Whether code of others runs in a sandbox (host/src/os/sandbox.hpp), or with all that this user may.
enum class Confinement { Sandbox, None };

/// What a library declares, with the libraries that it brings along; `text` as it is packed. Its code runs in a process
/// of its own. Throws fiona::Error: ComponentFailed with what that says, or how it ended; NotAllowed where this system
/// has no sandbox for it.
struct Described {
  fiona::Interface interface;
  std::string text;
};
Described describe_library(Reactor& reactor, const PluginFiles& files, Confinement confinement);

}  // namespace fiona::console
