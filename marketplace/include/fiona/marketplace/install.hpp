#pragma once

#include <chrono>
#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/os_calls.hpp>
#include <fiona/marketplace/store.hpp>
#include <string>
#include <string_view>

namespace fiona::marketplace {

enum class InstallOutcome {
  Installed,         ///< it was not there before
  Replaced,          ///< another version, or other content of this version, was there: previous_version
  Repaired,          ///< it was there, its files were damaged and are now right
  AlreadyInstalled,  ///< nothing was changed: this version, or a newer one that was not asked for by number
};

struct InstallResult {
  InstallOutcome outcome;
  InstalledPackage package;
  std::string previous_version;  ///< empty if there was none
};

struct InstallOptions {
  PackageLimits limits{};
  std::chrono::milliseconds lock_wait{10'000};  ///< for another installation into this store to end
  OsCalls os = system_calls();
};

/// Installs "[publisher/]name[@version]" from a marketplace into a store, atomically: killed, out of space or
/// out of power at any point, the store holds the old state or the new one, and the next installation sweeps
/// what was left. One version of a package is installed at a time. Throws fiona::Error: NotFound,
/// DependencyConflict, BadSignature (the package is not what the index says), Unreachable (the lock), Failed
/// (system calls; the store is unchanged).
InstallResult install(std::string_view request, const Marketplace& from, const std::filesystem::path& store,
                      const InstallOptions& options = {});

/// Takes a package out of the store, as atomically. Its files are swept by the next change, once nobody holds
/// them. Throws fiona::Error as Store::find and install do.
InstalledPackage remove(std::string_view name, const std::filesystem::path& store, const InstallOptions& options = {});

}  // namespace fiona::marketplace
