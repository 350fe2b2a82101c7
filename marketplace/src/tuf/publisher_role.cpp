// The file in which a publisher signs for what is his.
#include <algorithm>

#include "fiona/trust/tuf_repository.hpp"
#include "json.hpp"
#include "metadata.hpp"
#include "refuse.hpp"
#include "role_file.hpp"
#include "trusted_metadata.hpp"

namespace fiona::tuf {
namespace {

constexpr const char* kKeyMember = "x-fiona-key";

}  // namespace

RoleContent read_role(std::string_view file, const OpenKey& key, const std::string& shown) {
  const Targets role = parse_targets(file, shown);
  const std::string id = key_id_of(key);
  require_signatures(role, {{id}, 1}, Keys{{id, PublicKey(key_json(key), shown)}}, "the key " + key);
  RoleContent content{role.version, role.expires, {}};
  for (const auto& [path, target] : role.targets) {
    if (!target.hashes.contains("sha256"))
      refuse(ErrorCode::BadSignature, ErrorText{.what = shown + " signs for " + path + " without its sha256",
                                                .next = "its publisher is to sign with fiona plugin sign"});
    content.targets.push_back(target);
  }
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
                      const std::vector<TargetInfo>& targets, bool only, Time expires, std::int64_t version) {
  Json role = before ? role_in(*before) : new_role(kTargets, expires);
  if (before) raise_version(role, expires);
  role["version"] = std::max(version, role.at("version").get<std::int64_t>());
  role[kKeyMember] = key.open();
  if (only || !role.contains("targets")) role["targets"] = Json::object();
  for (const auto& target : targets) {
    role["targets"][target.path] = described(target.length, target.hashes.at("sha256"));
  }
  return signed_role_file(role, {key});
}

}  // namespace fiona::tuf
