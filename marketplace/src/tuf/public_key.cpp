#include "public_key.hpp"

#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/rsa.h>
#include <openssl/x509.h>
#include <sodium/crypto_sign.h>

#include <array>
#include <memory>

#include "digest.hpp"

namespace fiona::tuf {
namespace {

constexpr int kLeastRsaBits = 2048;
constexpr int kMostRsaBits = 8192;  // above, one signature would cost a client seconds

struct FreeKey {
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
};
using OpensslKey = std::unique_ptr<EVP_PKEY, FreeKey>;

bool is_p256(const EVP_PKEY* key) {
  std::array<char, 64> group{};
  std::size_t size = 0;
  return EVP_PKEY_is_a(key, "EC") && EVP_PKEY_get_group_name(key, group.data(), group.size(), &size) == 1 &&
         std::string_view(group.data(), size) == "prime256v1";
}

bool is_rsa(const EVP_PKEY* key) {
  const int bits = EVP_PKEY_is_a(key, "RSA") ? EVP_PKEY_get_bits(key) : 0;
  return bits >= kLeastRsaBits && bits <= kMostRsaBits;
}

OpensslKey read_pem(const std::string& pem) {
  const std::unique_ptr<BIO, int (*)(BIO*)> source{BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())), BIO_free};
  // An "encrypted" public key would make OpenSSL ask at the terminal for its password.
  const auto no_password = [](char*, int, int, void*) { return 0; };
  return OpensslKey{PEM_read_bio_PUBKEY(source.get(), nullptr, no_password, nullptr)};
}

OpensslKey read_der(const std::string& der) {
  auto* bytes = reinterpret_cast<const unsigned char*>(der.data());
  return OpensslKey{d2i_PUBKEY(nullptr, &bytes, static_cast<long>(der.size()))};
}

std::string to_der(EVP_PKEY* key) {
  unsigned char* bytes = nullptr;
  const int size = i2d_PUBKEY(key, &bytes);
  std::string der{reinterpret_cast<const char*>(bytes), static_cast<std::size_t>(size > 0 ? size : 0)};
  OPENSSL_free(bytes);
  return der;
}

bool verifies_openssl(const std::string& der, bool pss, std::string_view message, std::string_view signature) {
  const OpensslKey key = read_der(der);
  const std::unique_ptr<EVP_MD_CTX, void (*)(EVP_MD_CTX*)> context{EVP_MD_CTX_new(), EVP_MD_CTX_free};
  EVP_PKEY_CTX* options = nullptr;  // belongs to the context
  if (!key || EVP_DigestVerifyInit(context.get(), &options, EVP_sha256(), nullptr, key.get()) != 1) return false;
  // Implementations differ in the salt's length; it is read from the signature.
  if (pss && (EVP_PKEY_CTX_set_rsa_padding(options, RSA_PKCS1_PSS_PADDING) != 1 ||
              EVP_PKEY_CTX_set_rsa_pss_saltlen(options, RSA_PSS_SALTLEN_AUTO) != 1)) {
    return false;
  }
  return EVP_DigestVerify(context.get(), reinterpret_cast<const unsigned char*>(signature.data()), signature.size(),
                          reinterpret_cast<const unsigned char*>(message.data()), message.size()) == 1;
}

bool is_ecdsa(const std::string& type, const std::string& scheme) {
  return (type == "ecdsa" || type == "ecdsa-sha2-nistp256") && scheme == "ecdsa-sha2-nistp256";
}

bool is_rsa_scheme(const std::string& type, const std::string& scheme) {
  return type == "rsa" && (scheme == "rsassa-pss-sha256" || scheme == "rsa-pkcs1v15-sha256");
}

}  // namespace

PublicKey::PublicKey(const Json& key, const std::string& where) {
  if (!key.is_object()) refuse_form(where, "a key is not an object");
  type_ = string_in(key, "keytype", where);
  scheme_ = string_in(key, "scheme", where);
  const Json& values = object_in(key, "keyval", where);
  const auto found = values.find("public");
  if (found == values.end() || !found->is_string()) return;
  const auto& text = found->get_ref<const std::string&>();
  if (type_ == "ed25519" && scheme_ == "ed25519") {
    value_ = from_hex(text);
    if (value_.size() != crypto_sign_PUBLICKEYBYTES) value_.clear();
  } else if (is_ecdsa(type_, scheme_) || is_rsa_scheme(type_, scheme_)) {
    const OpensslKey parsed = read_pem(text);
    if (parsed && (type_ == "rsa" ? is_rsa(parsed.get()) : is_p256(parsed.get()))) value_ = to_der(parsed.get());
  }
  if (!value_.empty()) identity_ = (type_ == "ed25519" ? "ed25519 " : "openssl ") + value_;
}

std::string PublicKey::open() const { return type_ == "ed25519" ? to_hex(value_) : ""; }

bool PublicKey::verifies(std::string_view message, std::string_view signature) const {
  if (value_.empty()) return false;
  if (type_ != "ed25519") return verifies_openssl(value_, scheme_ == "rsassa-pss-sha256", message, signature);
  return signature.size() == crypto_sign_BYTES &&
         crypto_sign_verify_detached(reinterpret_cast<const unsigned char*>(signature.data()),
                                     reinterpret_cast<const unsigned char*>(message.data()), message.size(),
                                     reinterpret_cast<const unsigned char*>(value_.data())) == 0;
}

std::string key_id(const Json& key) { return sha256_hex(canonical(key)); }

}  // namespace fiona::tuf
