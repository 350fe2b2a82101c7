#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fiona/trust/signing_key.hpp>
#include <fiona/trust/tuf_client.hpp>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::tuf {

/// How long what is signed now is valid. Signed anew before half of it is over, at any commit.
struct Lifetimes {
  std::chrono::days root{730};
  std::chrono::days targets{365};  ///< the top-level role and those that are delegated to
  std::chrono::days online{30};    ///< snapshot, timestamp
};

struct RepositoryOptions {
  std::filesystem::path directory{};  ///< of the repository: `metadata` and `targets` are in it
  std::filesystem::path trusted{};    ///< what its keeper has seen of it, as a client's
  Lifetimes lifetimes{};
  std::function<Time()> now{};  ///< default: the system's clock
  marketplace::OsCalls os = marketplace::system_calls();
};

/// A TUF repository in a directory, as its keeper changes it: consistent snapshots, Ed25519. What lies there is
/// believed no more than a client would (but for its expiry), so that nobody who can write into the directory gets
/// anything signed. Nothing is seen before commit(), which replaces timestamp.json last. Throws fiona::Error:
/// NotAllowed where a key of a role is missing, BadSignature where the directory holds what nobody has signed.
class Repository {
 public:
  /// The first version of all four roles. Throws fiona::Error (NotAllowed) if there is a repository.
  static void create(const RepositoryOptions& options, const SigningKey& root, const SigningKey& targets,
                     const SigningKey& online);

  /// `keys` must outlive it. Takes the lock of the directory.
  Repository(const RepositoryOptions& options, const SigningKeys& keys);
  ~Repository();

  /// Whether snapshot and timestamp can be signed with these keys.
  bool may_commit() const;
  /// The root that clients are given to trust.
  std::string root() const;

  /// The keys that a delegated role is signed with; empty: there is no such role.
  std::vector<std::string> key_ids_of(const std::string& role) const;
  /// Those that the top-level targets delegate to.
  std::vector<std::string> delegated_roles() const;
  /// The version that the snapshot lists; 0: there is no such role.
  std::int64_t version_of(const std::string& role) const;
  /// Targets of a delegated role, as it is now.
  std::vector<TargetInfo> targets_of(const std::string& role) const;

  /// Lets a role speak for the paths, and no others, with any of the keys; in place of what it might before.
  void delegate(const std::string& role, const std::vector<OpenKey>& keys, const std::vector<std::string>& paths);
  /// The keys of a role, as others are given them, and how many of them have to sign.
  struct RoleKeys {
    std::vector<OpenKey> keys;  ///< Ed25519; another kind as "id " and its id
    std::int64_t threshold = 1;
  };
  /// Of one of the four top-level roles, or of one that is delegated to; no keys: there is no such role.
  RoleKeys keys_of(const std::string& role) const;
  /// When what a role signed last is over: "2030-01-31T00:00:00Z"; empty: it has signed nothing.
  std::string expires(const std::string& role) const;

  /// Proposes a next root in which top-level roles have these keys, in place of what is proposed already. It becomes
  /// the root once as many keys of the old root and of the new one have signed it as each wants. Throws fiona::Error
  /// (Usage) for a threshold that the keys cannot meet.
  void propose(const std::vector<std::string>& roles, const RoleKeys& keys);
  /// The keys that a top-level role would have, where a next root is proposed. Anybody who can write into the directory
  /// may have proposed it. Throws fiona::Error (BadSignature) where it changes more than keys.
  std::optional<RoleKeys> proposed(const std::string& role) const;
  /// How many signatures the proposed root still lacks; 0: the next commit makes it the root; nothing: none is
  /// proposed.
  std::optional<std::int64_t> proposal_lacks() const;
  /// Signs the proposed root with the keys that are here and that it needs.
  void sign_proposed() const;

  /// Lets a role speak for nothing any more. Its file stays listed: clients take its absence for a rollback.
  void undelegate(const std::string& role);
  /// Takes a new version of a delegated role, signed by its keys. Throws BadSignature if it is not, or not newer.
  void take_role(const std::string& role, std::string_view file);
  /// Says what a target is, in a role whose key is here.
  void set_target(const std::string& role, const std::string& path, std::uint64_t length, const std::string& sha256);

  /// Signs and writes all that has changed, then snapshot and timestamp.
  void commit();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// What a delegated role's file says, if this key has signed it and nothing is wrong with its form. Throws fiona::Error
/// (BadSignature). Its expiry is told, not judged.
struct RoleContent {
  std::int64_t version = 0;
  Time expires{};
  std::vector<TargetInfo> targets;  ///< each with its sha256
};
RoleContent read_role(std::string_view file, const OpenKey& key, const std::string& shown);

/// The key that a role's file says it is signed with ("x-fiona-key"), which nobody has vouched for.
std::optional<OpenKey> claimed_key(std::string_view file, const std::string& shown);

/// The next version of a role after `before` (if any), with these targets: beside those that it had, or `only` these.
/// Its version is at least `version`.
std::string next_role(const std::optional<std::string>& before, const SigningKey& key,
                      const std::vector<TargetInfo>& targets, bool only, Time expires, std::int64_t version = 1);

}  // namespace fiona::tuf
