#include "fiona/trust/tuf_repository.hpp"

#include <fcntl.h>
#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "../durable.hpp"
#include "../files.hpp"
#include "metadata.hpp"
#include "refuse.hpp"
#include "role_file.hpp"
#include "trusted_metadata.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

constexpr std::chrono::milliseconds kRepositoryLock{10'000};
constexpr int kVersionsKept = 3;  // of each role but root: who reads while we write still finds his
constexpr const char* kKeyMember = "x-fiona-key";
constexpr const char* kProposal = "root.proposed.json";  // beside the metadata: it is none yet

Time clock_of(const RepositoryOptions& options) {
  return options.now ? options.now() : std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
}

std::string versioned(const Json& role, std::string_view name) {
  return fmt::format("{}.{}.json", role.at("version").get<std::int64_t>(), percent_encoded(name));
}

Json listed_as(const Json& role, std::string_view file) {
  Json entry = described(file);
  entry["version"] = role.at("version");
  return entry;
}

std::string file_content_of(const filesystem::path& path) {
  const auto file = marketplace::open_regular(AT_FDCWD, path, path);
  if (!file) refuse(ErrorCode::NotFound, ErrorText{.what = "there is no such file", .where = path.string()});
  return marketplace::read_all(file, Limits{}.targets_bytes, path);
}

Repository::RoleKeys role_keys(const Json& role, const Json& keys) {
  Repository::RoleKeys found{{}, role.at("threshold").get<std::int64_t>()};
  for (const Json& id : role.at("keyids")) {
    const std::string name = id.get<std::string>();
    const std::string open = keys.contains(name) ? PublicKey(keys.at(name), "metadata").open() : "";
    found.keys.push_back(open.empty() ? "id " + name : open);
  }
  return found;
}

void drop_unused_keys(Json& keys, const Json& roles) {
  std::set<std::string> used;
  for (const Json& one : roles) used.insert(one.at("keyids").begin(), one.at("keyids").end());
  for (auto item = keys.begin(); item != keys.end();) {
    item = used.contains(item.key()) ? std::next(item) : keys.erase(item);
  }
}

}  // namespace

struct Repository::State {
  State(const RepositoryOptions& chosen, const SigningKeys& signing)
      : options(chosen), keys(signing), os(chosen.os), metadata(os, chosen.directory / "metadata", 0755) {
    metadata.lock(kRepositoryLock);
    look();
  }

  /// What a client that minds no expiry finds.
  void look() {
    ClientOptions as_client{.trusted = options.trusted, .metadata = (options.directory / "metadata").string()};
    as_client.now = [] { return Time{}; };
    Client client{as_client};
    client.refresh();
    root = role_in(file_content_of(options.trusted / "root.json"));
    timestamp = role_in(file_content_of(options.trusted / "timestamp.json"));
    snapshot = role_in(file_content_of(options.trusted / "snapshot.json"));
    parsed_targets = parse_targets(file_content_of(options.trusted / "targets.json"), "targets.json");
    roles[std::string(kTargets)] = role_in(file_content_of(options.trusted / "targets.json"));
  }

  const Delegation* delegation(const std::string& role) const {
    const auto found = std::ranges::find(parsed_targets.delegations, role, &Delegation::role);
    return found == parsed_targets.delegations.end() ? nullptr : &*found;
  }

  /// A delegated role's verified content.
  Targets delegated(const std::string& role) const {
    const Json& entry = snapshot.at("meta").at(file_of(role));
    const std::string name = fmt::format("{}.{}.json", entry.at("version").get<std::int64_t>(), percent_encoded(role));
    const std::string bytes = file_content_of(options.directory / "metadata" / name);
    Listed listed;
    listed.version = entry.at("version").get<std::int64_t>();
    listed.hashes["sha256"] = entry.at("hashes").at("sha256").get<std::string>();
    require_listed(bytes, listed, name, "snapshot.json");
    Targets found = parse_targets(bytes, name);
    require_signatures(found, delegation(role)->signers, parsed_targets.keys, fmt::format("the role '{}'", role));
    return found;
  }

