#include <fcntl.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/open.hpp>
#include <fiona/trust/host_keys.hpp>

#include "durable.hpp"
#include "files.hpp"
#include "index_file.hpp"
#include "signed_market.hpp"
#include "tuf/locations.hpp"
#include "tuf/trusted_metadata.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr std::chrono::hours kMayBeInUse{1};  // a package, since it was fetched

filesystem::path trusted_places(const OpenOptions& options) {
  return options.trusted.empty() ? trust::KeyDirectory().path() / "markets" : options.trusted;
}

filesystem::path copies_of(const OpenOptions& options) {
  if (!options.copies.empty()) return options.copies;
  const auto variable = [](const char* name) { return filesystem::path(std::getenv(name) ? std::getenv(name) : ""); };
  if (const auto cache = variable("XDG_CACHE_HOME"); cache.is_absolute()) return cache / "fiona/markets";
  if (const auto home = variable("HOME"); home.is_absolute()) return home / ".cache/fiona/markets";
  throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no place for copies of packages: HOME is not set",
                                             .next = "set XDG_CACHE_HOME to a directory"});
}

// One spelling for one place, so that trust is not lost by a '/' too many.
std::string canonical_place(const std::string& location) {
  std::string place = location.empty() ? Marketplace::default_directory().string() : location;
  if (place.starts_with("file://")) place = tuf::percent_decoded(place.substr(7));
  if (tuf::is_directory_location(place)) {
    std::error_code failure;
    const filesystem::path whole = filesystem::weakly_canonical(filesystem::absolute(place), failure);
    place = failure ? filesystem::absolute(place).lexically_normal().string() : whole.string();
  }
  while (place.size() > 1 && place.back() == '/') place.pop_back();
  return place;
}

std::string content_of_root(const filesystem::path& path) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  return file ? read_all(file, tuf::Limits{}.root_bytes, path) : std::string();
}

/// The root that came with this program for the marketplace that came with it: MARKETPLACE.root.json beside it. Who can
/// change that file can change the program.
std::string shipped_root(const std::string& place) {
  for (const filesystem::path& own : Marketplace::shipped_directories()) {
    if (place == canonical_place(own.string())) return content_of_root(own.string() + ".root.json");
  }
  return {};
}

filesystem::path trusted_directory(const std::string& place, const OpenOptions& options) {
  const std::string shipped = shipped_root(place);
  const std::string name = tuf::percent_encoded(place);
  // A new program may come with a new root: it is a new beginning, of no less trust than the program's.
  if (shipped.empty()) return trusted_places(options) / name;
  const filesystem::path own = trusted_places(options) / (name + "@" + tuf::sha256_hex(shipped).substr(0, 16));
  std::error_code failure;
  if (!filesystem::exists(own / "root.json", failure)) tuf::Client::trust(own, shipped);
  return own;
}

void require_trusted(const filesystem::path& directory, const std::string& place) {
  std::error_code failure;
  if (filesystem::exists(directory / "root.json", failure)) return;
  if (tuf::is_directory_location(place) && !filesystem::exists(filesystem::path(place) / "metadata", failure)) {
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no marketplace here: it has no metadata",
                                               .where = place,
                                               .next = "choose one with --from DIR|URL, or set FIONA_MARKET"});
  }
  throw Error(ErrorCode::NotFound,
              ErrorText{.what = "nobody has said that this marketplace is to be trusted",
                        .where = place,
                        .expected = "its root.json, which its keeper gives you by a way that you trust",
                        .next = "fiona keys trust ROOT.json --from " + place});
}

std::shared_ptr<tuf::Client> make_client(const filesystem::path& trusted, const std::string& place,
                                         const OpenOptions& options) {
  return std::make_shared<tuf::Client>(tuf::ClientOptions{.trusted = trusted,
                                                          .metadata = place + "/metadata",
                                                          .targets = place + "/targets",
                                                          .limits = options.limits,
                                                          .now = options.now,
                                                          .transport = options.transport});
}

// Packages of earlier installations; the store has what is needed of them. Another process may just be fetching one,
// and hold the lock, or installing from it.
void remove_old_packages(const filesystem::path& copy) {
  const OsCalls os = system_calls();
  DurableDirectory directory{os, copy, 0700};
  try {
    directory.lock(std::chrono::milliseconds(0));
  } catch (const Error&) {
    return;  // the next one removes them
  }
  const auto in_use_since = filesystem::file_time_type::clock::now() - kMayBeInUse;
  for (const auto& name : directory.names()) {
    std::error_code failure;
    const bool is_old = filesystem::last_write_time(copy / name, failure) < in_use_since && !failure;
    if (name.ends_with(".new") || (name.ends_with(".fpk") && is_old)) directory.remove_tree_quietly(name);
  }
}

