#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "../durable.hpp"
#include "fiona/trust/tuf_repository.hpp"
#include "json.hpp"
#include "metadata.hpp"

namespace fiona::tuf {

constexpr const char* kProposal = "root.proposed.json";  // beside the metadata: it is none yet

Time clock_of(const RepositoryOptions& options);

/// "3.targets.json" of a role's body.
std::string versioned(const Json& role, std::string_view name);

/// What another role's file says of this file of a role.
Json listed_as(const Json& role, std::string_view file);

std::string file_content_of(const std::filesystem::path& path);

Repository::RoleKeys role_keys(const Json& role, const Json& keys);

/// Those that none of the roles names.
void drop_unused_keys(Json& keys, const Json& roles);

/// A repository as it is, verified, and what is to be changed of it.
struct Repository::State {
  State(const RepositoryOptions& chosen, const SigningKeys& signing);

  /// What a client that minds no expiry finds.
  void look();

  const Delegation* delegation(const std::string& role) const;

  /// A delegated role's verified content.
  Targets delegated(const std::string& role) const;

  /// A role whose body is to be changed here.
  Json& body(const std::string& role);

  std::int64_t version(const std::string& role) const;

  Json signers_of(const std::string& role) const;

  /// Those of the role's keys that are here; `enough`: as many as it needs.
  std::vector<SigningKey> keys_here(const std::string& role, bool& enough) const;

  std::vector<SigningKey> keys_of(const std::string& role) const;

  bool has_keys_of(const std::string& role) const;

  bool is_half_over(const Json& role, std::chrono::days lifetime) const;

  /// Those that a file is to be signed with: of the root to come and, so that it is good under both, of the root of
  /// now.
  std::vector<SigningKey> signing_keys(const std::string& role) const;

  /// Signs the next version, and lets the snapshot list it.
  void sign(const std::string& role);

  void list(const std::string& role, const Json& signed_part, const std::string& file);

  void renew_what_ages();

  /// Old versions, so that a repository does not grow with each commit. Roots stay: clients follow them one by one.
  void remove_old_versions() const;

  // The next root, which root_proposal.cpp has.

  std::optional<std::string> proposal_file() const;

  /// The body of the next root that was proposed, if it is the one after the root of now.
  std::optional<Json> proposal() const;

  void keep_proposal(const Json& body, const std::vector<SigningKey>& signers, const Json& others) const;

  /// How many signatures of a role's keys a root still lacks.
  static std::int64_t lacks(const Root& file, const Root& by);

  std::int64_t proposal_lacks(const std::string& file) const;

  /// From here on everything is signed for the root that was proposed, if it has all its signatures.
  void turn_to_proposal();

  /// Last of all: what was signed for both is good until then and from then on.
  void publish_proposal();

  RepositoryOptions options;
  const SigningKeys& keys;
  marketplace::OsCalls os;
  marketplace::DurableDirectory metadata;
  Json root, timestamp, snapshot;
  std::optional<Json> former_root;  // while a proposed one takes its place
  Targets parsed_targets;
  std::map<std::string, Json> roles;         // bodies that were read to be changed
  std::set<std::string> changed;             // of those
  std::map<std::string, std::string> taken;  // files of delegated roles, as they came
};

}  // namespace fiona::tuf