  /// A role whose body is to be changed here.
  Json& body(const std::string& role) {
    const auto known = roles.find(role);
    if (known != roles.end()) return known->second;
    if (snapshot.at("meta").contains(file_of(role))) {
      delegated(role);  // verified
      const std::string name = fmt::format("{}.{}.json", version(role), percent_encoded(role));
      return roles[role] = role_in(file_content_of(options.directory / "metadata" / name));
    }
    Json fresh = new_role(kTargets, Time{});
    fresh["version"] = 0;  // raised when it is signed
    fresh["targets"] = Json::object();
    return roles[role] = fresh;
  }

  std::int64_t version(const std::string& role) const {
    const auto found = snapshot.at("meta").find(file_of(role));
    return found == snapshot.at("meta").end() ? 0 : found->at("version").get<std::int64_t>();
  }

  Json signers_of(const std::string& role) const {
    if (is_top_level(role)) return root.at("roles").at(role);
    for (const Json& one : roles.at(std::string(kTargets)).at("delegations").at("roles")) {
      if (one.at("name") == role) return one;
    }
    return {{"keyids", Json::array()}, {"threshold", 1}};
  }

  /// Those of the role's keys that are here; `enough`: as many as it needs.
  std::vector<SigningKey> keys_here(const std::string& role, bool& enough) const {
    const Json signers = signers_of(role);
    std::vector<SigningKey> found;
    for (const Json& id : signers.at("keyids")) {
      if (const auto key = keys.with_id(id.get<std::string>())) found.push_back(*key);
    }
    enough = static_cast<std::int64_t>(found.size()) >= signers.at("threshold").get<std::int64_t>();
    return found;
  }

  std::vector<SigningKey> keys_of(const std::string& role) const {
    bool enough = false;
    auto found = keys_here(role, enough);
    if (enough) return found;
    refuse(ErrorCode::NotAllowed, ErrorText{.what = "this user has not the keys of the role '" + role + "'",
                                            .where = keys.path().string(),
                                            .expected = "the keys " + signers_of(role).at("keyids").dump(),
                                            .next = "let who has them do this"});
  }

  bool has_keys_of(const std::string& role) const {
    bool enough = false;
    keys_here(role, enough);
    return enough;
  }

  bool is_half_over(const Json& role, std::chrono::days lifetime) const {
    return parse_time(role.at("expires").get<std::string>(), "metadata") < clock_of(options) + lifetime / 2;
  }

  /// Those that a file is to be signed with: of the root to come and, so that it is good under both, of the root of
  /// now.
  std::vector<SigningKey> signing_keys(const std::string& role) const {
    std::vector<SigningKey> found = keys_of(role);
    if (!former_root || !is_top_level(role)) return found;
    for (const Json& id : former_root->at("roles").at(role).at("keyids")) {
      const auto is_same = [&id](const SigningKey& key) { return key_id_of(key.open()) == id; };
      const auto key = keys.with_id(id.get<std::string>());
      if (key && std::ranges::none_of(found, is_same)) found.push_back(*key);
    }
    return found;
  }

  /// Signs the next version, and lets the snapshot list it.
  void sign(const std::string& role) {
    Json& signed_part = roles.at(role);
    raise_version(signed_part, clock_of(options) + options.lifetimes.targets);
    list(role, signed_part, signed_role_file(signed_part, signing_keys(role)));
  }

  std::optional<std::string> proposal_file() const {
    const filesystem::path path = options.directory / kProposal;
    const auto file = marketplace::open_regular(AT_FDCWD, path, path);
    if (!file) return std::nullopt;
    return marketplace::read_all(file, Limits{}.root_bytes, path);
  }

  /// The body of the next root that was proposed, if it is the one after the root of now.
  std::optional<Json> proposal() const {
    const auto file = proposal_file();
    if (!file) return std::nullopt;
    parse_root(*file, kProposal);
    Json body = role_in(*file);
    if (body.at("version") != root.at("version").get<std::int64_t>() + 1) return std::nullopt;  // of another time
    Json expected = root;
    for (const char* member : {"version", "expires", "keys"}) expected[member] = body.at(member);
    for (auto& role : expected["roles"].items()) role.value() = body.at("roles").value(role.key(), Json());
    const Time latest = clock_of(options) + options.lifetimes.root + std::chrono::days{1};
    if (body == expected && parse_time(body.at("expires").get<std::string>(), kProposal) <= latest) return body;
    refuse(ErrorCode::BadSignature,
           ErrorText{.what = "the root that is proposed changes more than keys",
                     .where = (options.directory / kProposal).string(),
                     .next = "find out who has proposed it; fiona market rotate takes its place"});
  }

