#include "role_file.hpp"

#include <limits>

#include "digest.hpp"
#include "metadata.hpp"
#include "refuse.hpp"

namespace fiona::tuf {

Json key_json(const OpenKey& key) {
  return {{"keytype", "ed25519"}, {"scheme", "ed25519"}, {"keyval", {{"public", key}}}};
}

Json new_role(std::string_view type, Time expires) {
  return {{"_type", type}, {"spec_version", "1.0.31"}, {"version", 1}, {"expires", time_text(expires)}};
}

std::int64_t version_after(std::int64_t version) {
  if (version < std::numeric_limits<std::int64_t>::max()) return version + 1;
  refuse(ErrorCode::Failed,
         ErrorText{.what = "no version follows the one that was signed last: it is the last that there is",
                   .next = "go on under another name: fiona keys new NAME"});
}

void raise_version(Json& role, Time expires) {
  role["version"] = version_after(role.at("version").get<std::int64_t>());
  role["expires"] = time_text(expires);
}

std::string signed_role_file(const Json& role, const std::vector<SigningKey>& keys) {
  const std::string bytes = canonical(role);
  Json signatures = Json::array();
  for (const SigningKey& key : keys) {
    signatures.push_back({{"keyid", key_id_of(key.open())}, {"sig", to_hex(key.sign(bytes))}});
  }
  return Json{{"signatures", signatures}, {"signed", role}}.dump(1) + "\n";
}

Json role_in(std::string_view file) { return parse_json(file, "metadata").at("signed"); }

Json described(std::uint64_t length, const std::string& sha256) {
  return {{"length", length}, {"hashes", {{"sha256", sha256}}}};
}

Json described(std::string_view bytes) { return described(bytes.size(), sha256_hex(bytes)); }

}  // namespace fiona::tuf
