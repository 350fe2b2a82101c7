#include "repository_state.hpp"

#include <fcntl.h>
#include <fmt/format.h>

#include <algorithm>

#include "../files.hpp"
#include "refuse.hpp"
#include "role_file.hpp"
#include "trusted_metadata.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

constexpr std::chrono::milliseconds kRepositoryLock{10'000};
constexpr int kVersionsKept = 3;  // of each role but root: who reads while we write still finds his

}  // namespace

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
  if (!file)
    refuse(ErrorCode::NotFound, ErrorText{.what = "there is no such file",
                                          .where = path.string(),
                                          .next = "see what is there: ls " + path.parent_path().string()});
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

Repository::State::State(const RepositoryOptions& chosen, const SigningKeys& signing)
    : options(chosen), keys(signing), os(chosen.os), metadata(os, chosen.directory / "metadata", 0755) {
  metadata.lock(kRepositoryLock);
  look();
}

void Repository::State::look() {
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

const Delegation* Repository::State::delegation(const std::string& role) const {
  const auto found = std::ranges::find(parsed_targets.delegations, role, &Delegation::role);
  return found == parsed_targets.delegations.end() ? nullptr : &*found;
}

Targets Repository::State::delegated(const std::string& role) const {
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

Json& Repository::State::body(const std::string& role) {
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

std::int64_t Repository::State::version(const std::string& role) const {
  const auto found = snapshot.at("meta").find(file_of(role));
  return found == snapshot.at("meta").end() ? 0 : found->at("version").get<std::int64_t>();
}

Json Repository::State::signers_of(const std::string& role) const {
  if (is_top_level(role)) return root.at("roles").at(role);
  for (const Json& one : roles.at(std::string(kTargets)).at("delegations").at("roles")) {
    if (one.at("name") == role) return one;
  }
  return {{"keyids", Json::array()}, {"threshold", 1}};
}

std::vector<SigningKey> Repository::State::keys_here(const std::string& role, bool& enough) const {
  const Json signers = signers_of(role);
  std::vector<SigningKey> found;
  for (const Json& id : signers.at("keyids")) {
    if (const auto key = keys.with_id(id.get<std::string>())) found.push_back(*key);
  }
  enough = static_cast<std::int64_t>(found.size()) >= signers.at("threshold").get<std::int64_t>();
  return found;
}

std::vector<SigningKey> Repository::State::keys_of(const std::string& role) const {
  bool enough = false;
  auto found = keys_here(role, enough);
  if (enough) return found;
  keys.require_readable();
  refuse(ErrorCode::NotAllowed, ErrorText{.what = "this user has not the keys of the role '" + role + "'",
                                          .where = keys.path().string(),
                                          .expected = "the keys " + signers_of(role).at("keyids").dump(),
                                          .next = "let who has them do this"});
}

bool Repository::State::has_keys_of(const std::string& role) const {
  bool enough = false;
  keys_here(role, enough);
  return enough;
}

bool Repository::State::is_half_over(const Json& role, std::chrono::days lifetime) const {
  return parse_time(role.at("expires").get<std::string>(), "metadata") < clock_of(options) + lifetime / 2;
}

std::vector<SigningKey> Repository::State::signing_keys(const std::string& role) const {
  std::vector<SigningKey> found = keys_of(role);
  if (!former_root || !is_top_level(role)) return found;
  for (const Json& id : former_root->at("roles").at(role).at("keyids")) {
    const auto is_same = [&id](const SigningKey& key) { return key_id_of(key.open()) == id; };
    const auto key = keys.with_id(id.get<std::string>());
    if (key && std::ranges::none_of(found, is_same)) found.push_back(*key);
  }
  return found;
}

void Repository::State::sign(const std::string& role) {
  Json& signed_part = roles.at(role);
  raise_version(signed_part, clock_of(options) + options.lifetimes.targets);
  list(role, signed_part, signed_role_file(signed_part, signing_keys(role)));
}

void Repository::State::list(const std::string& role, const Json& signed_part, const std::string& file) {
  metadata.replace(versioned(signed_part, role), file);
  snapshot["meta"][file_of(role)] = listed_as(signed_part, file);
}

void Repository::State::renew_what_ages() {
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

void Repository::State::remove_old_versions() const {
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

}  // namespace fiona::tuf
