#pragma once

#include <cstdint>
#include <filesystem>
#include <fiona/marketplace/manifest.hpp>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace fiona::marketplace {

/// One package in a store. A value: it stays what it was when the store changes.
struct InstalledPackage {
  Manifest manifest;
  std::filesystem::path directory;  ///< absolute
  std::filesystem::path library;    ///< absolute; empty for a package without a library
  std::filesystem::path share;      ///< absolute; its data files, may not exist
  std::string blake2b;              ///< of the .fpk that it came from; also the directory's name
  std::string source;               ///< where it was installed from
  bool as_requirement = false;      ///< nobody asked for it by name
  bool first_party = false;         ///< from the marketplace that came with this program
  bool is_unsigned = false;         ///< nobody has signed for it: who its publisher is, nobody knows

  /// "publisher/name"; "unsigned/name" where nobody has signed for it.
  std::string name() const { return is_unsigned ? "unsigned/" + manifest.name() : full_name(manifest); }

  /// Reads interface.textproto, checked against the hash in the manifest. Throws fiona::Error: BadSignature
  /// if the file is not what was installed.
  Interface interface() const;
};

/// Keeps an installed package's files from being swept away by a later installation, for as long as it lives.
class PackageHold {
 public:
  explicit PackageHold(int descriptor) : descriptor_(descriptor) {}
  PackageHold(PackageHold&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  PackageHold& operator=(PackageHold&&) = delete;
  ~PackageHold();

  /// The package's opened directory, for openat.
  int descriptor() const noexcept { return descriptor_; }

 private:
  int descriptor_;
};

/// One list of installed packages, the present one or one that can be gone back to.
struct Generation {
  std::uint64_t number = 0;
  std::int64_t time_s = 0;   ///< when it was made, since 1970-01-01 UTC
  std::string change{};      ///< what made it: "install acme/nav"
  std::size_t packages = 0;  ///< how many
  bool present = false;
  std::string fault{};  ///< why it cannot be gone back to
};

/// Read-only view of what a user has installed. Each call reads the store anew: one file, replaced
/// atomically, so a reader sees the state before or after an installation, never between. Takes no lock and
/// writes nothing.
class Store {
 public:
  enum class Kind {
    Signed,    ///< what marketplaces have brought
    Unsigned,  ///< what install_unsigned() has put there, for one run of a host
  };

  /// `directory` need not exist: such a store is empty.
  explicit Store(std::filesystem::path directory = default_directory(), Kind kind = Kind::Signed);

  /// $FIONA_STORE, else $XDG_DATA_HOME/fiona/store, else ~/.local/share/fiona/store.
  static std::filesystem::path default_directory();

  const std::filesystem::path& directory() const noexcept { return directory_; }

  /// All packages, sorted by name. Throws fiona::Error (Failed) if the store's list is damaged.
  std::vector<InstalledPackage> installed() const;

  /// The package "publisher/name" or "name". Throws fiona::Error (NotFound): with the nearest names if it is
  /// unknown, with the full names if two publishers have it.
  InstalledPackage find(std::string_view name) const;

  /// The packages of the newest list that has "publisher/name" in this version: the present one, or one that is kept;
  /// none: no list has it. What it requires is there as it was with it. Throws as installed() does.
  std::vector<InstalledPackage> installed_with(std::string_view name, std::string_view version) const;

  /// The same among these packages, of one store or several; `where` is named in the error.
  static InstalledPackage chosen(const std::vector<InstalledPackage>& packages, std::string_view name,
                                 const std::filesystem::path& where);

  /// The present list and those that are kept, the newest first. Throws fiona::Error (Failed) if the present one is
  /// damaged.
  std::vector<Generation> history() const;

  /// Compares every file with the manifest: presence, kind, size, hash; and that there is no other file.
  /// Throws fiona::Error (BadSignature) that names the first difference.
  void verify(const InstalledPackage& package) const;

  /// All that marketplaces have taken back of what is, or was, installed here. Throws as `revocation`.
  std::vector<Revocation> revoked() const;

  /// Why a package must not be started any more, as the marketplace that it came from has said; nothing where it may.
  /// Throws fiona::Error (Failed) if the list of revocations is damaged.
  std::optional<Revocation> revocation(const InstalledPackage& package) const;

  /// Throws fiona::Error (BadSignature) for a package that was revoked.
  void require_not_revoked(const InstalledPackage& package) const;

  /// Protects the package's files while they are in use. Throws fiona::Error (NotFound) if they are gone
  /// already.
  PackageHold hold(const InstalledPackage& package) const;

 private:
  std::vector<InstalledPackage> all_of(const Installed& list) const;

  std::filesystem::path directory_;
  Kind kind_;
};

}  // namespace fiona::marketplace
