#include "password.hpp"

#include <sodium.h>

#include <algorithm>

#include "fiona/error.hpp"

namespace fiona::authenticator {
namespace {

constexpr unsigned long long kPasses = 2;
constexpr std::size_t kMemory_bytes = std::size_t{64} << 20;
constexpr std::size_t kShortest = 8;
constexpr std::size_t kLongest = 1024;

bool initialised() {
  static const bool done = sodium_init() >= 0;
  return done;
}

/// Random bytes in base 64, as salt and hash are written.
std::string random_text(std::size_t bytes) {
  std::string random(bytes, '\0');
  randombytes_buf(random.data(), random.size());
  std::string text(sodium_base64_ENCODED_LEN(bytes, sodium_base64_VARIANT_ORIGINAL_NO_PADDING), '\0');
  sodium_bin2base64(text.data(), text.size(), reinterpret_cast<const unsigned char*>(random.data()), random.size(),
                    sodium_base64_VARIANT_ORIGINAL_NO_PADDING);
  text.pop_back();
  return text;
}

}  // namespace

void wipe(std::string& text) { sodium_memzero(text.data(), text.capacity()); }

std::string hash_of(const Secret& password) {
  std::string hash(crypto_pwhash_STRBYTES, '\0');
  if (!initialised() || crypto_pwhash_str_alg(hash.data(), password.text().data(), password.text().size(), kPasses,
                                              kMemory_bytes, crypto_pwhash_ALG_ARGON2ID13) != 0) {
    throw Error(ErrorCode::Failed, {.what = "a password could not be hashed: there is no memory for it",
                                    .expected = std::to_string(kMemory_bytes >> 20) + " MiB"});
  }
  hash.resize(hash.find('\0'));
  return hash;
}

bool verifies(const std::string& hash, const Secret& password) {
  return initialised() && hash.size() < crypto_pwhash_STRBYTES &&
         crypto_pwhash_str_verify(hash.c_str(), password.text().data(), password.text().size()) == 0;
}

const std::string& hash_of_nobody() {
  static const std::string hash = [] {
    initialised();
    return "$argon2id$v=19$m=" + std::to_string(kMemory_bytes >> 10) + ",t=" + std::to_string(kPasses) + ",p=1$" +
           random_text(16) + "$" + random_text(32);
  }();
  return hash;
}

void check_new_password(const Secret& password, std::string_view name) {
  const std::string& text = password.text();
  const auto refuse = [](std::string expected, std::string found) {
    throw Error(ErrorCode::Usage, {.what = "this password is not taken",
                                   .expected = std::move(expected),
                                   .found = std::move(found),
                                   .next = "several words are long, and easy to remember"});
  };
  // Continuation bytes of UTF-8 are no characters of their own.
  const auto characters = std::count_if(text.begin(), text.end(), [](unsigned char c) { return (c & 0xc0) != 0x80; });
  if (static_cast<std::size_t>(characters) < kShortest || text.size() > kLongest) {
    refuse("8 characters or more, 1024 bytes at most", std::to_string(characters) + " characters");
  }
  if (text == name) refuse("another text than the name", "the name");
  if (std::any_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; })) {
    refuse("characters that can be typed", "a control character");
  }
}

}  // namespace fiona::authenticator
