#pragma once

#include <chrono>
#include <filesystem>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/os_calls.hpp>

namespace fiona::marketplace {

enum class PublishOutcome {
  Published,         ///< the index has a new entry
  Replaced,          ///< other content of the same version gave way to it
  AlreadyPublished,  ///< these bytes are in the index; nothing was changed
};

struct PublishOptions {
  bool replace = false;  ///< same version, other content: take its place. For a build's own directory only.
  PackageLimits limits{};
  std::chrono::milliseconds lock_wait{10'000};
  OsCalls os = system_calls();
};

/// Checks a .fpk, copies it into a marketplace directory (made if there is none) and replaces the index
/// atomically, generation + 1. Throws fiona::Error: Failed if the package is not valid, NotAllowed if this
/// version is published with other content.
PublishOutcome publish(const std::filesystem::path& package, const std::filesystem::path& marketplace,
                       const PublishOptions& options = {});

}  // namespace fiona::marketplace
