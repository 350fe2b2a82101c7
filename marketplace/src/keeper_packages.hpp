#pragma once

#include <chrono>
#include <filesystem>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/trust/tuf_repository.hpp>
#include <optional>
#include <string>
#include <vector>

#include "durable.hpp"

namespace fiona::marketplace {

/// What a key signs follows what it has signed last: one at a time.
class SigningLock {
 public:
  explicit SigningLock(const KeeperOptions& options) : directory_(os_, options.keys.path(), 0700) {
    directory_.lock(std::chrono::seconds{10});
  }

 private:
  const OsCalls os_ = system_calls();
  DurableDirectory directory_;
};

/// A package that was read, and how metadata speaks of it.
struct ReadPackage {
  IndexEntry entry;
  std::string path;  ///< among the targets
  std::string sha256;
};

ReadPackage read_for_keeping(const std::filesystem::path& path, const KeeperOptions& options);

/// Copies a file whose hash is known: if it changed since, that says so.
void copy_checked(const std::filesystem::path& from, const std::string& sha256, const DurableDirectory& to,
                  const std::string& name);

/// Null: there is none.
const tuf::TargetInfo* find_target(const std::vector<tuf::TargetInfo>& targets, const std::string& path);

bool signs_for(const tuf::RoleContent& role, const ReadPackage& package);

/// "publisher/name@version" of a target's path.
std::string package_named(const std::string& path);

/// The name of a target's file in the directory of its publisher.
std::string consistent_name(const std::string& path, const std::string& sha256);

/// The publisher's file, signed again if it does not say this yet, or not for long. `only`: it says no more than this.
std::string signed_role(const std::string& publisher, const std::vector<ReadPackage>& packages, bool only,
                        const KeeperOptions& options);

}  // namespace fiona::marketplace