filesystem::path fetch_package(tuf::Client& client, const IndexEntry& entry, const filesystem::path& copy) {
  const tuf::TargetInfo target = client.target(target_path(entry.manifest()));
  // The keys that people are shown are those of the role of that name, and of nobody else who may sign for the path.
  if (target.signer != entry.manifest().publisher())
    throw Error(ErrorCode::BadSignature,
                ErrorText{.what = "the package was not signed by its publisher",
                          .where = target.path,
                          .expected = "a signature of the role '" + entry.manifest().publisher() + "'",
                          .found = target.signer.empty() ? "one of the marketplace's keeper"
                                                         : "one of the role '" + target.signer + "'",
                          .next = "tell the publisher"});
  if (target.length == entry.size()) return client.download(target, copy);
  throw Error(ErrorCode::BadSignature,
              ErrorText{.what = "the marketplace's index and the publisher do not speak of the same package",
                        .where = target.path,
                        .expected = std::to_string(target.length) + " bytes",
                        .found = std::to_string(entry.size()) + " bytes",
                        .next = "tell the marketplace's keeper"});
}

}  // namespace

Marketplace open_marketplace(const std::string& location, const OpenOptions& options) {
  const std::string place = canonical_place(location);
  const bool is_named = place != canonical_place("");
  const filesystem::path trusted = trusted_directory(place, options);
  require_trusted(trusted, place);
  const filesystem::path copy = copies_of(options) / trusted.filename();
  if (!options.ask_network && !tuf::is_directory_location(place)) {
    const auto fetch = [place](const IndexEntry&) -> filesystem::path {
      throw Error(
          ErrorCode::Unreachable,
          ErrorText{.what = "the marketplace was not asked", .where = place, .next = "open it with ask_network"});
    };
    return Marketplace{copy, place, Marketplace::Behind{.fetch = fetch, .is_named = is_named}};
  }
  const auto client = make_client(trusted, place, options);
  client->refresh();
  remove_old_packages(copy);
  client->download(client->target(std::string(kIndexFile)), copy);
  return Marketplace{copy,
                     place,
                     {.fetch = [client, copy](const IndexEntry& entry) { return fetch_package(*client, entry, copy); },
                      .keys = client->signers(),
                      .first_party = !shipped_root(place).empty(),
                      .is_named = is_named}};
}

void trust_marketplace(std::string_view root, const std::string& location, const OpenOptions& options) {
  const tuf::TrustedMetadata checked{root, tuf::Time{}};
  const std::string place = canonical_place(location);
  const filesystem::path directory = trusted_places(options) / tuf::percent_encoded(place);
  const std::string before = content_of_root(directory / "root.json");
  const bool same_keys = !before.empty() && tuf::parse_root(before, "root.json").signers(tuf::kRoot).key_ids ==
                                                checked.root().signers(tuf::kRoot).key_ids;
  const OsCalls os = system_calls();
  DurableDirectory place_directory{os, directory, 0700};
  if (!same_keys) {
    for (const auto& name : place_directory.names()) place_directory.remove_file(name);
  } else if (tuf::parse_root(before, "root.json").version > checked.root().version) {
    return;  // what has been seen since is newer
  }
  tuf::Client::trust(directory, root);
}

std::vector<TrustedPlace> trusted_marketplaces(const OpenOptions& options) {
  std::vector<TrustedPlace> places;
  std::error_code failure;
  for (filesystem::directory_iterator entry{trusted_places(options), failure};
       !failure && entry != filesystem::directory_iterator{}; entry.increment(failure)) {
    try {
      const tuf::Root root = tuf::parse_root(content_of_root(entry->path() / "root.json"), "root.json");
      const std::string name = entry->path().filename().string();
      auto& place = places.emplace_back();
      place.location = tuf::percent_decoded(name.substr(0, name.find('@')));
      place.expires = tuf::time_text(root.expires);
      for (const auto& id : root.signers(tuf::kRoot).key_ids) {
        const auto key = root.keys.find(id);
        const std::string open = key == root.keys.end() ? "" : key->second.open();
        place.root_keys.push_back(open.empty() ? "id " + id : open);
      }
    } catch (const Error&) {
      // Damaged: whoever opens that marketplace is told.
    }
  }
  std::ranges::sort(places, {}, &TrustedPlace::location);
  return places;
}

}  // namespace fiona::marketplace
