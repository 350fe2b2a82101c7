#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/trust/access.hpp"

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

/// Whether it is "ADDRESS:PORT".
bool is_address(const std::string& text);

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

/// A console on another machine that may connect, and what it may do.
struct AllowedConsole {
  std::string name;
  Key key;
  Access level = Access::Nothing;
};

/// A host on another machine that consoles here know by a name.
struct KnownHost {
  std::string name;
  std::string address;  ///< "ADDRESS:PORT"
  Key key;
};

/// Where a user keeps the key pair of his hosts and consoles (`host.key`, mode 0600) and three lists: the hosts that
/// may connect to his (`hosts.allowed`, lines "NAME KEY"), the consoles that may (`consoles.allowed`, "NAME KEY
/// LEVEL"), and the hosts that he has given names (`hosts.known`, "NAME ADDRESS:PORT KEY"). To be in one is to be in no
/// other. Files are replaced whole or not at all.
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

  /// Each list in the order of its file; empty without a file. Throws Error Failed with the line that cannot be read.
  std::vector<AllowedHost> allowed() const;
  std::vector<AllowedConsole> consoles() const;
  std::vector<KnownHost> known() const;
  /// Throws Error: Usage for a name, key or address that is none, NotAllowed if the name or the key is taken.
  void allow(const std::string& name, const std::string& key) const;
  /// As above; one that is in the list already, with this key, gets the new level.
  void allow_console(const std::string& name, const std::string& key, Access level) const;
  void know(const std::string& name, const std::string& address, const std::string& key) const;
  /// In all lists. Throws Error NotFound, with near names.
  void forget(const std::string& name) const;

 private:
  std::filesystem::path pair_file() const { return directory_ / "host.key"; }
  void make_directory() const;
  void replace(const std::filesystem::path& file, const std::string& text) const;

  const std::filesystem::path directory_;
};

}  // namespace fiona::trust