  void keep_proposal(const Json& body, const std::vector<SigningKey>& signers, const Json& others) const {
    Json file = parse_json(signed_role_file(body, signers), kProposal);
    for (const Json& one : others) file["signatures"].push_back(one);
    marketplace::DurableDirectory{os, options.directory, 0755}.replace(kProposal, file.dump(1) + "\n");
  }

  /// How many signatures of a role's keys a root still lacks.
  static std::int64_t lacks(const Root& file, const Root& by) {
    const Signers& signers = by.signers(kRoot);
    std::int64_t count = 0;
    for (const auto& id : signers.key_ids) {
      const auto key = by.keys.find(id);
      const bool has_signed = key != by.keys.end() && std::ranges::any_of(file.signatures, [&](const Signature& one) {
                                return one.key_id == id && key->second.verifies(file.signed_bytes, one.bytes);
                              });
      count += has_signed ? 1 : 0;
    }
    return std::max<std::int64_t>(0, signers.threshold - count);
  }

  std::int64_t proposal_lacks(const std::string& file) const {
    const Root next = parse_root(file, kProposal);
    const Root now = parse_root(file_content_of(options.trusted / "root.json"), "root.json");
    return lacks(next, now) + lacks(next, next);
  }

  /// From here on everything is signed for the root that was proposed, if it has all its signatures.
  void turn_to_proposal() {
    const auto body = proposal();
    if (!body || proposal_lacks(*proposal_file()) > 0) return;
    former_root = std::exchange(root, *body);
    const std::string top{kTargets};
    if (former_root->at("roles").at(top) != root.at("roles").at(top)) changed.insert(top);
  }

  /// Last of all: what was signed for both is good until then and from then on.
  void publish_proposal() {
    if (!former_root) return;
    metadata.replace(versioned(root, kRoot), *proposal_file());
    marketplace::DurableDirectory{os, options.directory, 0755}.remove_file(kProposal);
    former_root.reset();
  }

  void list(const std::string& role, const Json& signed_part, const std::string& file) {
    metadata.replace(versioned(signed_part, role), file);
    snapshot["meta"][file_of(role)] = listed_as(signed_part, file);
  }

  void renew_what_ages() {
    const std::string top{kTargets};
    if (is_half_over(roles.at(top), options.lifetimes.targets) && has_keys_of(top)) changed.insert(top);
    for (const auto& delegation : parsed_targets.delegations) {
      if (changed.contains(delegation.role) || !snapshot["meta"].contains(file_of(delegation.role))) continue;
      if (signers_of(delegation.role).at("keyids").empty()) continue;  // it is no role any more
      if (!has_keys_of(delegation.role) || !is_half_over(body(delegation.role), options.lifetimes.targets)) continue;
      changed.insert(delegation.role);
    }
    if (former_root || !is_half_over(root, options.lifetimes.root) || !has_keys_of(std::string(kRoot))) return;
    raise_version(root, clock_of(options) + options.lifetimes.root);
    metadata.replace(versioned(root, kRoot), signed_role_file(root, keys_of(std::string(kRoot))));
  }

  /// Old versions, so that a repository does not grow with each commit. Roots stay: clients follow them one by one.
  void remove_old_versions() const {
    for (const auto& name : metadata.names()) {
      const std::size_t dot = name.find('.');
      if (dot == std::string::npos || dot == 0 || name.find_first_not_of("0123456789") != dot || dot > 18) continue;
      const std::string role = name.substr(dot + 1);
      const std::int64_t number = std::stoll(name.substr(0, dot));
      const auto listed = snapshot.at("meta").find(role);
      const std::int64_t now = role == "snapshot.json"               ? snapshot.at("version").get<std::int64_t>()
                               : listed == snapshot.at("meta").end() ? 0
                                                                     : listed->at("version").get<std::int64_t>();
      if (number <= now - kVersionsKept) metadata.remove_file(name);
    }
  }

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
  const Json& body = role == kRoot        ? state.root
                     : role == kTimestamp ? state.timestamp
                     : role == kSnapshot  ? state.snapshot
                                          : state.roles.at(std::string(kTargets));
  return body.at("expires").get<std::string>();
}

