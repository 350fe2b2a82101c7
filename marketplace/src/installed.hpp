#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

inline constexpr std::string_view kInstalledFile = "installed.textproto";
inline constexpr std::string_view kRevokedFile = "revoked.textproto";
inline constexpr std::string_view kPackagesDirectory = "packages";
inline constexpr std::string_view kGenerationsDirectory = "generations";
/// How many earlier lists are kept, and with them the packages that they name.
inline constexpr std::size_t kKeptGenerations = 10;

/// The list of a store, checked; an empty list if there is none. Throws fiona::Error (Failed) if it is
/// damaged.
Installed read_installed(const std::filesystem::path& store);

/// What marketplaces have revoked of it, checked; empty if there is no such list. Throws as the above.
Revocations read_revocations(const std::filesystem::path& store);

/// The numbers of the earlier lists that are kept, in ascending order.
std::vector<std::uint64_t> kept_generations(const std::filesystem::path& store);

/// One of them. Throws fiona::Error: NotFound with those that are kept, Failed if it is damaged.
Installed read_generation(const std::filesystem::path& store, std::uint64_t number);

/// " --from PLACE" of where a package came from; empty for the marketplace that is asked without.
std::string from_option(const std::string& source);

/// "7.textproto".
std::string generation_file(std::uint64_t number);

/// The name of a package's directory below packages/, which is the hash of its .fpk.
std::string hash_of(const fiona::InstalledPackage& package);

}  // namespace fiona::marketplace
