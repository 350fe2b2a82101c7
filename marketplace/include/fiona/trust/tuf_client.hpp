#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fiona/marketplace/os_calls.hpp>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>

namespace fiona::tuf {

using Time = std::chrono::sys_seconds;

/// What a refresh or a download may cost at most, whatever the other side sends.
struct Limits {
  std::uint64_t root_bytes = 512 << 10;
  std::uint64_t timestamp_bytes = 64 << 10;
  std::uint64_t snapshot_bytes = 8 << 20;  ///< of one whose length is not listed; as for targets
  std::uint64_t targets_bytes = 8 << 20;
  int root_updates = 1024;  ///< in one refresh
  int roles_visited = 32;   ///< in one search for a target
  std::chrono::milliseconds connect{10'000};
  std::chrono::milliseconds patience{20'000};  ///< beside what the bytes may take, and for less than the least rate
  std::uint64_t least_bytes_per_second = 4096;
};

/// What signed metadata says of a target file.
struct TargetInfo {
  std::string path;
  std::uint64_t length = 0;                   ///< bytes
  std::map<std::string, std::string> hashes;  ///< lower-case hexadecimal digest by algorithm, at least one known here
  std::string custom;                         ///< JSON, or empty
  std::string signer{};  ///< the role that has signed for it, where the top one delegates to that itself; else empty
};

/// Where files come from. Tests bring their own.
class Transport {
 public:
  using Sink = std::function<void(std::string_view)>;

  virtual ~Transport() = default;
  /// Hands the file `path` (names between '/', not escaped) below `base` to `sink`, piece by piece. False where there
  /// is no such file. Throws fiona::Error: BadSignature for more than `most` bytes, Unreachable where the other side
  /// does not answer, or too slowly.
  virtual bool fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) = 0;
};

/// A directory ("/srv/market", "file:///srv/market"), http and https. Throws fiona::Error (Usage) for any other base.
std::unique_ptr<Transport> make_transport(const Limits& limits = {});

struct ClientOptions {
  std::filesystem::path trusted{};  ///< directory of what is trusted: root.json, timestamp.json, …
  std::string metadata{};           ///< base of the repository's metadata: a directory, http:// or https://
  std::string targets{};            ///< base of its target files; only for downloads
  Limits limits{};
  std::function<Time()> now{};             ///< default: the system's clock
  std::shared_ptr<Transport> transport{};  ///< default: make_transport. Shared with a test that watches it.
  marketplace::OsCalls os = marketplace::system_calls();
};

/// A client of a TUF repository: the whole workflow of the specification's section 5 (version 1.0.x). What has been
/// seen lies in `trusted`, written durably, one file at a time, each only after it was verified: a refresh that fails,
/// or is killed, leaves what the next one can go on from, and never less strict. Clients of one directory wait for each
/// other while they refresh or search, at most 10 s.
///
///     tuf::Client client{{.trusted = "market", .metadata = "https://example.org/metadata",
///                         .targets = "https://example.org/targets"}};
///     client.refresh();
///     client.download(client.target("acme/steps-1.0.0.fpk"), "downloads");
class Client {
 public:
  /// Throws fiona::Error: NotFound where `trusted` has no root.json, BadSignature if it is damaged.
  explicit Client(ClientOptions options);
  ~Client();

  /// Makes `root` (the content of a root.json that came by a way that is trusted) what all else is checked against.
  /// Throws fiona::Error (BadSignature) if it has not the form of one.
  static void trust(const std::filesystem::path& trusted, std::string_view root);

  /// Brings root, timestamp, snapshot and targets up to date. Throws fiona::Error: BadSignature with what was wrong
  /// (signature, rollback, freeze, mix and match, endless data), Unreachable, NotFound (a file that must be there).
  void refresh();

  /// What the repository says of a target; roles it delegates to are fetched as needed. Only after refresh(). Throws as
  /// that does, and NotFound if nobody who may speaks of it.
  TargetInfo target(const std::string& path);

  /// Who signs for which role that the top-level targets delegate to: their keys as others are given them, 64 digits of
  /// an Ed25519 key, else "id " and the id. Only after refresh().
  std::map<std::string, std::vector<std::string>> signers() const;

  /// Downloads a target into a directory, under its path, percent-encoded, unless it is there already. The name appears
  /// only once length and hashes are right. Returns the file.
  std::filesystem::path download(const TargetInfo& target, const std::filesystem::path& directory);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// A name as one element of a path: all but letters, digits and "-._~" as %XX.
std::string percent_encoded(std::string_view name);

}  // namespace fiona::tuf
