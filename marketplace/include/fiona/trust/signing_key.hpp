#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::tuf {

/// The open half of an Ed25519 key as others are given it: 64 hexadecimal digits.
using OpenKey = std::string;

/// Whether it is one: 64 digits, lower-case.
bool is_open_key(std::string_view text);

/// The id by which metadata names an Ed25519 key: SHA-256 of its canonical form.
std::string key_id_of(const OpenKey& key);

/// An Ed25519 key pair (libsodium) that signs metadata. Its secret half is wiped with it.
class SigningKey {
 public:
  static SigningKey make();
  /// 64 hexadecimal digits of its seed; nothing for any other text.
  static std::optional<SigningKey> from_seed(std::string_view hex);
  SigningKey(const SigningKey&) = default;
  SigningKey& operator=(const SigningKey&) = default;
  ~SigningKey();

  const OpenKey& open() const { return open_; }
  std::string seed() const;
  /// 64 bytes.
  std::string sign(std::string_view message) const;

 private:
  explicit SigningKey(const std::array<unsigned char, 64>& secret);

  std::array<unsigned char, 64> secret_;
  OpenKey open_;
};

/// A user's signing keys, by name, each in a file NAME.key (mode 0600) of one directory; and beside a publisher's key
/// what it has signed, NAME.json.
class SigningKeys {
 public:
  /// `signing` in the user's directory for keys (trust::KeyDirectory), or another directory. It need not exist.
  explicit SigningKeys(std::filesystem::path directory = {});

  const std::filesystem::path& path() const { return directory_; }
  /// Makes a key. Throws fiona::Error: Usage for a name that is none, NotAllowed if there is one of that name.
  SigningKey make(const std::string& name) const;
  /// Makes another key in place of the one of that name, which stays beside it as NAME.key.old. Throws as get().
  SigningKey renew(const std::string& name) const;
  /// Throws fiona::Error: NotFound with near names, NotAllowed if others may read the file, Failed if it is damaged.
  SigningKey get(const std::string& name) const;
  std::vector<std::string> names() const;
  /// The first that metadata names by this id; nothing if none that can be read has it.
  std::optional<SigningKey> with_id(const std::string& key_id) const;
  /// Where one is missed: it may be one that cannot be read. Throws as get().
  void require_readable() const;

  /// What a publisher's key has signed last; nothing at first.
  std::optional<std::string> signed_role(const std::string& name) const;
  void keep_signed_role(const std::string& name, std::string_view role) const;

 private:
  const std::filesystem::path directory_;
};

}  // namespace fiona::tuf
