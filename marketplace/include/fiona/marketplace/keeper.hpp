#pragma once

#include <filesystem>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/trust/signing_key.hpp>
#include <fiona/trust/tuf_repository.hpp>
#include <functional>
#include <optional>
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

struct NewMarket {
  std::string root;  ///< the root.json that its users are to trust
  std::string keys;  ///< NAME of its keys: "NAME.root", "NAME.targets" and "NAME.online"
};

/// Makes an empty marketplace and its keys, named as the directory, with a number where there are such keys already.
/// Throws fiona::Error (NotAllowed) if there is one.
NewMarket init_market(const std::filesystem::path& market, const KeeperOptions& options = {});

/// Signs for a package with its publisher's key, which has the publisher's name: the next version of what that
/// publisher has signed, kept beside the key and written beside the package as PUBLISHER.json. A package that is signed
/// for already is so again only where half of the time is over. `after`: what a marketplace has of this publisher,
/// where that was lost here, or the key, or where something else was signed meanwhile; the version follows both, and
/// what this key has signed there is signed for, and nothing besides. Returns that file.
std::filesystem::path sign_package(const std::filesystem::path& package, const KeeperOptions& options = {},
                                   const std::filesystem::path& after = {});

/// Takes "publisher/name@version" off what its publisher's key has signed last: what was signed and never published.
/// Published, it is withdrawn with the next one. Throws fiona::Error: Usage, NotFound with what it has signed for.
void unsign_package(const std::string& package, const KeeperOptions& options = {});

struct Submitted {
  std::string publisher;
  std::string file;  ///< of the package, in `incoming`
};

/// Puts a package, and PUBLISHER.json from beside it, into the marketplace's `incoming`. Throws fiona::Error: NotFound
/// where there is no marketplace, BadSignature where nothing beside it signs for it, NotAllowed at an address, and
/// where what was signed later waits already.
Submitted submit(const std::filesystem::path& package, const std::filesystem::path& market,
                 const KeeperOptions& options = {});

/// Somebody who has handed in something and whom the marketplace does not know, or not with this key.
struct NewPublisher {
  std::string name;
  tuf::OpenKey key;
  bool other_key = false;  ///< known by another key
};

/// A publisher who is let in, and the key that he was asked for.
struct Welcome {
  std::string name;
  tuf::OpenKey key;
};

/// Something that was left in `incoming`.
struct Refusal {
  std::string file;
  std::string what;
  std::string next;
};

/// What somebody else has to sign again.
struct EndingRole {
  std::string name;   ///< "root", "targets" or a publisher
  std::string until;  ///< "2030-01-31T00:00:00Z"
  bool has_ended = false;
  std::string next;
};

struct Accepted {
  std::vector<std::string> packages;  ///< target paths that are new
  std::vector<NewPublisher> unknown;  ///< left in `incoming`
  std::vector<Refusal> refused;       ///< what else was left there, and why
  std::vector<EndingRole> ending;     ///< within 30 days: what could not be signed anew here
};

/// Takes what was handed in by the publishers that the marketplace knows, and by those in `welcome`, to whom it
/// delegates "PUBLISHER/*" if it is that key that they have signed with. Signs index, snapshot and timestamp anew in
/// any case. Throws fiona::Error (NotAllowed) where the keys for that are missing.
Accepted accept(const std::filesystem::path& market, const std::vector<Welcome>& welcome,
                const KeeperOptions& options = {});

/// Who signs what in a marketplace.
struct MarketRole {
  std::string name;  ///< "root", "targets", "online" (index, snapshot, timestamp), or a publisher
  tuf::Repository::RoleKeys keys{};
  std::optional<tuf::Repository::RoleKeys> proposed{};  ///< by a next root that lacks signatures still
  std::string expires{};                                ///< of what it signed last; empty: nothing
};
std::vector<MarketRole> market_roles(const std::filesystem::path& market, const KeeperOptions& options = {});

/// What became of a next root.
struct RootChange {
  std::int64_t lacking = 0;         ///< signatures; 0: it is the root now
  std::vector<std::string> made{};  ///< names of keys that were made for it
};

/// Gives "root", "targets" or "online" other keys: names of this user's signing keys, or 64 digits of somebody else's.
/// None: a new one is made, "MARKET.ROLE-N". `threshold` of them have to sign; more than one only for the root, whose
/// holders sign the proposal one after the other, each by sign_root(). Users follow by themselves. Throws fiona::Error:
/// Usage, NotFound, NotAllowed.
RootChange rotate(const std::filesystem::path& market, const std::string& role, const std::vector<std::string>& keys,
                  std::int64_t threshold, const KeeperOptions& options = {});

/// Signs the root that is proposed, with the keys that are here; where that is enough, and the keys of snapshot and
/// timestamp are here, makes it the root. Anybody who can write into the directory may have proposed it: `seen` is what
/// a person has looked at and agreed to. Throws fiona::Error: NotFound where none is proposed, BadSignature where
/// another one is.
RootChange sign_root(const std::filesystem::path& market, const std::vector<MarketRole>& seen,
                     const KeeperOptions& options = {});

/// Another key for a publisher, under the same name, with which all is signed again that the former one has signed for.
/// The keeper is to welcome him again. Returns the new key.
tuf::OpenKey renew_key(const std::string& publisher, const KeeperOptions& options = {});

/// Takes back what a marketplace offers, for good: `what` is "publisher", "publisher/name" or "publisher/name@version".
/// Nobody can install it any more, these bytes and these versions never come back, and users who have it are told and
/// cannot start it. A publisher is trusted no longer either: who had his key signs for nothing. `reason`, one line, is
/// shown to users. Throws fiona::Error: NotFound with what there is, NotAllowed where the keys for that are missing.
std::vector<Revocation> revoke(const std::filesystem::path& market, const std::string& what, const std::string& reason,
                               const KeeperOptions& options = {});

/// A build's own marketplace: makes it, and keys of its own where they are missing, lets it hold exactly these
/// packages, and writes MARKETPLACE.root.json beside it. Throws as the above.
void make_market(const std::vector<std::filesystem::path>& packages, const std::filesystem::path& market,
                 KeeperOptions options);

/// Whether the keys that accept() needs are among these.
bool keeps(const std::filesystem::path& market, const KeeperOptions& options = {});

}  // namespace fiona::marketplace
