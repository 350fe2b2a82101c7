#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::trust {

/// A CURVE25519 key. Written as 64 hexadecimal digits, which need no quotes in a shell.
class Key {
 public:
  static constexpr std::size_t kBytes = 32;

  Key() = default;
  /// Nothing where the text is not 64 hexadecimal digits.
  static std::optional<Key> from_text(std::string_view text);
  /// 32 bytes as they come over the network; nothing for another length.
  static std::optional<Key> from_bytes(std::string_view bytes);

  std::string text() const;
  /// The 32 bytes.
  std::string bytes() const { return {bytes_.begin(), bytes_.end()}; }
  bool operator==(const Key&) const = default;

 private:
  std::array<char, kBytes> bytes_{};
};

/// The key pair of a host.
struct KeyPair {
  Key secret;
  Key open;  ///< what others are given
};

/// A host that may connect.
struct AllowedHost {
  std::string name;
  Key key;
};

/// Where a user keeps the key pair of his hosts (`host.key`, mode 0600) and the list of those that may connect to them
/// (`hosts.allowed`, lines "NAME KEY"). Files are replaced whole or not at all.
class KeyDirectory {
 public:
  /// Empty: $FIONA_KEYS, else $XDG_CONFIG_HOME/fiona, else ~/.config/fiona.
  explicit KeyDirectory(std::filesystem::path directory = {});

  const std::filesystem::path& path() const { return directory_; }
  bool has_pair() const;
  /// Makes a new pair. Throws Error NotAllowed if there is one: it may be what other hosts know this one by.
  KeyPair make() const;
  /// Throws Error: NotFound without a pair, NotAllowed if others may read it, Failed if it is damaged.
  KeyPair pair() const;

  /// In the order of the file; empty without a file. Throws Error Failed with the line that cannot be read.
  std::vector<AllowedHost> allowed() const;
  /// Throws Error: Usage for a name or key that is none, NotAllowed if the name or the key is taken.
  void allow(const std::string& name, const std::string& key) const;
  /// Throws Error NotFound, with near names.
  void forget(const std::string& name) const;

 private:
  std::filesystem::path pair_file() const { return directory_ / "host.key"; }
  std::filesystem::path allowed_file() const { return directory_ / "hosts.allowed"; }
  void replace(const std::filesystem::path& file, const std::string& text) const;

  const std::filesystem::path directory_;
};

}  // namespace fiona::trust
