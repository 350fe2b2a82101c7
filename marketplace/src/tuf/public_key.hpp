#pragma once

#include <map>
#include <string>
#include <string_view>

#include "json.hpp"

namespace fiona::tuf {

/// A key as metadata lists it: ed25519, ecdsa (P-256) or rsa (at least 2048 bits). A key of any other kind is kept, and
/// verifies nothing: other roles of the repository may need it for other clients.
class PublicKey {
 public:
  /// Throws fiona::Error (BadSignature) where a key has not the form of one.
  PublicKey(const Json& key, const std::string& where);

  /// Whether `signature` (bytes, as the scheme has them: ECDSA's in DER) is this key's of `message`.
  bool verifies(std::string_view message, std::string_view signature) const;

  /// Equal for two entries exactly where they are the same key, under whatever id, scheme or spelling. Empty where the
  /// key cannot be read.
  const std::string& identity() const { return identity_; }

  /// As its owner gives it to others: 64 hexadecimal digits of an Ed25519 key; empty for another kind.
  std::string open() const;

 private:
  std::string type_, scheme_;
  std::string value_;  // 32 bytes of Ed25519, else DER of a SubjectPublicKeyInfo
  std::string identity_;
};

/// By key id.
using Keys = std::map<std::string, PublicKey>;

/// The id by which our repositories name a key: SHA-256 of its canonical form.
std::string key_id(const Json& key);

}  // namespace fiona::tuf
