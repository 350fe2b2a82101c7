#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/manifest.pb.h"
#include "fiona/marketplace/package.hpp"

namespace fiona::marketplace {

inline constexpr std::string_view kIndexFile = "index.binpb";

/// Reads and checks an index; nothing if there is none. Throws fiona::Error (Failed) if it is damaged.
std::optional<Index> read_index(const std::filesystem::path& directory, std::size_t* left_out = nullptr);

/// The name of a package's file in a marketplace. It holds a part of the hash, so that other content of the
/// same version never takes the place of a file that the index still speaks of.
std::string package_file_name(const Manifest& manifest, std::string_view blake2b);

/// The same of bytes that came from `where`. With `left_out`, what does not pass is no damage, but left out and
/// counted: a later FIONA may know it.
Index parse_index(std::string_view bytes, const std::string& where, std::size_t* left_out = nullptr);

/// What an index says of a package.
IndexEntry entry_for(const PackageContents& contents);

/// Adds an entry; false if it is there already. Throws fiona::Error (NotAllowed) if this version is there with other
/// content, unless that is to be replaced. `marketplace` and `next` are in the error.
bool add_entry(Index& index, const IndexEntry& entry, bool replace, const std::filesystem::path& marketplace,
               const std::string& next);

/// The path of a package among the targets of a signed marketplace: "PUBLISHER/NAME-VERSION-ARCHITECTURE.fpk".
std::string target_path(const Manifest& manifest);

}  // namespace fiona::marketplace
