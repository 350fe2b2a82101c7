#pragma once

#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/trust/tuf_client.hpp>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::marketplace {

struct OpenOptions {
  std::filesystem::path trusted{};  ///< what is trusted, a directory for each place; default: the user's
  std::filesystem::path copies{};   ///< where indexes and packages are kept; default: the user's cache
  bool ask_network = true;          ///< false: of a server only what was fetched before, or NotFound
  tuf::Limits limits{};
  std::function<tuf::Time()> now{};             ///< default: the system's clock
  std::shared_ptr<tuf::Transport> transport{};  ///< default: tuf::make_transport
};

/// A marketplace that is signed (TUF), at a directory, file://, http:// or https:// address: brings its metadata up to
/// date and gives its index; packages are fetched and verified when they are installed. Empty: the default marketplace.
/// Throws fiona::Error: NotFound where nobody has said that this marketplace is to be trusted, BadSignature with what
/// was wrong, Unreachable.
Marketplace open_marketplace(const std::string& location = {}, const OpenOptions& options = {});

/// Lets a marketplace be trusted from now on whose root.json has come by a way that is trusted itself. A place that is
/// trusted already keeps what was seen of it only where the new root is of the same keys. Throws fiona::Error
/// (BadSignature) if this is no root, or not signed by itself.
void trust_marketplace(std::string_view root, const std::string& location, const OpenOptions& options = {});

/// A place that is trusted.
struct TrustedPlace {
  std::string location;
  std::vector<std::string> root_keys;  ///< as their owners give them, 64 digits; "id …" of another kind than Ed25519
  std::string expires;                 ///< of its root: "2030-01-31T00:00:00Z"
};
std::vector<TrustedPlace> trusted_marketplaces(const OpenOptions& options = {});

}  // namespace fiona::marketplace
