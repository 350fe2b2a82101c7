#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "metadata.hpp"

namespace fiona::tuf {

/// What a client trusts, and by which rules that changes: steps 5.1 to 5.6.6 of the specification's client workflow, as
/// far as they need neither network nor disk. Each update either leaves what the specification asks for or throws
/// fiona::Error (BadSignature) and changes nothing. Order: roots, end_of_roots, timestamp, snapshot, targets.
class TrustedMetadata {
 public:
  /// 5.1, 5.2: the fixed start time, and the root that is trusted by definition. It must be its own: what is not has
  /// been damaged.
  TrustedMetadata(std::string_view root, Time start);

  const Root& root() const { return root_; }
  const std::optional<Timestamp>& timestamp() const { return timestamp_; }
  const std::optional<Snapshot>& snapshot() const { return snapshot_; }

  /// 5.3.4 to 5.3.7. Returns whether the keys of timestamp or snapshot have changed, so that what they signed must be
  /// forgotten (5.3.11).
  bool update_root(std::string_view bytes);
  /// 5.3.10.
  void end_of_roots() const;

  /// The last-seen timestamp: against it the next is no rollback. It may have expired. Not to be signed by the role any
  /// more is to be forgotten.
  void remember_timestamp(std::string_view bytes);
  /// 5.4.2 to 5.4.4. False: it is of the version that is trusted already, which stays.
  bool update_timestamp(std::string_view bytes);

  /// The last-seen snapshot, as above.
  void remember_snapshot(std::string_view bytes);
  /// Whether the remembered snapshot is the one that the timestamp lists, so that none need be fetched.
  bool snapshot_is_current() const;
  /// 5.5.2 to 5.5.6.
  void update_snapshot(std::string_view bytes);

  /// What the snapshot lists for a role. Throws where it lists nothing.
  const Listed& listed(std::string_view role) const;
  /// 5.6.2 to 5.6.5, for the top-level role or one that `delegator` delegates to.
  const Targets& update_targets(std::string_view bytes, const std::string& role, const std::string& delegator);
  /// A role that has been updated, if it has, checked against the keys that this delegator names.
  const Targets* targets(const std::string& role, const std::string& delegator) const;

 private:
  void require_fresh(const RoleFile& file) const;
  void require_delegated(const Targets& file, const std::string& role, const std::string& delegator) const;

  const Time start_;
  Root root_;
  std::optional<Timestamp> timestamp_;
  std::optional<Snapshot> snapshot_;
  std::string snapshot_bytes_;
  std::map<std::string, Targets> targets_;
};

/// Throws fiona::Error (BadSignature) unless the bytes are of the length and have the hashes that are listed, as far as
/// they are.
void require_listed(std::string_view bytes, const Listed& listed, const std::string& shown, std::string_view by);

}  // namespace fiona::tuf
