#include "fiona/trust/tuf_repository.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "refuse.hpp"
#include "repository_state.hpp"
#include "role_file.hpp"
#include "trusted_metadata.hpp"

namespace fiona::tuf {

void Repository::create(const RepositoryOptions& options, const SigningKey& root_key, const SigningKey& targets_key,
                        const SigningKey& online_key) {
  const marketplace::DurableDirectory metadata{options.os, options.directory / "metadata", 0755};
  if (metadata.has("1.root.json")) {
    refuse(ErrorCode::NotAllowed, ErrorText{.what = "there is a marketplace here already",
                                            .where = options.directory.string(),
                                            .next = "choose another directory"});
  }
  const Time now = clock_of(options);
  Json root = new_role(kRoot, now + options.lifetimes.root);
  root["consistent_snapshot"] = true;
  const auto add = [&root](std::string_view role, const SigningKey& key) {
    root["keys"][key_id_of(key.open())] = key_json(key.open());
    root["roles"][std::string(role)] = {{"keyids", {key_id_of(key.open())}}, {"threshold", 1}};
  };
  add(kRoot, root_key);
  add(kTargets, targets_key);
  add(kSnapshot, online_key);
  add(kTimestamp, online_key);
  Json targets = new_role(kTargets, now + options.lifetimes.targets);
  targets["targets"] = Json::object();
  targets["delegations"] = {{"keys", Json::object()}, {"roles", Json::array()}};
  const std::string targets_file = signed_role_file(targets, {targets_key});
  Json snapshot = new_role(kSnapshot, now + options.lifetimes.online);
  snapshot["meta"]["targets.json"] = listed_as(targets, targets_file);
  const std::string snapshot_file = signed_role_file(snapshot, {online_key});
  Json timestamp = new_role(kTimestamp, now + options.lifetimes.online);
  timestamp["meta"]["snapshot.json"] = listed_as(snapshot, snapshot_file);
  const std::string root_file = signed_role_file(root, {root_key});
  metadata.replace("1.targets.json", targets_file);
  metadata.replace("1.snapshot.json", snapshot_file);
  metadata.replace("timestamp.json", signed_role_file(timestamp, {online_key}));
  metadata.replace("1.root.json", root_file);
  Client::trust(options.trusted, root_file);
}

Repository::Repository(const RepositoryOptions& options, const SigningKeys& keys)
    : state_(std::make_unique<State>(options, keys)) {}
Repository::~Repository() = default;

bool Repository::may_commit() const {
  return state_->has_keys_of(std::string(kSnapshot)) && state_->has_keys_of(std::string(kTimestamp));
}

std::string Repository::root() const { return file_content_of(state_->options.trusted / "root.json"); }

std::vector<std::string> Repository::key_ids_of(const std::string& role) const {
  const Delegation* found = state_->delegation(role);
  if (!found) return {};
  return {found->signers.key_ids.begin(), found->signers.key_ids.end()};
}

std::vector<std::string> Repository::delegated_roles() const {
  std::vector<std::string> roles;
  for (const auto& delegation : state_->parsed_targets.delegations) roles.push_back(delegation.role);
  return roles;
}

std::int64_t Repository::version_of(const std::string& role) const { return state_->version(role); }

std::vector<TargetInfo> Repository::targets_of(const std::string& role) const {
  std::vector<TargetInfo> found;
  if (!state_->delegation(role) || state_->version(role) == 0) return found;
  for (const auto& [path, target] : state_->delegated(role).targets) found.push_back(target);
  return found;
}

void Repository::delegate(const std::string& role, const std::vector<OpenKey>& keys,
                          const std::vector<std::string>& paths) {
  const std::string top{kTargets};
  Json& delegations = state_->roles.at(top)["delegations"];
  Json& roles = delegations["roles"];
  Json ids = Json::array();
  for (const OpenKey& key : keys) ids.push_back(key_id_of(key));
  const Json entry{{"name", role}, {"keyids", ids}, {"threshold", 1}, {"paths", paths}, {"terminating", true}};
  const auto known = std::find_if(roles.begin(), roles.end(), [&](const Json& one) { return one.at("name") == role; });
  known == roles.end() ? roles.push_back(entry) : void(*known = entry);
  for (const OpenKey& key : keys) delegations["keys"][key_id_of(key)] = key_json(key);
  drop_unused_keys(delegations["keys"], roles);
  state_->changed.insert(top);
}

void Repository::undelegate(const std::string& role) {
  const std::string top{kTargets};
  Json& delegations = state_->roles.at(top)["delegations"];
  Json kept = Json::array();
  for (const Json& one : delegations["roles"]) {
    if (one.at("name") != role) kept.push_back(one);
  }
  delegations["roles"] = kept;
  drop_unused_keys(delegations["keys"], kept);
  state_->changed.insert(top);
  state_->changed.erase(role);
}

void Repository::take_role(const std::string& role, std::string_view file) {
  const Targets taken = parse_targets(file, file_of(role));
  Signers signers;
  Keys keys;
  const Json entry = state_->signers_of(role);
  for (const Json& id : entry.at("keyids")) {
    const auto name = id.get<std::string>();
    signers.key_ids.insert(name);
    keys.emplace(
        name, PublicKey(state_->roles.at(std::string(kTargets)).at("delegations").at("keys").at(name), "targets.json"));
  }
  signers.threshold = entry.at("threshold").get<std::int64_t>();
  require_signatures(taken, signers, keys, fmt::format("the role '{}'", role));
  if (taken.version <= state_->version(role)) {
    refuse(ErrorCode::BadSignature,
           ErrorText{.what = fmt::format("{} is not newer than the one that is here", file_of(role)),
                     .expected = fmt::format("version {} or newer", state_->version(role) + 1),
                     .found = fmt::format("version {}", taken.version),
                     .next = "sign it again where its newest version is kept"});
  }
  if (taken.expires <= clock_of(state_->options)) {
    refuse(ErrorCode::BadSignature, ErrorText{.what = file_of(role) + " has expired",
                                              .found = "valid until " + time_text(taken.expires),
                                              .next = "sign it again: fiona plugin sign FILE"});
  }
  state_->taken[role] = file;
}

void Repository::set_target(const std::string& role, const std::string& path, std::uint64_t length,
                            const std::string& sha256) {
  state_->body(role)["targets"][path] = described(length, sha256);
  state_->changed.insert(role);
}

Repository::RoleKeys Repository::keys_of(const std::string& role) const {
  const Json& owner = is_top_level(role) ? state_->root : state_->roles.at(std::string(kTargets)).at("delegations");
  return role_keys(state_->signers_of(role), owner.at("keys"));
}

std::string Repository::expires(const std::string& role) const {
  const State& state = *state_;
  if (!is_top_level(role)) return state.version(role) == 0 ? "" : time_text(state.delegated(role).expires);
  const Json& body = role == kRoot        ? state.root
                     : role == kTimestamp ? state.timestamp
                     : role == kSnapshot  ? state.snapshot
                                          : state.roles.at(std::string(kTargets));
  return body.at("expires").get<std::string>();
}

void Repository::commit() {
  State& state = *state_;
  state.turn_to_proposal();
  state.renew_what_ages();
  for (const auto& role : state.changed) state.sign(role);
  for (const auto& [role, file] : state.taken) state.list(role, role_in(file), file);
  const Time until = clock_of(state.options) + state.options.lifetimes.online;
  raise_version(state.snapshot, until);
  const std::string snapshot = signed_role_file(state.snapshot, state.signing_keys(std::string(kSnapshot)));
  state.metadata.replace(versioned(state.snapshot, kSnapshot), snapshot);
  raise_version(state.timestamp, until);
  state.timestamp["meta"]["snapshot.json"] = listed_as(state.snapshot, snapshot);
  state.metadata.replace("timestamp.json",
                         signed_role_file(state.timestamp, state.signing_keys(std::string(kTimestamp))));
  state.publish_proposal();
  state.remove_old_versions();
  state.changed.clear();
  state.taken.clear();
  state.roles.clear();
  state.look();
}

}  // namespace fiona::tuf
