#include <fcntl.h>
#include <fmt/format.h>

#include <array>
#include <fiona/error.hpp>
#include <optional>
#include <set>
#include <vector>

#include "../durable.hpp"
#include "../files.hpp"
#include "fiona/trust/tuf_client.hpp"
#include "locations.hpp"
#include "refuse.hpp"
#include "trusted_metadata.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

constexpr std::chrono::milliseconds kLockWait{10'000};

const filesystem::path& with_root(const filesystem::path& trusted) {
  std::error_code failure;
  if (filesystem::exists(trusted / "root.json", failure)) return trusted;
  refuse(ErrorCode::NotFound,
         ErrorText{.what = "no root is trusted for this repository: there is no root.json",
                   .where = trusted.string(),
                   .next = "fiona keys trust FILE, with a root.json that came by a way you trust"});
}

ClientOptions with_defaults(ClientOptions options) {
  if (!options.now) {
    options.now = [] { return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now()); };
  }
  if (!options.transport) options.transport = make_transport(options.limits);
  return options;
}

// Any of the digests names the file where snapshots are consistent; a repository has a copy for each.
const std::string& naming_hash(const TargetInfo& target) {
  const auto sha256 = target.hashes.find("sha256");
  return sha256 != target.hashes.end() ? sha256->second : target.hashes.begin()->second;
}

std::string remote_name(const TargetInfo& target, bool consistent) {
  if (!consistent) return percent_encoded_path(target.path);
  const std::size_t name = target.path.rfind('/') + 1;
  return percent_encoded_path(target.path.substr(0, name) + naming_hash(target) + "." + target.path.substr(name));
}

}  // namespace

struct Client::State {
  explicit State(ClientOptions chosen)
      : options(with_defaults(std::move(chosen))), files(options.os, with_root(options.trusted), 0700) {
    // Read here, so that a damaged root is told before anything is asked of anybody.
    start();
  }

  /// 5.1, 5.2.
  void start() {
    with_root(options.trusted);
    trusted.emplace(local(std::string(kRoot), options.limits.root_bytes).value_or(""), options.now());
  }

  /// Nobody else changes the trusted files while this lives.
  marketplace::DurableDirectory locked() const {
    marketplace::DurableDirectory lock{options.os, files.path(), 0700};
    lock.lock(kLockWait);
    return lock;
  }

  /// A trusted file; nothing where there is none, or none that can be read.
  std::optional<std::string> local(const std::string& role, std::uint64_t most) const {
    const std::string name = percent_encoded(role) + ".json";
    try {
      const auto file = marketplace::open_regular(files.descriptor(), name, files.path() / name);
      if (file) return marketplace::read_all(file, most, files.path() / name);
    } catch (const Error&) {
      if (role == kRoot) throw;  // the others are fetched again
    }
    return std::nullopt;
  }

  void keep(const std::string& role, const std::string& bytes) const {
    files.replace(percent_encoded(role) + ".json", bytes);
  }

  std::optional<std::string> fetch(const std::string& name, std::uint64_t most) const {
    std::string bytes;
    const auto append = [&bytes](std::string_view piece) { bytes += piece; };
    if (!options.transport->fetch(options.metadata, name, most, append)) return std::nullopt;
    return bytes;
  }

  std::string fetch_needed(const std::string& name, std::uint64_t most) const {
    if (auto bytes = fetch(name, most)) return std::move(*bytes);
    refuse(ErrorCode::NotFound, ErrorText{.what = "the repository has no " + name,
                                          .where = options.metadata,
                                          .next = "check the address; else tell the repository's keeper"});
  }

  /// VERSION.NAME where snapshots are consistent.
  std::string fetch_listed(std::string_view role, const Listed& listed, std::uint64_t most) const {
    const std::string name = percent_encoded(role) + ".json";
    const bool consistent = trusted->root().consistent_snapshot;
    return fetch_needed(consistent ? fmt::format("{}.{}", listed.version, name) : name, listed.length.value_or(most));
  }

