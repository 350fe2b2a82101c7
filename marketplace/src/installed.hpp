#pragma once

#include <filesystem>
#include <string_view>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

inline constexpr std::string_view kInstalledFile = "installed.textproto";
inline constexpr std::string_view kPackagesDirectory = "packages";

/// The list of a store, checked; an empty list if there is none. Throws fiona::Error (Failed) if it is
/// damaged.
Installed read_installed(const std::filesystem::path& store);

}  // namespace fiona::marketplace
