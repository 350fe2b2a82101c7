#include <fcntl.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/message_differencer.h>
#include <sys/file.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>
#include <optional>
#include <set>

#include "durable.hpp"
#include "files.hpp"
#include "installed.hpp"
#include "staging.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr std::string_view kStaging = "staging-";

std::string hash_of(const fiona::InstalledPackage& package) {
  return filesystem::path(package.directory()).filename().string();
}

// A store that is being changed by us alone.
class StoreChange {
 public:
  StoreChange(const filesystem::path& store, const InstallOptions& options)
      : options_(options), store_(options_.os, store, 0700) {
    store_.lock(options_.lock_wait);
    packages_.emplace(store_.child(std::string(kPackagesDirectory), 0700));
    installed_ = read_installed(store_.path());
    sweep();
  }

  fiona::InstalledPackage* find(const std::string& name) {
    for (auto& package : *installed_.mutable_packages()) {
      if (full_name(package.manifest()) == name) return &package;
    }
    return nullptr;
  }

  bool is_whole(const Manifest& manifest, const std::string& blake2b) const {
    InstalledPackage package;
    package.manifest = manifest;
    package.directory = packages_->path() / blake2b;
    try {
      Store{store_.path()}.verify(package);
      return true;
    } catch (const Error& error) {
      if (error.code() != ErrorCode::BadSignature) throw;
      return false;
    }
  }

  // Unpacks into a staging directory, and makes that the package's own. Nothing of it is left if it fails.
  void add_files(const Marketplace& from, const IndexEntry& entry) {
    const std::string& hash = entry.blake2b();
    // A package that was taken out while somebody holds it is still there, and stays where its holder sees
    // it.
    if (packages_->has(hash) && is_whole(entry.manifest(), hash)) return;
    const std::string staging = std::string(kStaging) + hash.substr(0, 16);
    try {
      unpack(from, entry, staging);
      if (packages_->has(hash)) packages_->move(hash, store_, std::string(kStaging) + "damaged-" + hash.substr(0, 16));
      store_.move(staging, *packages_, hash);
    } catch (...) {
      store_.remove_tree_quietly(staging);
      drop_unlisted(hash);
      throw;
    }
  }

  // The moment at which the change is seen.
  void commit() {
    installed_.set_generation(installed_.generation() + 1);
    std::ranges::sort(*installed_.mutable_packages(), {},
                      [](const auto& package) { return full_name(package.manifest()); });
    std::string text;
    google::protobuf::TextFormat::PrintToString(installed_, &text);
    store_.replace(std::string(kInstalledFile), text);
  }

  void drop_unlisted(const std::string& blake2b) noexcept {
    try {
      if (!listed().contains(blake2b)) packages_->remove_tree_quietly(blake2b);
    } catch (const std::exception&) {
      // The list cannot be read: rather keep files than lose some that are in use.
    }
  }

  Installed& installed() { return installed_; }
  filesystem::path path() const { return store_.path(); }

 private:
  std::set<std::string> listed() const {
    std::set<std::string> hashes;
    const Installed list = read_installed(store_.path());
    for (const auto& package : list.packages()) hashes.insert(hash_of(package));
    return hashes;
  }

  // What a crash or a removal left, unless somebody holds it.
  void sweep() const {
    store_.remove_file(std::string(kInstalledFile) + ".new");
    for (const auto& name : store_.names()) {
      if (name.starts_with(kStaging) && !is_held(store_, name)) store_.remove_tree(name);
    }
    const auto wanted = listed();
    for (const auto& name : packages_->names()) {
      if (wanted.contains(name) || is_held(*packages_, name)) continue;
      // Out of sight first: a directory of this name is whole at all times.
      const std::string aside = std::string(kStaging) + "old-" + name.substr(0, 16);
      store_.remove_tree(aside);
      packages_->move(name, store_, aside);
      store_.remove_tree(aside);
    }
  }