  void update_root() {
    for (int i = 0; i < options.limits.root_updates; ++i) {
      const auto bytes = fetch(fmt::format("{}.root.json", trusted->root().version + 1), options.limits.root_bytes);
      if (!bytes) break;
      if (trusted->update_root(*bytes)) {
        // Before the new root is kept: killed in between, the next refresh comes here again. The other way round it
        // would not know of the change of keys.
        for (const auto role : {kTimestamp, kSnapshot}) files.remove_file(file_of(role));
        files.sync();
      }
      keep(std::string(kRoot), *bytes);
    }
    trusted->end_of_roots();
  }

  /// Takes what was seen last, so far as it is (still) properly signed.
  template <typename Remember>
  void remember(std::string_view role, std::uint64_t most, Remember&& take) const {
    try {
      if (const auto bytes = local(std::string(role), most)) take(*bytes);
    } catch (const Error&) {
      // Damaged, or signed by keys that are no longer the role's: as if it had never been seen.
    }
  }

  void update_timestamp() {
    const std::uint64_t most = options.limits.timestamp_bytes;
    remember(kTimestamp, most, [this](const auto& bytes) { trusted->remember_timestamp(bytes); });
    const std::string bytes = fetch_needed("timestamp.json", most);
    if (trusted->update_timestamp(bytes)) keep(std::string(kTimestamp), bytes);
  }

  void update_snapshot() {
    const std::uint64_t most = options.limits.snapshot_bytes;
    remember(kSnapshot, most, [this](const auto& bytes) { trusted->remember_snapshot(bytes); });
    if (trusted->snapshot_is_current()) return;
    const std::string bytes = fetch_listed(kSnapshot, trusted->timestamp()->snapshot, most);
    trusted->update_snapshot(bytes);
    keep(std::string(kSnapshot), bytes);
  }

  const Targets& role(const std::string& name, const std::string& delegator) {
    if (const Targets* known = trusted->targets(name, delegator)) return *known;
    const Listed listed = trusted->listed(name);
    const std::uint64_t most = options.limits.targets_bytes;
    if (const auto bytes = local(name, listed.length.value_or(most))) {
      try {
        return trusted->update_targets(*bytes, name, delegator);
      } catch (const Error&) {
        // It is of another version, has expired or is damaged.
      }
    }
    const std::string bytes = fetch_listed(name, listed, most);
    const Targets& updated = trusted->update_targets(bytes, name, delegator);
    keep(name, bytes);
    return updated;
  }

  /// 5.6.7: pre-order, depth first.
  std::optional<TargetInfo> search(const std::string& path) {
    struct Visit {
      std::string role, delegator;
    };
    std::vector<Visit> to_visit{{std::string(kTargets), std::string(kRoot)}};
    std::set<std::string> visited;
    while (!to_visit.empty() && static_cast<int>(visited.size()) < options.limits.roles_visited) {
      const Visit next = to_visit.back();
      to_visit.pop_back();
      if (!visited.insert(next.role).second) continue;
      const Targets& targets = role(next.role, next.delegator);
      if (const auto found = targets.targets.find(path); found != targets.targets.end()) {
        TargetInfo target = found->second;
        target.signer = next.delegator == kTargets ? next.role : std::string();
        return target;
      }
      std::vector<Visit> children;
      for (const Delegation& delegation : targets.delegations) {
        if (!delegation.covers(path)) continue;
        children.push_back({delegation.role, next.role});
        if (!delegation.terminating) continue;
        to_visit.clear();  // what comes after it, here and above, has no say
        break;
      }
      to_visit.insert(to_visit.end(), children.rbegin(), children.rend());
    }
    return std::nullopt;
  }

  ClientOptions options;
  marketplace::DurableDirectory files;
  std::optional<TrustedMetadata> trusted;
  bool refreshed = false;
};

Client::Client(ClientOptions options) : state_(std::make_unique<State>(std::move(options))) {}
Client::~Client() = default;

void Client::trust(const filesystem::path& trusted, std::string_view root) {
  parse_root(root, "root.json");
  const marketplace::OsCalls os = marketplace::system_calls();
  marketplace::DurableDirectory files{os, trusted, 0700};
  files.lock(kLockWait);
  files.replace(file_of(kRoot), root);
}

void Client::refresh() {
  State& state = *state_;
  const auto lock = state.locked();
  state.refreshed = false;
  state.start();
  state.update_root();
  state.update_timestamp();
  state.update_snapshot();
  state.role(std::string(kTargets), std::string(kRoot));
  state.refreshed = true;
}

