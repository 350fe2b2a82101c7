#pragma once

#include <filesystem>
#include <fiona/trust/tuf_client.hpp>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "support.hpp"

namespace fiona::tuf::testing {

using Json = nlohmann::json;

/// A key pair that lives as long as the test.
struct TestKey {
  Json open;  ///< as metadata lists it
  std::string id;
  std::function<std::string(std::string_view)> sign;  ///< bytes -> signature
};

TestKey ed25519_key();
TestKey ecdsa_key(const std::string& keytype = "ecdsa", const char* curve = "P-256");
TestKey rsa_key(const std::string& scheme, unsigned bits = 2048);

/// Canonical JSON of its own, for metadata whose strings have no other special characters than '"', '\' and line ends.
std::string canonical_text(const Json& value);
std::string sha256_text(std::string_view bytes);

/// A whole metadata file: {"signatures": …, "signed": body}.
std::string signed_file(const Json& body, const std::vector<TestKey>& keys);

/// A TUF repository in memory, which a test may change in any way, and the way to it. Files are made and signed when
/// they are asked for, from the bodies as they are then. All expires at the end of day 30; time 0 is start().
class Simulator final : public Transport {
 public:
  Simulator();

  static Time start();
  static Time day(int number) { return start() + std::chrono::days{number}; }

  // Each makes the next version of a role's file, and what must follow from it: targets → snapshot → timestamp.
  void publish_root();
  void publish_timestamp();
  void publish_snapshot();
  void publish_targets(const std::string& role = "targets");

  /// Replaces who signs for a top-level role; publish_root() makes it seen.
  void set_keys(const std::string& role, const std::vector<TestKey>& keys, int threshold = 1);
  /// `from` delegates paths to a new role, which has its file at once. Publish `from` afterwards.
  Json& delegate(const std::string& from, const std::string& role, const std::vector<std::string>& paths,
                 bool terminating = false);
  void add_target(const std::string& role, const std::string& path, const std::string& content);

  /// The file as it would be served now.
  std::string file(const std::string& role) const;

  bool fetch(const std::string& base, const std::string& path, std::uint64_t most, const Sink& sink) override;

  Json root, timestamp, snapshot;
  std::map<std::string, Json> targets;                  ///< by role; the top-level one too
  std::map<std::string, std::vector<TestKey>> signers;  ///< who signs a role's file
  std::vector<std::string> roots;                       ///< published, the first is version 1
  std::map<std::string, std::string> target_files;      ///< by path
  bool list_hashes = true;                              ///< timestamp and snapshot list length and hashes

  std::map<std::string, std::string> served;  ///< instead of the real file of that name
  std::map<std::string, bool> withheld;       ///< names that are not there
  std::vector<std::string> requests;

 private:
  Json listed(const std::string& bytes, const Json& version) const;
  std::string find(const std::string& name, bool& found) const;
};

/// A directory that is removed with the test, a simulator, and clients of it.
class TufTest {
 public:
  TufTest() { trust_first_root(); }

  /// The first root becomes the trusted one.
  void trust_first_root() const { Client::trust(trusted, repository->roots.front()); }
  ClientOptions options(Time now = Simulator::start()) const;
  /// A client of its own, as another run of a program is; empty: it succeeded; else what it was refused with.
  std::string refresh(Time now = Simulator::start()) const;
  std::string download(const std::string& target, Time now = Simulator::start()) const;
  /// Version in a trusted file; 0 if there is none.
  int trusted_version(const std::string& role) const;
  std::string trusted_file(const std::string& name) const;

  marketplace::testing::Scratch directory;
  const std::filesystem::path trusted = directory / "trusted", downloads = directory / "downloads";
  std::shared_ptr<Simulator> repository = std::make_shared<Simulator>();
};

}  // namespace fiona::tuf::testing
