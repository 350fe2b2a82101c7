#include "trusted_metadata.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fiona/error.hpp>

#include "refuse.hpp"

namespace fiona::tuf {
namespace {

constexpr std::string_view kKeeper = "tell the repository's keeper; nothing was changed here";

[[noreturn]] void refuse_rollback(const std::string& what, std::int64_t trusted, std::int64_t found) {
  refuse(ErrorCode::BadSignature,
         ErrorText{.what = "rollback: " + what,
                   .expected = fmt::format("version {} or newer", trusted),
                   .found = fmt::format("version {}", found),
                   .next = "try again later or from another mirror; what was trusted stays trusted"});
}

[[noreturn]] void refuse_mixture(const std::string& what, std::string expected, std::string found) {
  refuse(ErrorCode::BadSignature, ErrorText{.what = "mix and match: " + what,
                                            .expected = std::move(expected),
                                            .found = std::move(found),
                                            .next = "try again later or from another mirror"});
}

void require_version(const RoleFile& file, std::int64_t listed, std::string_view by) {
  if (file.version == listed) return;
  refuse_mixture(fmt::format("{} is not the version that {} lists", file.shown, by), fmt::format("version {}", listed),
                 fmt::format("version {}", file.version));
}

}  // namespace

void require_listed(std::string_view bytes, const Listed& listed, const std::string& shown, std::string_view by) {
  if (listed.length && *listed.length != bytes.size()) {
    refuse_mixture(fmt::format("{} has not the length that {} lists", shown, by),
                   fmt::format("{} bytes", *listed.length), fmt::format("{} bytes", bytes.size()));
  }
  Digests digests{listed.hashes};
  digests.update(bytes);
  for (const auto& [algorithm, found] : digests.finish()) {
    const std::string& expected = listed.hashes.at(algorithm);
    if (found == expected) continue;
    refuse_mixture(fmt::format("{} has not the hash that {} lists", shown, by), algorithm + " " + expected,
                   algorithm + " " + found);
  }
}

TrustedMetadata::TrustedMetadata(std::string_view root, Time start)
    : start_(start), root_(parse_root(root, "root.json")) {
  require_signatures(root_, root_.signers(kRoot), root_.keys, "itself");
}

void TrustedMetadata::require_fresh(const RoleFile& file) const {
  if (file.expires > start_) return;
  refuse(ErrorCode::BadSignature,
         ErrorText{.what = fmt::format("freeze: {} has expired", file.shown),
                   .expected = "a file that is still valid at " + time_text(start_),
                   .found = "valid until " + time_text(file.expires),
                   .next = "check this machine's clock (date -u), then ask the repository's keeper; what is "
                           "installed goes on working"});
}

bool TrustedMetadata::update_root(std::string_view bytes) {
  Root next = parse_root(bytes, fmt::format("{}.root.json", root_.version + 1));
  require_signatures(next, root_.signers(kRoot), root_.keys, "the root before it");
  require_signatures(next, next.signers(kRoot), next.keys, "itself");
  if (next.version != root_.version + 1) {
    refuse(ErrorCode::BadSignature,
           ErrorText{.what = fmt::format("rollback: {} is of another version than its name says", next.shown),
                     .expected = fmt::format("version {}", root_.version + 1),
                     .found = fmt::format("version {}", next.version),
                     .next = std::string(kKeeper)});
  }
  const auto rotated = [&](std::string_view role) { return next.signers(role).key_ids != root_.signers(role).key_ids; };
  const bool forget = rotated(kTimestamp) || rotated(kSnapshot);
  root_ = std::move(next);
  return forget;
}

void TrustedMetadata::end_of_roots() const { require_fresh(root_); }

void TrustedMetadata::remember_timestamp(std::string_view bytes) {
  Timestamp remembered = parse_timestamp(bytes, "timestamp.json");
  require_signatures(remembered, root_.signers(kTimestamp), root_.keys, "the role 'timestamp'");
  timestamp_ = std::move(remembered);
}

bool TrustedMetadata::update_timestamp(std::string_view bytes) {
  Timestamp next = parse_timestamp(bytes, "timestamp.json");
  require_signatures(next, root_.signers(kTimestamp), root_.keys, "the role 'timestamp'");
  if (timestamp_) {
    if (next.version < timestamp_->version) {
      refuse_rollback("timestamp.json is older than the one that is trusted", timestamp_->version, next.version);
    }
    if (next.version == timestamp_->version) {
      require_fresh(*timestamp_);
      return false;
    }
    if (next.snapshot.version < timestamp_->snapshot.version) {
      refuse_rollback("timestamp.json lists an older snapshot.json than the trusted one does",
                      timestamp_->snapshot.version, next.snapshot.version);
    }
  }
  require_fresh(next);
  timestamp_ = std::move(next);
  return true;
}

void TrustedMetadata::remember_snapshot(std::string_view bytes) {
  Snapshot remembered = parse_snapshot(bytes, "snapshot.json");
  require_signatures(remembered, root_.signers(kSnapshot), root_.keys, "the role 'snapshot'");
  snapshot_ = std::move(remembered);
  snapshot_bytes_ = bytes;
}

bool TrustedMetadata::snapshot_is_current() const {
  if (!snapshot_ || snapshot_->version != timestamp_->snapshot.version) return false;
  try {
    require_listed(snapshot_bytes_, timestamp_->snapshot, snapshot_->shown, "timestamp.json");
    require_fresh(*snapshot_);
    return true;
  } catch (const Error&) {
    return false;  // the repository's own may be better
  }
}

void TrustedMetadata::update_snapshot(std::string_view bytes) {
  require_listed(bytes, timestamp_->snapshot, "snapshot.json", "timestamp.json");
  Snapshot next = parse_snapshot(bytes, "snapshot.json");
  require_signatures(next, root_.signers(kSnapshot), root_.keys, "the role 'snapshot'");
  require_version(next, timestamp_->snapshot.version, "timestamp.json");
  for (const auto& [name, before] : snapshot_ ? snapshot_->files : std::map<std::string, Listed>{}) {
    const auto now = next.files.find(name);
    if (now == next.files.end()) {
      refuse(ErrorCode::BadSignature, ErrorText{.what = fmt::format("rollback: snapshot.json no longer lists {}", name),
                                                .expected = fmt::format("version {} or newer", before.version),
                                                .next = std::string(kKeeper)});
    }
    if (now->second.version < before.version) {
      refuse_rollback(fmt::format("snapshot.json lists an older {} than the trusted one does", name), before.version,
                      now->second.version);
    }
  }
  require_fresh(next);
  snapshot_ = std::move(next);
  snapshot_bytes_ = bytes;
}

const Listed& TrustedMetadata::listed(std::string_view role) const {
  const auto found = snapshot_->files.find(file_of(role));
  if (found != snapshot_->files.end()) return found->second;
  refuse(ErrorCode::BadSignature, ErrorText{.what = fmt::format("snapshot.json does not list {}", file_of(role)),
                                            .expected = "its version",
                                            .next = std::string(kKeeper)});
}

const Targets& TrustedMetadata::update_targets(std::string_view bytes, const std::string& role,
                                               const std::string& delegator) {
  const Listed& expected = listed(role);
  require_listed(bytes, expected, file_of(role), "snapshot.json");
  Targets next = parse_targets(bytes, file_of(role));
  require_delegated(next, role, delegator);
  require_version(next, expected.version, "snapshot.json");
  require_fresh(next);
  return targets_.insert_or_assign(role, std::move(next)).first->second;
}

const Targets* TrustedMetadata::targets(const std::string& role, const std::string& delegator) const {
  const auto found = targets_.find(role);
  if (found == targets_.end()) return nullptr;
  // Another role may have vouched for it: whoever delegates names the keys.
  require_delegated(found->second, role, delegator);
  return &found->second;
}

void TrustedMetadata::require_delegated(const Targets& file, const std::string& role,
                                        const std::string& delegator) const {
  if (role == kTargets) return require_signatures(file, root_.signers(kTargets), root_.keys, "the role 'targets'");
  const Targets& owner = targets_.at(delegator);
  const auto delegation = std::ranges::find(owner.delegations, role, &Delegation::role);
  if (delegation == owner.delegations.end()) {
    refuse(ErrorCode::BadSignature, {.what = fmt::format("{} does not delegate to {}", delegator, role),
                                     .next = "tell the keeper of the repository"});
  }
  require_signatures(file, delegation->signers, owner.keys, fmt::format("the role '{}'", role));
}

}  // namespace fiona::tuf
