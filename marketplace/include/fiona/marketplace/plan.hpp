#pragma once

#include <cstdint>
#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/store.hpp>
#include <optional>
#include <string>
#include <vector>

namespace fiona::marketplace {

/// What a package has to fit: this FIONA and this machine.
struct Platform {
  std::string version;       ///< of FIONA
  std::string abi;           ///< the tag of its SDK
  std::string architecture;  ///< "x86_64"

  /// Of the running program.
  static Platform here();
};

enum class StepKind {
  Install,    ///< it was not there
  Upgrade,    ///< an older version is there
  Downgrade,  ///< a newer version is there
  Replace,    ///< this version is there, with other content
  Repair,     ///< it is there, and its files are damaged
  Remove,
};

/// One package that a plan changes.
struct PlanStep {
  StepKind kind = StepKind::Install;
  std::string package;                  ///< "publisher/name"
  std::string version;                  ///< after it; of one that is removed, what is there
  std::string previous_version;         ///< empty: none
  std::string because;                  ///< why, where nobody asked for it by name: "acme/nav requires it"
  std::vector<std::string> rights;      ///< that it asks for
  std::vector<std::string> new_rights;  ///< of them those that the package that is there has not asked for
  bool new_publisher = false;           ///< nothing of this publisher is installed
  std::vector<std::string> new_keys;    ///< of its publisher, with which nothing that is installed was signed
  std::vector<std::string> known_keys;  ///< of its publisher, with which something was
  std::optional<IndexEntry> entry{};    ///< what to install; none to remove, or where the store has it still
  std::string source{};                 ///< of the marketplace that has the entry
};

/// A required port that nothing installed could serve.
struct MissingService {
  std::string port;                    ///< "acme/nav: nav.location"
  std::string service;                 ///< full name
  std::vector<std::string> providers;  ///< packages of the marketplace that provide it
};

/// What a change of a store will do. A value, made for one generation of the store: apply() refuses it for another.
struct Plan {
  std::uint64_t generation = 0;    ///< of the store that it was made for
  std::string change;              ///< "install acme/nav"
  std::vector<PlanStep> steps;     ///< by name of package
  std::vector<std::string> notes;  ///< what is not done though it could be meant, and why
  std::vector<MissingService> missing;
  std::vector<std::string> asked;  ///< installed or to be, now asked for by name
  std::uint64_t rollback_to = 0;   ///< a generation that comes back; 0: none

  /// Whether it does more than was typed, so that whoever typed it should see it first: rights, a new publisher,
  /// packages that nobody named, an older version that nobody named.
  bool needs_consent() const;
};

/// Those that a plan is made from.
using Marketplaces = std::vector<const Marketplace*>;

/// Each request is "[publisher/]name[@version]": the newest version that fits, or exactly that one. A package that is
/// installed is brought up to date. Throws fiona::Error: NotFound, DependencyConflict with the reasons in a sentence.
Plan plan_install(const std::vector<std::string>& requests, const Marketplace& from, const Store& store,
                  const Platform& platform = Platform::here());

/// The newest versions of these installed packages that fit together; no names: of all. Other content of the same version
/// only for what came from this marketplace. Throws as plan_install.
Plan plan_update(const std::vector<std::string>& names, const Marketplace& from, const Store& store,
                 const Platform& platform = Platform::here());

/// Exactly what a lock says, each package from the first of the marketplaces that has it to the byte. Throws as
/// plan_install; BadSignature if one has a version with other content, and none the right one.
Plan plan_locked(const Lock& lock, const Marketplaces& from, const Store& store,
                 const Platform& platform = Platform::here());

/// These and the packages that came with them and that nothing else requires. Throws fiona::Error: NotFound;
/// DependencyConflict that names who requires one of them.
Plan plan_remove(const std::vector<std::string>& names, const Store& store);

/// Back to a kept generation; none named: the one that the present was made from. Throws fiona::Error (NotFound) with
/// those that are kept.
Plan plan_rollback(std::optional<std::uint64_t> generation, const Store& store);

}  // namespace fiona::marketplace
