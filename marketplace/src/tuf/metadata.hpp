#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "digest.hpp"
#include "fiona/trust/tuf_client.hpp"
#include "json.hpp"
#include "public_key.hpp"

namespace fiona::tuf {

inline constexpr std::string_view kRoot = "root", kTimestamp = "timestamp", kSnapshot = "snapshot",
                                  kTargets = "targets";

/// Whether `name` is one of the four, which no delegated role may have.
bool is_top_level(std::string_view name);

/// The name of a role's file, as snapshots list it.
inline std::string file_of(std::string_view role) { return std::string(role) + ".json"; }

struct Signature {
  std::string key_id;
  std::string bytes;  ///< empty where it is not hexadecimal: such a one counts for nothing
};

/// What the files of all roles have (specification 4.2).
struct RoleFile {
  std::string shown;  ///< how errors name it: "3.root.json"
  std::int64_t version = 0;
  Time expires{};
  std::string signed_bytes;  ///< canonical
  std::vector<Signature> signatures;
};

/// Who may sign for a role.
struct Signers {
  std::set<std::string> key_ids;
  std::int64_t threshold = 1;
};

/// What one file of metadata says of another.
struct Listed {
  std::int64_t version = 0;
  std::optional<std::uint64_t> length;
  Hashes hashes;  ///< may be empty
};

struct Root : RoleFile {
  bool consistent_snapshot = false;
  Keys keys;
  std::map<std::string, Signers, std::less<>> roles;  ///< at least the four

  const Signers& signers(std::string_view role) const { return roles.find(role)->second; }
};

struct Timestamp : RoleFile {
  Listed snapshot;
};

struct Snapshot : RoleFile {
  std::map<std::string, Listed> files;  ///< by file name
};

struct Delegation {
  std::string role;
  Signers signers;
  std::vector<std::string> paths;          ///< patterns; or
  std::vector<std::string> hash_prefixes;  ///< of SHA-256 of the path
  bool terminating = false;

  bool covers(const std::string& path) const;
};

struct Targets : RoleFile {
  std::map<std::string, TargetInfo> targets;  ///< by path
  Keys keys;
  std::vector<Delegation> delegations;
};

// Each reads the file of one role, and checks its form: signatures, version and expiry are for who knows what to
// expect. Unknown members are let be. Throws fiona::Error (BadSignature).
Root parse_root(std::string_view bytes, const std::string& shown);
Timestamp parse_timestamp(std::string_view bytes, const std::string& shown);
Snapshot parse_snapshot(std::string_view bytes, const std::string& shown);
Targets parse_targets(std::string_view bytes, const std::string& shown);

/// Throws fiona::Error (BadSignature) unless as many different keys as the threshold wants have signed the file. One
/// key under two ids counts once.
void require_signatures(const RoleFile& file, const Signers& signers, const Keys& keys, const std::string& by);

/// "YYYY-MM-DDTHH:MM:SSZ", and back. Throws as the above.
Time parse_time(const std::string& text, const std::string& where);
std::string time_text(Time time);

/// glob(7), element by element: '*', '?' and [sets] never match a '/'. Time: product of the lengths.
bool matches_pattern(std::string_view pattern, std::string_view path);

}  // namespace fiona::tuf