  bool is_held(const DurableDirectory& parent, const std::string& name) const {
    const FileDescriptor directory{
        ::openat(parent.descriptor(), name.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC)};
    return directory && options_.os.flock(directory.number(), LOCK_EX | LOCK_NB) != 0;
  }

  void unpack(const Marketplace& from, const IndexEntry& entry, const std::string& name) const {
    const filesystem::path path = from.directory() / entry.file();
    const FileDescriptor file = open_regular(AT_FDCWD, path, path);
    if (!file) {
      throw Error(ErrorCode::NotFound,
                  ErrorText{.what = "the marketplace's index names a package that is not there",
                            .where = path.string(),
                            .next = "publish it again, or choose another marketplace with --from"});
    }
    StagingSink sink{store_, name};
    const auto source = [&](char* buffer, std::size_t size) { return read_some(file.number(), buffer, size, path); };
    const PackageContents contents = read_package(source, path.filename().string(), sink, options_.limits);
    check_is(entry, contents, path);
    sink.finish();
  }

  static void check_is(const IndexEntry& entry, const PackageContents& contents, const filesystem::path& path) {
    const bool same = contents.blake2b == entry.blake2b() && contents.size == entry.size() &&
                      google::protobuf::util::MessageDifferencer::Equals(contents.manifest, entry.manifest());
    if (same) return;
    throw Error(ErrorCode::BadSignature,
                ErrorText{.what = "the package is not the one that the index describes",
                          .where = path.string(),
                          .expected = entry.blake2b(),
                          .found = contents.blake2b,
                          .next = "publish it again, or choose another marketplace with --from"});
  }

  const InstallOptions& options_;
  DurableDirectory store_;
  std::optional<DurableDirectory> packages_;
  Installed installed_;
};

bool is_newer(const Manifest& a, const Manifest& b) {
  return *Version::parse(a.version()) > *Version::parse(b.version());
}

fiona::InstalledPackage listing(const Marketplace& from, const IndexEntry& entry) {
  fiona::InstalledPackage listed;
  *listed.mutable_manifest() = entry.manifest();
  listed.set_directory(std::string(kPackagesDirectory) + "/" + entry.blake2b());
  listed.set_source(from.directory().string());
  return listed;
}

}  // namespace

InstallResult install(std::string_view request, const Marketplace& from, const filesystem::path& store,
                      const InstallOptions& options) {
  const IndexEntry entry = from.select(request);
  const std::string name = full_name(entry.manifest());
  StoreChange change{store, options};
  const auto result = [&](InstallOutcome outcome, const std::string& previous) {
    return InstallResult{outcome, Store{change.path()}.find(name), previous};
  };
  fiona::InstalledPackage* present = change.find(name);
  const auto wanted = listing(from, entry);
  const std::string previous = present ? present->manifest().version() : "";
  const bool same = present && present->directory() == wanted.directory();
  const bool newer =
      present && request.find('@') == std::string_view::npos && is_newer(present->manifest(), entry.manifest());
  if ((same || newer) && change.is_whole(present->manifest(), hash_of(*present)))
    return result(InstallOutcome::AlreadyInstalled, previous);
  change.add_files(from, entry);
  present = present ? present : change.installed().add_packages();
  *present = wanted;
  try {
    change.commit();
  } catch (...) {
    change.drop_unlisted(entry.blake2b());
    throw;
  }
  if (same) return result(InstallOutcome::Repaired, previous);
  return result(previous.empty() ? InstallOutcome::Installed : InstallOutcome::Replaced, previous);
}

InstalledPackage remove(std::string_view name, const filesystem::path& store, const InstallOptions& options) {
  InstalledPackage package = Store{store}.find(name);  // before a store is made that only gets locked
  StoreChange change{store, options};
  package = Store{store}.find(package.name());
  auto& packages = *change.installed().mutable_packages();
  packages.erase(
      std::ranges::find_if(packages, [&](const auto& entry) { return full_name(entry.manifest()) == package.name(); }));
  change.commit();
  return package;
}

}  // namespace fiona::marketplace
