#include "tuf_simulator.hpp"

#include <openssl/ec.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/rsa.h>
#include <openssl/sha.h>
#include <sodium/crypto_sign.h>

#include <fiona/error.hpp>
#include <sstream>

#include "tuf/locations.hpp"

namespace fiona::tuf::testing {
namespace {

std::string hex(std::string_view bytes) {
  std::ostringstream text;
  for (const char byte : bytes) {
    text << "0123456789abcdef"[static_cast<unsigned char>(byte) / 16] << "0123456789abcdef"[byte & 15];
  }
  return text.str();
}

TestKey with_id(Json open, std::function<std::string(std::string_view)> sign) {
  const std::string id = sha256_text(canonical_text(open));
  return {std::move(open), id, std::move(sign)};
}

std::string pem_of(EVP_PKEY* key) {
  const std::unique_ptr<BIO, int (*)(BIO*)> memory{BIO_new(BIO_s_mem()), BIO_free};
  PEM_write_bio_PUBKEY(memory.get(), key);
  char* text = nullptr;
  const long size = BIO_get_mem_data(memory.get(), &text);
  return {text, static_cast<std::size_t>(size)};
}

std::function<std::string(std::string_view)> openssl_signer(EVP_PKEY* made, bool pss) {
  const std::shared_ptr<EVP_PKEY> key{made, EVP_PKEY_free};
  return [key, pss](std::string_view message) {
    const std::unique_ptr<EVP_MD_CTX, void (*)(EVP_MD_CTX*)> context{EVP_MD_CTX_new(), EVP_MD_CTX_free};
    EVP_PKEY_CTX* options = nullptr;
    EVP_DigestSignInit(context.get(), &options, EVP_sha256(), nullptr, key.get());
    if (pss) EVP_PKEY_CTX_set_rsa_padding(options, RSA_PKCS1_PSS_PADDING);
    std::size_t size = 0;
    const auto* bytes = reinterpret_cast<const unsigned char*>(message.data());
    EVP_DigestSign(context.get(), nullptr, &size, bytes, message.size());
    std::string signature(size, '\0');
    EVP_DigestSign(context.get(), reinterpret_cast<unsigned char*>(signature.data()), &size, bytes, message.size());
    signature.resize(size);
    return signature;
  };
}

const std::vector<std::string> kTopLevel{"root", "timestamp", "snapshot", "targets"};

}  // namespace

TestKey ed25519_key() {
  unsigned char open[crypto_sign_PUBLICKEYBYTES];
  std::string secret(crypto_sign_SECRETKEYBYTES, '\0');
  crypto_sign_keypair(open, reinterpret_cast<unsigned char*>(secret.data()));
  const auto sign = [secret](std::string_view message) {
    std::string signature(crypto_sign_BYTES, '\0');
    crypto_sign_detached(reinterpret_cast<unsigned char*>(signature.data()), nullptr,
                         reinterpret_cast<const unsigned char*>(message.data()), message.size(),
                         reinterpret_cast<const unsigned char*>(secret.data()));
    return signature;
  };
  const std::string text = hex({reinterpret_cast<const char*>(open), sizeof open});
  return with_id({{"keytype", "ed25519"}, {"scheme", "ed25519"}, {"keyval", {{"public", text}}}}, sign);
}

TestKey ecdsa_key(const std::string& keytype, const char* curve) {
  EVP_PKEY* key = EVP_EC_gen(curve);
  return with_id({{"keytype", keytype}, {"scheme", "ecdsa-sha2-nistp256"}, {"keyval", {{"public", pem_of(key)}}}},
                 openssl_signer(key, false));
}

TestKey rsa_key(const std::string& scheme, unsigned bits) {
  EVP_PKEY* key = EVP_RSA_gen(bits);
  return with_id({{"keytype", "rsa"}, {"scheme", scheme}, {"keyval", {{"public", pem_of(key)}}}},
                 openssl_signer(key, scheme == "rsassa-pss-sha256"));
}

std::string canonical_text(const Json& value) {
  std::string text = value.dump();
  for (std::size_t at = 0; (at = text.find("\\n", at)) != std::string::npos;) text.replace(at, 2, "\n");
  return text;
}

std::string sha256_text(std::string_view bytes) {
  unsigned char digest[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), digest);
  return hex({reinterpret_cast<const char*>(digest), sizeof digest});
}

std::string signed_file(const Json& body, const std::vector<TestKey>& keys) {
  Json signatures = Json::array();
  for (const auto& key : keys) signatures.push_back({{"keyid", key.id}, {"sig", hex(key.sign(canonical_text(body)))}});
  return Json{{"signatures", signatures}, {"signed", body}}.dump(1);
}

Time Simulator::start() { return std::chrono::sys_days{std::chrono::year{2030} / 1 / 1}; }

Simulator::Simulator() {
  const auto body = [](const std::string& type) {
    return Json{{"_type", type}, {"spec_version", "1.0.31"}, {"version", 1}, {"expires", "2030-01-31T00:00:00Z"}};
  };
  root = body("root");
  root["consistent_snapshot"] = true;
  root["keys"] = Json::object();
  for (const auto& role : kTopLevel) set_keys(role, {ed25519_key()});
  timestamp = body("timestamp");
  snapshot = body("snapshot");
  targets["targets"] = body("targets");
  targets["targets"]["targets"] = Json::object();
  roots.push_back(signed_file(root, signers["root"]));
  snapshot["meta"]["targets.json"] = listed(file("targets"), 1);
  timestamp["meta"]["snapshot.json"] = listed(file("snapshot"), 1);
}

