#pragma once

#include <fiona/marketplace/install.hpp>
#include <functional>
#include <optional>
#include <set>
#include <string>

#include "durable.hpp"

namespace fiona::marketplace {

/// A store that is being changed by us alone: locked, and swept of what a crash or a removal left.
class StoreChange {
 public:
  StoreChange(const std::filesystem::path& store, const InstallOptions& options);

  /// The list as it was found, to be changed and committed.
  Installed& list() { return list_; }
  fiona::InstalledPackage* find(const std::string& name);

  /// Unpacks a package, which `fetch` brings, and makes it whole if it is there and damaged. Nothing of it is left if
  /// it fails.
  void add_files(const IndexEntry& entry, const std::function<std::filesystem::path()>& fetch);
  /// Whether the package's files are there and right.
  bool is_whole(const Manifest& manifest, const std::string& blake2b) const;

  /// The moment at which the change is seen; the list before is kept as a generation.
  void commit(const std::string& change);
  /// Likewise, with a kept generation as the list.
  void commit_rollback(const Installed& then);

  /// Removes the files of a package that no list names, after a failure.
  void drop_unlisted(const std::string& blake2b) noexcept;

 private:
  std::set<std::string> listed() const;
  void sweep() const;
  bool is_held(const DurableDirectory& parent, const std::string& name) const;
  void unpack(const IndexEntry& entry, const std::filesystem::path& path, const std::string& name) const;
  void keep_present() const;
  void write(const Installed& list) const;
  void forget_oldest() const;

  const InstallOptions& options_;
  DurableDirectory store_;
  std::optional<DurableDirectory> packages_, generations_;
  Installed list_;
};

}  // namespace fiona::marketplace
