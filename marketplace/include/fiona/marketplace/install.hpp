#pragma once

#include <chrono>
#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/os_calls.hpp>
#include <fiona/marketplace/plan.hpp>
#include <functional>
#include <string>
#include <vector>

namespace fiona::marketplace {

struct InstallOptions {
  PackageLimits limits{};
  std::chrono::milliseconds lock_wait{10'000};  ///< for another change of this store to end
  /// Told once, as "process 4711 (fiona market install acme/nav)", when that is what is waited for.
  std::function<void(const std::string& who)> on_wait{};
  OsCalls os = system_calls();
  Platform platform = Platform::here();
};

/// Does what a plan says, atomically: killed, out of space or out of power at any point, the store holds the old state
/// or the new one, and the next change sweeps what was left. The state before stays as a generation that plan_rollback
/// can go back to. Returns false, and does nothing, if the store has changed since the plan was made: plan again.
/// `from` has those that the plan was made from, as far as it installs. Throws fiona::Error: BadSignature (the package
/// is not what the index says), Unreachable (the lock), Failed (system calls; the store is unchanged).
bool apply(const Plan& plan, const Marketplaces& from, const std::filesystem::path& store,
           const InstallOptions& options = {});

/// Keeps beside a store what the marketplace has revoked of what the store has from there; a host refuses to start that
/// from then on. Returns what was not known before. Throws fiona::Error: Unreachable (the lock), Failed.
std::vector<Revocation> note_revocations(const Marketplace& from, const std::filesystem::path& store,
                                         const InstallOptions& options = {});

/// Makes a store of packages that nobody has signed for, in place of what is there, for one run of a host. Each is
/// checked as any other but for its signature. Throws fiona::Error: NotAllowed if two have the same name.
void install_unsigned(const std::vector<std::filesystem::path>& packages, const std::filesystem::path& store);

}  // namespace fiona::marketplace
