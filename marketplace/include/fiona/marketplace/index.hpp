#pragma once

#include <array>
#include <filesystem>
#include <fiona/marketplace/version.hpp>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

/// A package that somebody named, and a version if he did.
struct PackageRequest {
  std::string package;  ///< "publisher/name"
  std::optional<Version> version{};
};

/// The index of a marketplace directory, as it was when this was made. Entries name their .fpk beside it. What is in
/// such a directory is taken as it is: open_marketplace() gives one of which every byte is signed.
class Marketplace {
 public:
  /// Brings the .fpk of an entry and returns where it is.
  using Fetch = std::function<std::filesystem::path(const IndexEntry&)>;

  /// Reads and checks `directory`/index.binpb. Throws fiona::Error: NotFound if there is no index, Failed if
  /// it is damaged.
  explicit Marketplace(std::filesystem::path directory = default_directory());

  /// What stands behind a copy of a marketplace that is signed.
  struct Behind {
    Fetch fetch{};
    std::map<std::string, std::vector<std::string>>
        keys{};                ///< that each publisher signs with, as others are given them
    bool first_party = false;  ///< it came with this program
    bool is_named = false;     ///< by --from: it is not the one that is asked without
  };

  /// The same of a copy whose packages come when they are asked for; `source` is what it is a copy of.
  Marketplace(const std::filesystem::path& copy, std::string source, Behind behind);

  /// Where a marketplace lies that came with this program: ../marketplace beside the binary's directory in a build,
  /// ../share/fiona/marketplace where it is installed.
  static std::array<std::filesystem::path, 2> shipped_directories();
  /// $FIONA_MARKET, else the one of these that is there.
  static std::filesystem::path default_directory();

  const std::filesystem::path& directory() const noexcept { return directory_; }
  /// Where it is, as a person named it: a directory or a URL.
  const std::string& source() const noexcept { return source_; }
  /// What a line has to end with to mean this one: " --from PLACE"; empty for the one that is asked without.
  std::string option() const { return behind_.is_named ? " --from " + source_ : ""; }
  const Index& index() const noexcept { return index_; }
  /// How many parts of the index are left out, for this FIONA does not understand them.
  std::size_t left_out() const noexcept { return left_out_; }
  /// The keys that a publisher signs with: 64 digits each of Ed25519, else "id " and the id that metadata has for it.
  /// None where nobody signs.
  std::vector<std::string> keys_of(const std::string& publisher) const;
  /// Whether it is the one that came with this program; also for a directory that is taken as it is.
  bool is_first_party() const noexcept { return behind_.first_party; }

  /// The newest version of each package in which every word occurs (name, publisher, summary, components,
  /// services; case does not count), sorted by name. No words: all packages.
  std::vector<IndexEntry> search(const std::vector<std::string>& words) const;

  /// All versions of "publisher/name" or "name", newest first. Throws fiona::Error (NotFound) with the
  /// nearest names, or with the full names if two publishers have it.
  std::vector<IndexEntry> info(std::string_view name) const;

  /// What "[publisher/]name[@version]" asks for. Throws fiona::Error (NotFound) as info() does, or with the versions
  /// that there are.
  PackageRequest resolve(std::string_view request) const;

  /// The newest versions of packages with a component that provides `service` (full name): who could fill a
  /// white spot.
  std::vector<IndexEntry> providers_of(std::string_view service) const;

  /// The .fpk of an entry, on this machine. Throws fiona::Error: NotFound if it is not there; from a signed marketplace
  /// also BadSignature and Unreachable.
  std::filesystem::path package(const IndexEntry& entry) const;

 private:
  std::filesystem::path directory_;
  std::string source_;
  Behind behind_;
  Index index_;
  std::size_t left_out_ = 0;
};

}  // namespace fiona::marketplace
