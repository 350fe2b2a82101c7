#include "role_file.hpp"

#include "digest.hpp"
#include "metadata.hpp"

namespace fiona::tuf {

Json key_json(const OpenKey& key) {
  return {{"keytype", "ed25519"}, {"scheme", "ed25519"}, {"keyval", {{"public", key}}}};
}

Json new_role(std::string_view type, Time expires) {
  return {{"_type", type}, {"spec_version", "1.0.31"}, {"version", 1}, {"expires", time_text(expires)}};
}

void raise_version(Json& role, Time expires) {
  role["version"] = role.at("version").get<std::int64_t>() + 1;
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
