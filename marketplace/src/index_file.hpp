#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

inline constexpr std::string_view kIndexFile = "index.binpb";

/// Reads and checks an index; nothing if there is none. Throws fiona::Error (Failed) if it is damaged.
std::optional<Index> read_index(const std::filesystem::path& directory);

/// The name of a package's file in a marketplace. It holds a part of the hash, so that other content of the
/// same version never takes the place of a file that the index still speaks of.
std::string package_file_name(const Manifest& manifest, std::string_view blake2b);

}  // namespace fiona::marketplace