Json Simulator::listed(const std::string& bytes, const Json& version) const {
  Json entry{{"version", version}};
  if (list_hashes) {
    entry["length"] = bytes.size();
    entry["hashes"]["sha256"] = sha256_text(bytes);
  }
  return entry;
}

void Simulator::set_keys(const std::string& role, const std::vector<TestKey>& keys, int threshold) {
  Json ids = Json::array();
  for (const auto& key : keys) {
    root["keys"][key.id] = key.open;
    ids.push_back(key.id);
  }
  root["roles"][role] = {{"keyids", ids}, {"threshold", threshold}};
  signers[role] = keys;
}

void Simulator::publish_root() {
  root["version"] = root["version"].get<int>() + 1;
  roots.push_back(signed_file(root, signers["root"]));
}

void Simulator::publish_timestamp() {
  timestamp["version"] = timestamp["version"].get<std::int64_t>() + 1;
  timestamp["meta"]["snapshot.json"] = listed(file("snapshot"), snapshot["version"]);
}

void Simulator::publish_snapshot() {
  snapshot["version"] = snapshot["version"].get<std::int64_t>() + 1;
  for (const auto& [role, body] : targets) snapshot["meta"][role + ".json"] = listed(file(role), body["version"]);
  publish_timestamp();
}

void Simulator::publish_targets(const std::string& role) {
  targets[role]["version"] = targets[role]["version"].get<std::int64_t>() + 1;
  publish_snapshot();
}

Json& Simulator::delegate(const std::string& from, const std::string& role, const std::vector<std::string>& paths,
                          bool terminating) {
  if (!targets.contains(role)) {
    targets[role] = targets["targets"];
    targets[role]["version"] = 1;
    targets[role]["targets"] = Json::object();
    targets[role].erase("delegations");
    signers[role] = {ed25519_key()};
  }
  Json& delegations = targets[from]["delegations"];
  if (!delegations.contains("roles")) delegations["roles"] = Json::array();
  Json ids = Json::array();
  for (const auto& key : signers[role]) {
    delegations["keys"][key.id] = key.open;
    ids.push_back(key.id);
  }
  delegations["roles"].push_back(
      {{"name", role}, {"keyids", ids}, {"threshold", 1}, {"paths", paths}, {"terminating", terminating}});
  return delegations["roles"].back();
}

void Simulator::add_target(const std::string& role, const std::string& path, const std::string& content) {
  targets[role]["targets"][path] = {{"length", content.size()}, {"hashes", {{"sha256", sha256_text(content)}}}};
  target_files[path] = content;
}

std::string Simulator::file(const std::string& role) const {
  if (role == "root") return roots.back();
  const Json& body = role == "timestamp" ? timestamp : role == "snapshot" ? snapshot : targets.at(role);
  return signed_file(body, signers.at(role));
}

std::string Simulator::find(const std::string& name, bool& found) const {
  found = true;
  if (const auto other = served.find(name); other != served.end()) return other->second;
  found = !withheld.contains(name);
  if (!found) return {};
  if (name == "timestamp.json") return file("timestamp");
  for (std::size_t i = 0; i < roots.size(); ++i) {
    if (name == std::to_string(i + 1) + ".root.json") return roots[i];
  }
  const auto is = [&](const std::string& role, const Json& body) {
    const std::string plain = percent_encoded(role) + ".json";
    return name == (root["consistent_snapshot"].get<bool>() ? body["version"].dump() + "." + plain : plain);
  };
  if (is("snapshot", snapshot)) return file("snapshot");
  for (const auto& [role, body] : targets) {
    if (is(role, body)) return file(role);
  }
  found = false;
  return {};
}

bool Simulator::fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) {
  requests.push_back(path);
  bool found = false;
  std::string bytes;
  if (base == "targets" && !withheld.contains(path)) {
    for (const auto& [name, content] : target_files) {
      const std::size_t slash = name.rfind('/') + 1;
      const bool consistent = root["consistent_snapshot"].get<bool>();
      const std::string remote =
          consistent ? name.substr(0, slash) + sha256_text(content) + "." + name.substr(slash) : name;
      if (remote == percent_decoded(path)) bytes = content, found = true;
    }
    if (const auto other = served.find(path); other != served.end()) bytes = other->second, found = true;
  } else if (base == "metadata") {
    bytes = find(path, found);
  }
  if (!found) return false;
  if (bytes.size() > most) {
    throw Error(ErrorCode::BadSignature, ErrorText{.what = "endless data: this file is larger than it may be",
                                                   .where = path,
                                                   .expected = std::to_string(most) + " bytes"});
  }
  sink(bytes);
  return true;
}

ClientOptions TufTest::options(Time now) const {
  return {.trusted = trusted,
          .metadata = "metadata",
          .targets = "targets",
          .limits = {},
          .now = [now] { return now; },
          .transport = repository};
}

std::string TufTest::refresh(Time now) const {
  try {
    Client client{options(now)};
    client.refresh();
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

std::string TufTest::download(const std::string& target, Time now) const {
  try {
    Client client{options(now)};
    client.refresh();
    client.download(client.target(target), downloads);
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

std::string TufTest::trusted_file(const std::string& name) const {
  return std::filesystem::exists(trusted / name) ? marketplace::testing::file_content(trusted / name) : std::string();
}

int TufTest::trusted_version(const std::string& role) const {
  const std::string text = trusted_file(percent_encoded(role) + ".json");
  return text.empty() ? 0 : Json::parse(text)["signed"]["version"].get<int>();
}

}  // namespace fiona::tuf::testing
