#pragma once

#include <filesystem>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/trust/signing_key.hpp>
#include <fiona/trust/tuf_repository.hpp>
#include <functional>
#include <string>
#include <vector>

namespace fiona::marketplace {

// A signed marketplace is a directory that is served as it is, by http or as a directory:
//   metadata/  TUF metadata: N.root.json, timestamp.json, N.snapshot.json, N.targets.json, N.PUBLISHER.json, …
//   targets/   HASH.index.binpb, and PUBLISHER/HASH.NAME-VERSION-ARCHITECTURE.fpk
//   incoming/  what publishers have handed in: packages, and PUBLISHER.json that signs for them
// The keeper's keys are elsewhere: among his signing keys.

struct KeeperOptions {
  tuf::SigningKeys keys{};
  std::filesystem::path trusted{};  ///< what he has seen of the marketplace; default: beside the keys
  tuf::Lifetimes lifetimes{};
  std::function<tuf::Time()> now{};  ///< default: the system's clock
  PackageLimits limits{};
  bool replace = false;  ///< other content of a published version takes its place: for a build's own marketplace only
};

/// Makes an empty marketplace and its keys, "NAME.root", "NAME.targets" and "NAME.online", where NAME is the
/// directory's. Returns the root.json that its users are to trust. Throws fiona::Error (NotAllowed) if there is one.
std::string init_market(const std::filesystem::path& market, const KeeperOptions& options = {});

/// Signs for a package with its publisher's key, which has the publisher's name: the next version of what that
/// publisher has signed, kept beside the key and written beside the package as PUBLISHER.json. A package that is signed
/// for already is so again only where half of the time is over. Returns that file.
std::filesystem::path sign_package(const std::filesystem::path& package, const KeeperOptions& options = {});

/// Puts a package, and PUBLISHER.json from beside it, into the marketplace's `incoming`. Throws fiona::Error: NotFound
/// where it is not signed, BadSignature where that is not for this package. Returns the publisher.
std::string submit(const std::filesystem::path& package, const std::filesystem::path& market,
                   const KeeperOptions& options = {});

/// Somebody who has handed in something and whom the marketplace does not know, or not with this key.
struct NewPublisher {
  std::string name;
  tuf::OpenKey key;
  bool other_key = false;  ///< known by another key
};

struct Accepted {
  std::vector<std::string> packages;  ///< target paths that are new
  std::vector<NewPublisher> unknown;  ///< left in `incoming`
  std::vector<std::string> refused;   ///< what else was left there, and why
};

/// Takes what was handed in by the publishers that the marketplace knows, and by those in `welcome`, to whom it
/// delegates "PUBLISHER/*" with the key that they sign with. Signs index, snapshot and timestamp anew in any case.
/// Throws fiona::Error (NotAllowed) where the keys for that are missing.
Accepted accept(const std::filesystem::path& market, const std::vector<std::string>& welcome,
                const KeeperOptions& options = {});

/// A build's own marketplace: makes it, and keys of its own where they are missing, lets it hold exactly these
/// packages, and writes MARKETPLACE.root.json beside it. Throws as the above.
void make_market(const std::vector<std::filesystem::path>& packages, const std::filesystem::path& market,
                 KeeperOptions options);

/// Whether the keys that accept() needs are among these.
bool keeps(const std::filesystem::path& market, const KeeperOptions& options = {});

}  // namespace fiona::marketplace