void Repository::propose(const std::vector<std::string>& roles, const RoleKeys& keys) {
  const std::set<OpenKey> different{keys.keys.begin(), keys.keys.end()};
  if (keys.threshold < 1 || keys.threshold > static_cast<std::int64_t>(different.size())) {
    refuse(ErrorCode::Usage, ErrorText{.what = "so many keys cannot sign for the role '" + roles.front() + "'",
                                       .expected = fmt::format("a threshold of 1 to {}", different.size()),
                                       .found = std::to_string(keys.threshold)});
  }
  State& state = *state_;
  Json next = state.root;
  raise_version(next, clock_of(state.options) + state.options.lifetimes.root);
  Json ids = Json::array();
  for (const OpenKey& key : different) {
    ids.push_back(key_id_of(key));
    next["keys"][key_id_of(key)] = key_json(key);
  }
  for (const auto& role : roles) next["roles"][role] = {{"keyids", ids}, {"threshold", keys.threshold}};
  Json all = Json::array();
  for (const Json& one : next["roles"]) all.push_back(one);
  drop_unused_keys(next["keys"], all);
  state.keep_proposal(next, {}, Json::array());
}

std::optional<std::int64_t> Repository::proposal_lacks() const {
  if (!state_->proposal()) return std::nullopt;
  return state_->proposal_lacks(*state_->proposal_file());
}

std::optional<Repository::RoleKeys> Repository::proposed(const std::string& role) const {
  const auto next = state_->proposal();
  if (!next) return std::nullopt;
  return role_keys(next->at("roles").at(role), next->at("keys"));
}

void Repository::sign_proposed() const {
  const State& state = *state_;
  const auto next = state.proposal();
  if (!next) {
    refuse(ErrorCode::NotFound, ErrorText{.what = "no next root is proposed",
                                          .where = (state.options.directory / kProposal).string(),
                                          .next = "fiona market rotate DIR ROLE proposes one"});
  }
  std::set<std::string> wanted;
  for (const Json* root : {&state.root, &*next}) {
    for (const Json& id : root->at("roles").at(std::string(kRoot)).at("keyids")) wanted.insert(id.get<std::string>());
  }
  std::vector<SigningKey> own;
  for (const auto& id : wanted) {
    if (const auto key = state.keys.with_id(id)) own.push_back(*key);
  }
  const Json file = parse_json(*state.proposal_file(), kProposal);
  Json others = Json::array();
  for (const Json& one : file.at("signatures")) {
    const auto is_same = [&one](const SigningKey& key) { return key_id_of(key.open()) == one.at("keyid"); };
    if (std::ranges::none_of(own, is_same)) others.push_back(one);
  }
  state.keep_proposal(*next, own, others);
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

RoleContent read_role(std::string_view file, const OpenKey& key, const std::string& shown) {
  const Targets role = parse_targets(file, shown);
  const std::string id = key_id_of(key);
  require_signatures(role, {{id}, 1}, Keys{{id, PublicKey(key_json(key), shown)}}, "the key " + key);
  RoleContent content{role.version, role.expires, {}};
  for (const auto& [path, target] : role.targets) content.targets.push_back(target);
  return content;
}

std::optional<OpenKey> claimed_key(std::string_view file, const std::string& shown) {
  parse_targets(file, shown);
  const Json role = role_in(file);
  const auto found = role.find(kKeyMember);
  if (found == role.end() || !found->is_string() || from_hex(found->get<std::string>()).size() != 32)
    return std::nullopt;
  return to_hex(from_hex(found->get<std::string>()));
}

std::string next_role(const std::optional<std::string>& before, const SigningKey& key,
                      const std::vector<TargetInfo>& targets, bool only, Time expires) {
  Json role = before ? role_in(*before) : new_role(kTargets, expires);
  if (before) raise_version(role, expires);
  role[kKeyMember] = key.open();
  if (only || !role.contains("targets")) role["targets"] = Json::object();
  for (const auto& target : targets) {
    role["targets"][target.path] = described(target.length, target.hashes.at("sha256"));
  }
  return signed_role_file(role, {key});
}

}  // namespace fiona::tuf
