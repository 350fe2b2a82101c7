#include <dirent.h>
#include <fcntl.h>
#include <google/protobuf/util/message_differencer.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/store.hpp>
#include <set>

#include "files.hpp"
#include "installed.hpp"
#include "names.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

InstalledPackage located(const filesystem::path& store, const fiona::InstalledPackage& entry) {
  InstalledPackage package;
  package.manifest = entry.manifest();
  package.directory = store / entry.directory();
  if (!entry.manifest().library().empty()) package.library = package.directory / entry.manifest().library();
  package.share = package.directory / "share";
  package.blake2b = package.directory.filename().string();
  package.source = entry.source();
  package.as_requirement = entry.as_requirement();
  package.first_party = entry.first_party();
  return package;
}

[[noreturn]] void refuse_damaged(const InstalledPackage& package, const std::string& what, std::string expected = {},
                                 std::string found = {}) {
  throw Error(ErrorCode::BadSignature,
              ErrorText{.what = "the installed package " + package.name() + " is damaged: " + what,
                        .where = package.directory.string(),
                        .expected = std::move(expected),
                        .found = std::move(found),
                        .next = "market install " + package.name() + "@" + package.manifest.version() +
                                from_option(package.source)});
}

// Opens a listed file, whose path the manifest's check has found harmless, or refuses.
FileDescriptor open_listed(const InstalledPackage& package, const std::string& path) {
  const filesystem::path shown = package.directory / path;
  FileDescriptor file;
  try {
    file = open_regular(AT_FDCWD, shown, shown);
  } catch (const Error& error) {
    refuse_damaged(package, path + " cannot be read: " + error.text().what);
  }
  if (!file) refuse_damaged(package, path + " is missing");
  return file;
}

void verify_file(const InstalledPackage& package, const PackageFile& listed) {
  const FileDescriptor file = open_listed(package, listed.path());
  if (size_of(file) != listed.size()) {
    refuse_damaged(package, listed.path() + " has another size", std::to_string(listed.size()) + " bytes",
                   std::to_string(size_of(file)) + " bytes");
  }
  Blake2b hash;
  std::array<char, 1 << 16> buffer;
  while (const std::size_t count = read_some(file.number(), buffer.data(), buffer.size(), package.directory)) {
    hash.update({buffer.data(), count});
  }
  if (const std::string found = hash.finish(); found != listed.blake2b()) {
    refuse_damaged(package, listed.path() + " has other content", listed.blake2b(), found);
  }
}

void verify_manifest(const InstalledPackage& package) {
  const FileDescriptor file = open_listed(package, std::string(kManifestFile));
  try {
    const Manifest manifest =
        parse_manifest(read_all(file, PackageLimits{}.manifest_bytes, package.directory), std::string(kManifestFile));
    if (google::protobuf::util::MessageDifferencer::Equals(manifest, package.manifest)) return;
  } catch (const Error& error) {
    refuse_damaged(package, error.what());
  }
  refuse_damaged(package, "its manifest is not the one that was installed");
}

void verify_nothing_else(const InstalledPackage& package) {
  std::set<std::string> known{std::string(kManifestFile)};
  for (const auto& file : package.manifest.files()) {
    for (std::size_t slash = 0; slash != std::string::npos;) {
      slash = file.path().find('/', slash + 1);
      known.insert(file.path().substr(0, slash));
    }
  }
  std::error_code failure;
  filesystem::recursive_directory_iterator entry{package.directory, failure};
  for (; !failure && entry != filesystem::recursive_directory_iterator{}; entry.increment(failure)) {
    const std::string path = entry->path().lexically_relative(package.directory).string();
    if (!known.contains(path)) refuse_damaged(package, path + " does not belong to it");
  }
  if (failure) refuse_damaged(package, "it cannot be read: " + failure.message());
}

}  // namespace

Interface InstalledPackage::interface() const {
  const std::string path{kInterfaceFile};
  const std::string text = read_all(open_listed(*this, path), PackageLimits{}.interface_bytes, directory / path);
  const auto listed = std::ranges::find_if(manifest.files(), [&](const auto& file) { return file.path() == path; });
  if (listed == manifest.files().end() || fiona::marketplace::blake2b(text) != listed->blake2b()) {
    refuse_damaged(*this, path + " has other content");
  }
  return parse_interface(text, (directory / path).string());
}

PackageHold::~PackageHold() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

Store::Store(filesystem::path directory, Kind kind)
    : directory_(filesystem::absolute(directory).lexically_normal()), kind_(kind) {}

filesystem::path Store::default_directory() {
  const auto variable = [](const char* name) { return filesystem::path(std::getenv(name) ? std::getenv(name) : ""); };
  if (const auto store = variable("FIONA_STORE"); !store.empty()) return store;
  // The XDG base directory specification: a relative path is to be ignored.
  if (const auto data = variable("XDG_DATA_HOME"); data.is_absolute()) return data / "fiona/store";
  if (const auto home = variable("HOME"); home.is_absolute()) return home / ".local/share/fiona/store";
  throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no place for installed packages: HOME is not set",
                                             .next = "set FIONA_STORE to a directory"});
}

