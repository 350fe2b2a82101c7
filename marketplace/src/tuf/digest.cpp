#include "digest.hpp"

#include <openssl/evp.h>
#include <sodium/crypto_generichash.h>

#include <array>

namespace fiona::tuf {
namespace {

// BLAKE2b of 256 bits is the one that OpenSSL 3.0 lacks.
constexpr std::string_view kBlake256 = "blake2b-256";

const EVP_MD* openssl_digest(const std::string& algorithm) {
  if (algorithm == "sha256") return EVP_sha256();
  if (algorithm == "sha384") return EVP_sha384();
  if (algorithm == "sha512") return EVP_sha512();
  if (algorithm == "blake2b") return EVP_blake2b512();
  if (algorithm == "blake2s") return EVP_blake2s256();
  return nullptr;
}

}  // namespace

struct Digests::State {
  std::string algorithm;
  std::unique_ptr<EVP_MD_CTX, void (*)(EVP_MD_CTX*)> openssl{nullptr, EVP_MD_CTX_free};
  crypto_generichash_state blake{};
};

bool is_known_hash(const std::string& algorithm) { return algorithm == kBlake256 || openssl_digest(algorithm); }

Digests::Digests(const Hashes& wanted) {
  for (const auto& [algorithm, digest] : wanted) {
    if (!is_known_hash(algorithm)) continue;
    State& state = states_.emplace_back();
    state.algorithm = algorithm;
    if (algorithm == kBlake256) {
      crypto_generichash_init(&state.blake, nullptr, 0, 32);
    } else {
      state.openssl.reset(EVP_MD_CTX_new());
      EVP_DigestInit_ex(state.openssl.get(), openssl_digest(algorithm), nullptr);
    }
  }
}

Digests::~Digests() = default;
Digests::Digests(Digests&&) noexcept = default;

void Digests::update(std::string_view bytes) {
  for (State& state : states_) {
    if (state.openssl) {
      EVP_DigestUpdate(state.openssl.get(), bytes.data(), bytes.size());
    } else {
      crypto_generichash_update(&state.blake, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
    }
  }
}

Hashes Digests::finish() {
  Hashes hashes;
  for (State& state : states_) {
    std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
    unsigned size = 32;
    if (state.openssl) {
      EVP_DigestFinal_ex(state.openssl.get(), digest.data(), &size);
    } else {
      crypto_generichash_final(&state.blake, digest.data(), size);
    }
    hashes[state.algorithm] = to_hex({reinterpret_cast<const char*>(digest.data()), size});
  }
  return hashes;
}

std::string sha256_hex(std::string_view bytes) {
  Digests digests{{{"sha256", ""}}};
  digests.update(bytes);
  return digests.finish()["sha256"];
}

std::string to_hex(std::string_view bytes) {
  std::string hex;
  hex.reserve(2 * bytes.size());
  for (const char byte : bytes) {
    hex += "0123456789abcdef"[static_cast<unsigned char>(byte) >> 4];
    hex += "0123456789abcdef"[byte & 15];
  }
  return hex;
}

std::string from_hex(std::string_view text) {
  const auto digit = [](char c) -> int {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
  };
  if (text.size() % 2 != 0) return {};
  std::string bytes;
  for (std::size_t i = 0; i < text.size(); i += 2) {
    if (digit(text[i]) < 0 || digit(text[i + 1]) < 0) return {};
    bytes += static_cast<char>(digit(text[i]) * 16 + digit(text[i + 1]));
  }
  return bytes;
}

}  // namespace fiona::tuf
