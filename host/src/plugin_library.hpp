#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "fiona/plugin.hpp"
#include "fiona/wire.pb.h"
#include "sealed_library.hpp"

namespace fiona::host {

/// The plugin libraries of this process. A library stays until the process ends: what protobuf registered from it
/// cannot be taken back (docs/architecture.md, Loading a plugin), so another build of a loaded plugin needs a fresh
/// process.
class PluginLibraries {
 public:
  /// What a plugin's code is in: its library, which is the last, after those that it needs.
  using Files = google::protobuf::RepeatedPtrField<wire::LibraryFile>;

  /// `private_files`: what is at the paths are copies that nobody else reaches, which were checked when they were made,
  /// as in a sandbox. Otherwise files of packages are opened from sealed copies in memory.
  explicit PluginLibraries(bool private_files = false);
  ~PluginLibraries();

  /// Opens them as `open` would, in a process that does nothing else, and ends. What the loader says does not matter
  /// here. How it was, for `Trials`: "+", and what was thrown.
  std::string tried(const Files& files);

  /// The plugin in the last of these files, opened once. `interface` is what its package says of it: the ABI tag and
  /// the names of its protos are checked before a library is opened. Throws Error saying what is wrong and what to
  /// do: other content than was installed, another ABI, a proto file that another plugin has brought already, a missing
  /// symbol (the loader's words), no entry.
  const Plugin& open(const std::string& name, const Files& files, const Interface& interface);
  /// How many are open.
  std::size_t size() const { return libraries_.size(); }

 private:
  struct Library;
  Library& opened(const std::string& name, const Files& files, const Interface& interface);
  void open_needed(const std::string& name, const Files& files);
  std::unique_ptr<Library> load(const std::string& name, const wire::LibraryFile& file) const;
  static void keep(std::unique_ptr<Library> library);
  void check_before_opening(const std::string& name, const Files& files, const Interface& interface) const;
  void require_new(const std::string& name, const std::filesystem::path& path,
                   const google::protobuf::FileDescriptorProto& proto) const;
  void require_needed(const std::string& name, const Files& files) const;

  const bool private_files_;
  std::map<std::filesystem::path, std::unique_ptr<Library>> libraries_;
  std::map<std::string, std::string> proto_owners_;  ///< descriptor file -> plugin, or package of messages
};

}  // namespace fiona::host
