// A root that changes keys: proposed, signed by each who has to, and then the root.
#include "repository_state.hpp"

#include <fcntl.h>
#include <fmt/format.h>

#include <algorithm>

#include "../files.hpp"
#include "refuse.hpp"
#include "role_file.hpp"

namespace fiona::tuf {
namespace {

namespace filesystem = std::filesystem;

}  // namespace

std::optional<std::string> Repository::State::proposal_file() const {
  const filesystem::path path = options.directory / kProposal;
  const auto file = marketplace::open_regular(AT_FDCWD, path, path);
  if (!file) return std::nullopt;
  return marketplace::read_all(file, Limits{}.root_bytes, path);
}

std::optional<Json> Repository::State::proposal() const {
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

void Repository::State::keep_proposal(const Json& body, const std::vector<SigningKey>& signers,
                                      const Json& others) const {
  Json file = parse_json(signed_role_file(body, signers), kProposal);
  for (const Json& one : others) file["signatures"].push_back(one);
  marketplace::DurableDirectory{os, options.directory, 0755}.replace(kProposal, file.dump(1) + "\n");
}

std::int64_t Repository::State::lacks(const Root& file, const Root& by) {
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

std::int64_t Repository::State::proposal_lacks(const std::string& file) const {
  const Root next = parse_root(file, kProposal);
  const Root now = parse_root(file_content_of(options.trusted / "root.json"), "root.json");
  return lacks(next, now) + lacks(next, next);
}

void Repository::State::turn_to_proposal() {
  const auto body = proposal();
  if (!body || proposal_lacks(*proposal_file()) > 0) return;
  former_root = std::exchange(root, *body);
  const std::string top{kTargets};
  if (former_root->at("roles").at(top) != root.at("roles").at(top)) changed.insert(top);
}

void Repository::State::publish_proposal() {
  if (!former_root) return;
  metadata.replace(versioned(root, kRoot), *proposal_file());
  marketplace::DurableDirectory{os, options.directory, 0755}.remove_file(kProposal);
  former_root.reset();
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

}  // namespace fiona::tuf