TargetInfo Client::target(const std::string& path) {
  if (!state_->refreshed)
    refuse(ErrorCode::Failed,
           {.what = "nothing is known of targets before refresh() has succeeded", .next = "refresh() first"});
  const auto lock = state_->locked();
  if (auto found = state_->search(path)) return std::move(*found);
  refuse(ErrorCode::NotFound, ErrorText{.what = "nobody who may has signed for a target " + path,
                                        .where = state_->options.metadata,
                                        .next = "check its name; else ask its publisher"});
}

std::map<std::string, std::vector<std::string>> Client::signers() const {
  std::map<std::string, std::vector<std::string>> found;
  if (!state_->refreshed)
    refuse(ErrorCode::Failed,
           {.what = "nothing is known of roles before refresh() has succeeded", .next = "refresh() first"});
  const Targets& top = *state_->trusted->targets(std::string(kTargets), std::string(kRoot));
  for (const Delegation& delegation : top.delegations) {
    for (const auto& id : delegation.signers.key_ids) {
      const auto key = top.keys.find(id);
      const std::string open = key == top.keys.end() ? "" : key->second.open();
      found[delegation.role].push_back(open.empty() ? "id " + id : open);
    }
  }
  return found;
}

namespace {

void require_target(const TargetInfo& target, std::uint64_t length, const Hashes& found) {
  const auto differs = [&](const std::string& what, std::string expected, std::string instead) {
    refuse(ErrorCode::BadSignature, ErrorText{.what = "the target " + target.path +
                                                      " is not the one that was signed for: it has another " + what,
                                              .expected = std::move(expected),
                                              .found = std::move(instead),
                                              .next = "try again later or from another mirror; nothing was installed"});
  };
  if (length != target.length) {
    differs("length", fmt::format("{} bytes", target.length), fmt::format("{} bytes", length));
  }
  for (const auto& [algorithm, digest] : found) {
    if (digest != target.hashes.at(algorithm)) differs(algorithm, target.hashes.at(algorithm), digest);
  }
}

bool is_there(const marketplace::DurableDirectory& directory, const std::string& name, const TargetInfo& target) {
  try {
    const auto file = marketplace::open_regular(directory.descriptor(), name, directory.path() / name);
    if (!file || marketplace::size_of(file) != target.length) return false;
    Digests digests{target.hashes};
    std::array<char, 1 << 16> buffer;
    std::uint64_t length = 0;
    while (const std::size_t count = marketplace::read_some(file.number(), buffer.data(), buffer.size(), name)) {
      digests.update({buffer.data(), count});
      length += count;
    }
    require_target(target, length, digests.finish());
    return true;
  } catch (const Error&) {
    return false;
  }
}

}  // namespace

filesystem::path Client::download(const TargetInfo& target, const filesystem::path& directory) {
  const State& state = *state_;
  const std::string name = percent_encoded_file(target.path), fresh = name + ".new";
  marketplace::DurableDirectory files{state.options.os, directory, 0755};
  if (is_there(files, name, target)) return files.path() / name;
  files.lock(kLockWait);
  files.remove_file(fresh);
  try {
    Digests digests{target.hashes};
    std::uint64_t length = 0;
    const marketplace::FileDescriptor file = files.create(fresh, 0644);
    const auto write = [&](std::string_view piece) {
      digests.update(piece);
      length += piece.size();
      files.write(file, piece, fresh);
    };
    const std::string remote = remote_name(target, state.trusted->root().consistent_snapshot);
    if (!state.options.transport->fetch(state.options.targets, remote, target.length, write)) {
      refuse(ErrorCode::NotFound,
             ErrorText{.what = "the repository has signed for " + target.path + " and does not have it",
                       .where = state.options.targets,
                       .next = "try another mirror, or tell the repository's keeper"});
    }
    require_target(target, length, digests.finish());
    files.sync(file, fresh);
    files.move(fresh, files, name);
  } catch (...) {
    files.remove_tree_quietly(fresh);
    throw;
  }
  return files.path() / name;
}

}  // namespace fiona::tuf
