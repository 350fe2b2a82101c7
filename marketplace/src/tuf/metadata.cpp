#include "metadata.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fiona/error.hpp>

#include "refuse.hpp"

namespace fiona::tuf {
namespace {

// Bounds that keep what a hostile delegation costs linear in its size.
constexpr std::size_t kMostPatternBytes = 1024;
constexpr std::size_t kMostSetBytes = 64;

void check_spec_version(const std::string& version, const std::string& where) {
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  const std::string_view rest = std::string_view(version).substr(version.empty() ? 0 : 1);
  if (version.starts_with("1.") && rest.size() > 1 && digit(rest[1])) return;
  refuse(ErrorCode::BadSignature,
         ErrorText{.what = where + " is written to a version of the TUF specification that is not known here",
                   .expected = "1.x.y",
                   .found = version.substr(0, 40),
                   .next = "see whether a newer FIONA can read this repository"});
}

std::vector<Signature> parse_signatures(const Json& file, const std::string& where) {
  std::vector<Signature> signatures;
  std::set<std::string> ids;
  for (const Json& item : array_in(file, "signatures", where)) {
    if (!item.is_object()) refuse_form(where, "a signature is not an object");
    signatures.push_back({string_in(item, "keyid", where), from_hex(string_in(item, "sig", where))});
    if (!ids.insert(signatures.back().key_id).second) {
      refuse_form(where, "the key id " + signatures.back().key_id.substr(0, 80) + " has two signatures");
    }
  }
  return signatures;
}

// Fills what all roles have, and returns what is signed.
Json parse_role_file(std::string_view bytes, std::string_view type, const std::string& shown, RoleFile& file) {
  Json whole = parse_json(bytes, shown);
  if (!whole.is_object()) refuse_form(shown, "it is not an object");
  Json body = object_in(whole, "signed", shown);
  file.shown = shown;
  file.signatures = parse_signatures(whole, shown);
  if (const std::string& found = string_in(body, "_type", shown); found != type) {
    refuse_form(shown, fmt::format("it is a file of the role '{}', not of '{}'", found.substr(0, 40), type));
  }
  check_spec_version(string_in(body, "spec_version", shown), shown);
  file.version = number_in(body, "version", 1, shown);
  file.expires = parse_time(string_in(body, "expires", shown), shown);
  file.signed_bytes = canonical(body);
  return body;
}

Keys parse_keys(const Json& owner, const std::string& where) {
  Keys keys;
  for (const auto& item : object_in(owner, "keys", where).items())
    keys.emplace(item.key(), PublicKey(item.value(), where));
  return keys;
}

Signers parse_signers(const Json& role, const std::string& where) {
  Signers signers;
  for (const auto& id : strings_in(role, "keyids", where)) {
    if (!signers.key_ids.insert(id).second)
      refuse_form(where, "a role lists the key id " + id.substr(0, 80) + " twice");
  }
  signers.threshold = number_in(role, "threshold", 1, where);
  return signers;
}

Hashes parse_hashes(const Json& hashes, const std::string& where) {
  Hashes parsed;
  bool known = false;
  for (const auto& item : hashes.items()) {
    if (!item.value().is_string()) refuse_form(where, "a hash is not a string");
    // Hexadecimal of either case is the same digest.
    parsed[item.key()] = to_hex(from_hex(item.value().get_ref<const std::string&>()));
    known = known || is_known_hash(item.key());
  }
  if (!known) refuse_form(where, "'hashes' has no algorithm that is known here");
  return parsed;
}

Listed parse_listed(const Json& listed, const std::string& where) {
  if (!listed.is_object()) refuse_form(where, "what 'meta' says of a file is not an object");
  Listed parsed;
  parsed.version = number_in(listed, "version", 1, where);
  if (listed.contains("length")) parsed.length = static_cast<std::uint64_t>(number_in(listed, "length", 0, where));
  if (listed.contains("hashes")) parsed.hashes = parse_hashes(object_in(listed, "hashes", where), where);
  return parsed;
}

TargetInfo parse_target(const std::string& path, const Json& target, const std::string& where) {
  if (!target.is_object()) refuse_form(where, "a target is not an object");
  TargetInfo info;
  info.path = path;
  info.length = static_cast<std::uint64_t>(number_in(target, "length", 0, where));
  info.hashes = parse_hashes(object_in(target, "hashes", where), where);
  if (target.contains("custom")) info.custom = target["custom"].dump();
  return info;
}

Delegation parse_delegation(const Json& role, const std::string& where) {
  if (!role.is_object()) refuse_form(where, "a delegation is not an object");
  Delegation delegation;
  delegation.role = string_in(role, "name", where);
  if (delegation.role.empty() || is_top_level(delegation.role)) {
    refuse_form(where, "it delegates to a role named '" + delegation.role + "', which no delegated role may be");
  }
  delegation.signers = parse_signers(role, where);
  if (role.contains("paths") == role.contains("path_hash_prefixes")) {
    refuse_form(where, "a delegation must have either 'paths' or 'path_hash_prefixes'");
  }
  if (role.contains("paths")) delegation.paths = strings_in(role, "paths", where);
  if (std::ranges::any_of(delegation.paths, [](const auto& pattern) { return pattern.size() > kMostPatternBytes; })) {
    refuse_form(where, "a pattern in 'paths' is longer than " + std::to_string(kMostPatternBytes) + " bytes");
  }
  if (role.contains("path_hash_prefixes")) delegation.hash_prefixes = strings_in(role, "path_hash_prefixes", where);
  if (const auto terminating = role.find("terminating"); terminating != role.end()) {
    if (!terminating->is_boolean()) refuse_form(where, "'terminating' is neither true nor false");
    delegation.terminating = terminating->get<bool>();
  }
  return delegation;
}

void parse_delegations(const Json& delegations, Targets& targets) {
  targets.keys = parse_keys(delegations, targets.shown);
  std::set<std::string> names;
  for (const Json& role : array_in(delegations, "roles", targets.shown)) {
    targets.delegations.push_back(parse_delegation(role, targets.shown));
    const std::string& name = targets.delegations.back().role;
    if (!names.insert(name).second) refuse_form(targets.shown, "it delegates to the role '" + name + "' twice");
  }
}

// One element of a set after its '[': where it ends, and whether it has the character. npos: the set has no end, and
// the
// '[' stands for itself.
std::size_t match_set(std::string_view pattern, char c, bool& matches) {
  std::size_t at = 0;
  const bool inverted = !pattern.empty() && (pattern[0] == '!' || pattern[0] == '^');
  if (inverted) ++at;
  bool found = false;
  for (bool first = true; at < pattern.size(); first = false) {
    if (pattern[at] == ']' && !first) {
      matches = found != inverted;
      return at + 1;
    }
    const bool range = at + 2 < pattern.size() && pattern[at + 1] == '-' && pattern[at + 2] != ']';
    found = found || (range ? pattern[at] <= c && c <= pattern[at + 2] : pattern[at] == c);
    at += range ? 3 : 1;
  }
  return std::string_view::npos;
}

// How much of `pattern` matches this one character; 0: it does not.
std::size_t match_one(std::string_view pattern, char c) {
  if (pattern[0] == '?') return 1;
  bool matches = false;
  const std::size_t set =
      pattern[0] == '[' ? match_set(pattern.substr(1, kMostSetBytes), c, matches) : std::string_view::npos;
  if (set != std::string_view::npos) return matches ? 1 + set : 0;
  return pattern[0] == c ? 1 : 0;
}

// Without '/'. On a mismatch it goes back to the last '*' only: earlier ones can give nothing that the last cannot.
bool matches_element(std::string_view pattern, std::string_view text) {
  std::size_t p = 0, t = 0, star = std::string_view::npos, after_star = 0;
  while (t < text.size()) {
    if (p < pattern.size() && pattern[p] == '*') {
      star = p++;
      after_star = t;
    } else if (const std::size_t used = p < pattern.size() ? match_one(pattern.substr(p), text[t]) : 0; used > 0) {
      p += used;
      ++t;
    } else if (star != std::string_view::npos) {
      p = star + 1;
      t = ++after_star;
    } else {
      return false;
    }
  }
  return pattern.find_first_not_of('*', p) == std::string_view::npos;
}

}  // namespace

bool is_top_level(std::string_view name) {
  return name == kRoot || name == kTimestamp || name == kSnapshot || name == kTargets;
}

bool Delegation::covers(const std::string& path) const {
  if (std::ranges::any_of(paths, [&](const auto& pattern) { return matches_pattern(pattern, path); })) return true;
  if (hash_prefixes.empty()) return false;
  const std::string hash = sha256_hex(path);
  return std::ranges::any_of(hash_prefixes, [&](const auto& prefix) { return hash.starts_with(prefix); });
}

Root parse_root(std::string_view bytes, const std::string& shown) {
  Root root;
  const Json body = parse_role_file(bytes, kRoot, shown, root);
  if (const auto consistent = body.find("consistent_snapshot"); consistent != body.end()) {
    if (!consistent->is_boolean()) refuse_form(shown, "'consistent_snapshot' is neither true nor false");
    root.consistent_snapshot = consistent->get<bool>();
  }
  root.keys = parse_keys(body, shown);
  for (const auto& item : object_in(body, "roles", shown).items()) {
    if (!is_top_level(item.key()) && item.key() != "mirrors") {
      refuse_form(shown, "it has a role '" + item.key().substr(0, 40) + "', which no root has");
    }
    if (!item.value().is_object()) refuse_form(shown, "a role is not an object");
    root.roles.emplace(item.key(), parse_signers(item.value(), shown));
  }
  for (const auto role : {kRoot, kTimestamp, kSnapshot, kTargets}) {
    if (root.roles.find(role) == root.roles.end()) refuse_form(shown, fmt::format("it has no role '{}'", role));
  }
  return root;
}

Timestamp parse_timestamp(std::string_view bytes, const std::string& shown) {
  Timestamp timestamp;
  const Json body = parse_role_file(bytes, kTimestamp, shown, timestamp);
  const Json& files = object_in(body, "meta", shown);
  timestamp.snapshot = parse_listed(object_in(files, "snapshot.json", shown), shown);
  return timestamp;
}

Snapshot parse_snapshot(std::string_view bytes, const std::string& shown) {
  Snapshot snapshot;
  const Json body = parse_role_file(bytes, kSnapshot, shown, snapshot);
  for (const auto& item : object_in(body, "meta", shown).items()) {
    snapshot.files.emplace(item.key(), parse_listed(item.value(), shown));
  }
  return snapshot;
}

Targets parse_targets(std::string_view bytes, const std::string& shown) {
  Targets targets;
  const Json body = parse_role_file(bytes, kTargets, shown, targets);
  for (const auto& item : object_in(body, "targets", shown).items()) {
    targets.targets.emplace(item.key(), parse_target(item.key(), item.value(), shown));
  }
  if (body.contains("delegations")) parse_delegations(object_in(body, "delegations", shown), targets);
  return targets;
}

void require_signatures(const RoleFile& file, const Signers& signers, const Keys& keys, const std::string& by) {
  std::set<std::string> signed_by;
  for (const Signature& signature : file.signatures) {
    const auto key = keys.find(signature.key_id);
    if (!signers.key_ids.contains(signature.key_id) || key == keys.end()) continue;
    if (key->second.verifies(file.signed_bytes, signature.bytes)) signed_by.insert(key->second.identity());
  }
  if (static_cast<std::int64_t>(signed_by.size()) >= signers.threshold) return;
  refuse(ErrorCode::BadSignature,
         ErrorText{.what = fmt::format("{} is not signed by {}", file.shown, by),
                   .expected = fmt::format("valid signatures of {} different keys out of its {}", signers.threshold,
                                           signers.key_ids.size()),
                   .found = std::to_string(signed_by.size()),
                   .next = "tell the repository's keeper; nothing was changed here"});
}

Time parse_time(const std::string& text, const std::string& where) {
  const auto number = [&text](std::size_t at, std::size_t size) {
    int value = 0;
    for (std::size_t i = at; i < at + size; ++i) {
      if (text[i] < '0' || text[i] > '9') return -1;
      value = value * 10 + (text[i] - '0');
    }
    return value;
  };
  const auto fail = [&]() { refuse_form(where, "'expires' is not a time such as 2030-01-31T00:00:00Z"); };
  if (text.size() != 20 || text[4] != '-' || text[7] != '-' || text[10] != 'T' || text[13] != ':' || text[16] != ':' ||
      text[19] != 'Z') {
    fail();
  }
  const int hour = number(11, 2), minute = number(14, 2), second = number(17, 2);
  const std::chrono::year_month_day day{std::chrono::year{number(0, 4)},
                                        std::chrono::month{static_cast<unsigned>(number(5, 2))},
                                        std::chrono::day{static_cast<unsigned>(number(8, 2))}};
  if (number(0, 4) < 0 || !day.ok() || hour < 0 || hour > 23 || minute < 0 || minute > 59 || second < 0 || second > 59)
    fail();
  return std::chrono::sys_days{day} + std::chrono::hours{hour} + std::chrono::minutes{minute} +
         std::chrono::seconds{second};
}

std::string time_text(Time time) {
  const auto days = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day day{days};
  const std::chrono::hh_mm_ss clock{time - days};
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}Z", int{day.year()}, unsigned{day.month()},
                     unsigned{day.day()}, clock.hours().count(), clock.minutes().count(), clock.seconds().count());
}

bool matches_pattern(std::string_view pattern, std::string_view path) {
  for (;;) {
    const std::size_t pattern_end = pattern.find('/'), path_end = path.find('/');
    if (!matches_element(pattern.substr(0, pattern_end), path.substr(0, path_end))) return false;
    if ((pattern_end == std::string_view::npos) != (path_end == std::string_view::npos)) return false;
    if (pattern_end == std::string_view::npos) return true;
    pattern.remove_prefix(pattern_end + 1);
    path.remove_prefix(path_end + 1);
  }
}

}  // namespace fiona::tuf
