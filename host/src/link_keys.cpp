#include "link_keys.hpp"

#include <sodium.h>

namespace fiona::host {
namespace {

std::string keyed_hash(const std::string& key, const std::string& text, std::size_t length) {
  std::string hash(length, '\0');
  crypto_generichash(reinterpret_cast<unsigned char*>(hash.data()), hash.size(),
                     reinterpret_cast<const unsigned char*>(text.data()), text.size(),
                     reinterpret_cast<const unsigned char*>(key.data()), key.size());
  return hash;
}

/// Each piece behind its length, so that no two lists of pieces have the same text.
std::string joined(std::string_view a, std::string_view b, std::string_view c = {}) {
  std::string text;
  for (const auto piece : {a, b, c}) text += std::to_string(piece.size()) + ":" + std::string(piece);
  return text;
}

}  // namespace

std::string random_bytes(std::size_t count) {
  std::string bytes(count, '\0');
  randombytes_buf(bytes.data(), bytes.size());
  return bytes;
}

std::string link_key(const std::string& provider_key, std::string_view client) {
  return keyed_hash(provider_key, joined("fiona link", client), kKeyBytes);
}

std::string memory_key(const std::string& host_key, const std::string& link_key) {
  return keyed_hash(host_key, joined("fiona memory", link_key), kKeyBytes);
}

std::string link_proof(const std::string& link_key, LinkSide side, std::string_view client_nonce,
                       std::string_view provider_nonce) {
  const std::string_view role = side == LinkSide::Client ? "client" : "provider";
  return keyed_hash(link_key, joined(role, client_nonce, provider_nonce), kKeyBytes);
}

bool same_proof(std::string_view a, std::string_view b) {
  return a.size() == b.size() && sodium_memcmp(a.data(), b.data(), a.size()) == 0;
}

std::string derived_nonce(const std::string& secret, std::string_view of) {
  return keyed_hash(secret, joined("fiona nonce", of), kNonceBytes);
}

}  // namespace fiona::host
