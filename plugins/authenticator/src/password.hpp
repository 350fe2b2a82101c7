#pragma once

#include <string>
#include <string_view>

namespace fiona::authenticator {

/// Overwrites the text.
void wipe(std::string& text);

/// A text that is overwritten when it ends.
class Secret {
 public:
  Secret() = default;
  explicit Secret(std::string_view text) : text_(text) {}
  Secret(Secret&& other) noexcept { text_.swap(other.text_); }
  Secret& operator=(Secret&& other) noexcept {
    text_.swap(other.text_);
    return *this;
  }
  ~Secret() { wipe(text_); }

  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

/// argon2id (RFC 9106) with 64 MiB and 2 passes, as a text with salt and cost: a tenth of a second and more.
/// Throws Error (Failed) where there is no memory for it.
std::string hash_of(const Secret& password);

/// Whether the hash is the password's. Takes as long as hash_of, whatever the answer.
bool verifies(const std::string& hash, const Secret& password);

/// A hash that no password has, of the same cost: what the password of an unknown name is compared with.
const std::string& hash_of_nobody();

/// Throws Error (Usage) for a password that should not be one: shorter than 8 characters, longer than 1024 bytes, the
/// name itself, or with control characters, which cannot be typed everywhere.
void check_new_password(const Secret& password, std::string_view name);

}  // namespace fiona::authenticator