std::vector<InstalledPackage> Store::installed() const { return all_of(read_installed(directory_)); }

std::vector<InstalledPackage> Store::all_of(const Installed& list) const {
  std::vector<InstalledPackage> packages;
  for (const auto& entry : list.packages()) {
    packages.push_back(located(directory_, entry));
    packages.back().is_unsigned = kind_ == Kind::Unsigned;
  }
  std::ranges::sort(packages, {}, &InstalledPackage::name);
  return packages;
}

InstalledPackage Store::find(std::string_view name) const { return chosen(installed(), name, directory_); }

InstalledPackage Store::chosen(const std::vector<InstalledPackage>& packages, std::string_view name,
                               const filesystem::path& where) {
  std::set<std::string> known;
  for (const auto& package : packages) known.insert(package.name());
  const std::string next = name.starts_with("unsigned/") ? "fiona run … --unsigned DIR, of a folder that has its .fpk"
                                                         : "market install " + std::string(name);
  const std::string full = resolve_name(name, known, "there is no installed package", where.string(), next);
  return *std::ranges::find(packages, full, &InstalledPackage::name);
}

std::vector<InstalledPackage> Store::installed_with(std::string_view name, std::string_view version) const {
  const auto has_it = [&](const std::vector<InstalledPackage>& packages) {
    return std::ranges::any_of(packages, [&](const InstalledPackage& package) {
      return package.name() == name && package.manifest.version() == version;
    });
  };
  if (auto packages = installed(); has_it(packages)) return packages;
  auto numbers = kept_generations(directory_);
  std::ranges::sort(numbers, std::ranges::greater{});
  for (const auto number : numbers) {
    try {
      if (auto packages = all_of(read_generation(directory_, number)); has_it(packages)) return packages;
    } catch (const Error&) {  // it cannot be gone back to: history() says why
    }
  }
  return {};
}

std::vector<Revocation> Store::revoked() const {
  const Revocations revoked = read_revocations(directory_);
  return {revoked.packages().begin(), revoked.packages().end()};
}

std::optional<Revocation> Store::revocation(const InstalledPackage& package) const {
  for (const auto& one : revoked()) {
    if (one.blake2b() == package.blake2b && one.marketplace() == package.source) return one;
  }
  return std::nullopt;
}

void Store::require_not_revoked(const InstalledPackage& package) const {
  const auto revoked = revocation(package);
  if (!revoked) return;
  throw Error(ErrorCode::BadSignature,
              ErrorText{.what = package.name() + " " + package.manifest.version() + " has been revoked: " +
                                (revoked->reason().empty() ? "no reason is given" : revoked->reason()),
                        .where = revoked->marketplace(),
                        .expected = "a version that its marketplace stands by",
                        .next = "market update " + package.name() + ", or market remove " + package.name()});
}

std::vector<Generation> Store::history() const {
  const auto described = [](const Installed& list) {
    return Generation{.number = list.generation(),
                      .time_s = list.time_s(),
                      .change = list.change(),
                      .packages = static_cast<std::size_t>(list.packages_size())};
  };
  std::vector<Generation> found;
  const Installed now = read_installed(directory_);
  if (now.generation() > 0) found.push_back(described(now));
  for (auto& one : found) one.present = true;
  for (const auto number : kept_generations(directory_)) {
    if (number == now.generation()) continue;
    try {
      found.push_back(described(read_generation(directory_, number)));
    } catch (const Error& error) {
      found.push_back({.number = number, .fault = error.text().what});
    }
  }
  std::ranges::sort(found, std::ranges::greater{}, &Generation::number);
  return found;
}

void Store::verify(const InstalledPackage& package) const {
  verify_manifest(package);
  for (const auto& file : package.manifest.files()) verify_file(package, file);
  verify_nothing_else(package);
}

PackageHold Store::hold(const InstalledPackage& package) const {
  FileDescriptor directory = open_directory(AT_FDCWD, package.directory, package.directory);
  // Under the lock, look again: a sweep may have removed the directory between opening and locking it.
  if (directory && ::flock(directory.number(), LOCK_SH | LOCK_NB) == 0) {
    struct stat status {};
    if (::fstat(directory.number(), &status) == 0 && status.st_nlink > 0) return PackageHold{directory.release()};
  }
  throw Error(ErrorCode::NotFound,
              ErrorText{.what = package.name() + " " + package.manifest.version() + " is no longer installed",
                        .where = package.directory.string(),
                        .next = "market install " + package.name() + from_option(package.source)});
}

}  // namespace fiona::marketplace
