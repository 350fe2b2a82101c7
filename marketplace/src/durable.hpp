#pragma once

#include <chrono>
#include <filesystem>
#include <fiona/marketplace/os_calls.hpp>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "files.hpp"

namespace fiona::marketplace {

/// A directory in which changes are made so that they survive a power cut: an OsCalls bound to an opened
/// directory, with signals waited out and failures told. Every function throws fiona::Error (Failed) unless
/// it says otherwise.
class DurableDirectory {
 public:
  /// Opens `path`, and makes it and what is missing above it.
  DurableDirectory(const OsCalls& os, std::filesystem::path path, mode_t mode);

  const std::filesystem::path& path() const noexcept { return path_; }

  /// Opens a directory below this one, and makes it if it is missing.
  DurableDirectory child(const std::string& name, mode_t mode) const;

  /// Opens a directory below this one, not through a link in its last element.
  DurableDirectory existing_child(const std::string& name) const;

  /// Waits for the directory's lock (flock), at most `wait`; throws fiona::Error (Unreachable) after that, with who
  /// holds it. If it has to wait, `on_wait` is told first whom for. Held until this object ends.
  void lock(std::chrono::milliseconds wait, const std::function<void(const std::string& who)>& on_wait = {});

  /// Creates a file that is not there yet; `name` may have '/' but leads through no link and not outside.
  FileDescriptor create(const std::string& name, mode_t mode) const;
  void make_directory(const std::string& name, mode_t mode) const;
  void write(const FileDescriptor& file, std::string_view bytes, const std::string& name) const;
  void sync(const FileDescriptor& file, const std::string& name) const;
  void sync() const;

  /// Renames into `to`, and syncs that. The old name needs none: a name that comes back after a power cut is
  /// rubbish.
  void move(const std::string& from, const DurableDirectory& to, const std::string& name) const;

  /// Replaces the content of a file at once: after a failure it is the old, as far as the disk still obeys.
  void replace(const std::string& name, std::string_view content) const;

  /// Removes a file, or nothing.
  void remove_file(const std::string& name) const;

  /// Removes a directory with all that it holds, or nothing; never through a link.
  void remove_tree(const std::string& name) const;

  /// The same, without a word if it fails: for rubbish that the next start sweeps.
  void remove_tree_quietly(const std::string& name) const noexcept;

  /// The names in it.
  std::vector<std::string> names() const;

  bool has(const std::string& name) const;
  int descriptor() const noexcept { return directory_.number(); }

 private:
  DurableDirectory(const OsCalls& os, FileDescriptor directory, std::filesystem::path path)
      : os_(&os), directory_(std::move(directory)), path_(std::move(path)) {}
  void switch_to(const std::string& name, std::string_view content) const;

  const OsCalls* os_;
  FileDescriptor directory_;
  std::filesystem::path path_;
};

}  // namespace fiona::marketplace
