#include <fcntl.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/lock.hpp>
#include <fiona/marketplace/os_calls.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <set>

#include "durable.hpp"
#include "files.hpp"
#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

constexpr std::uint64_t kMostLockBytes = std::uint64_t{4} << 20;

void check(const LockedPackage& locked, const std::string& where) {
  const Requirement named = Requirement::parse(locked.package(), where);
  if (named.versions.bounds().empty() && Version::parse(locked.version()) && is_blake2b(locked.blake2b())) return;
  throw Error(ErrorCode::Failed, ErrorText{.what = "the lock of " + named.package + " is not whole",
                                           .where = where,
                                           .expected = "package, version, blake2b, marketplace",
                                           .next = "make it again: market lock"});
}

}  // namespace

Lock make_lock(const Store& store, const std::optional<std::vector<std::string>>& packages) {
  const auto installed = store.installed();
  std::vector<std::string> open;
  for (const auto& package : installed) {
    if (!packages) open.push_back(package.name());
  }
  if (packages) open = *packages;
  const std::set<std::string> asked{open.begin(), open.end()};
  std::set<std::string> needed;
  while (!open.empty()) {
    const std::string name = std::move(open.back());
    open.pop_back();
    if (!needed.insert(name).second) continue;
    const auto package = store.find(name);
    for (const auto& text : package.manifest.requirements()) open.push_back(Requirement::parse(text, name).package);
  }
  Lock lock;
  for (const auto& package : installed) {
    if (!needed.contains(package.name())) continue;
    LockedPackage& locked = *lock.add_packages();
    locked.set_package(package.name());
    locked.set_version(package.manifest.version());
    locked.set_blake2b(package.blake2b);
    locked.set_marketplace(package.source);
    locked.set_as_requirement(packages ? !asked.contains(package.name()) : package.as_requirement);
  }
  return lock;
}

void write_lock(const std::filesystem::path& file, const Lock& lock) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(lock, &text);
  const OsCalls os = system_calls();
  const std::filesystem::path absolute = std::filesystem::absolute(file);
  DurableDirectory{os, absolute.parent_path(), 0755}.replace(absolute.filename().string(), text);
}

Lock parse_lock(std::string_view text, const std::string& where) {
  Lock lock;
  parse_text(text, where, lock);
  for (const auto& locked : lock.packages()) check(locked, where);
  return lock;
}

Lock read_lock(const std::filesystem::path& path) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) {
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no such lock",
                                               .where = path.string(),
                                               .next = "market lock makes one of what is installed"});
  }
  return parse_lock(read_all(file, kMostLockBytes, path), path.string());
}

Lock part_of(const Lock& lock, const Marketplace& market) {
  std::set<std::string> there;
  for (const auto& entry : market.index().entries()) there.insert(entry.blake2b());
  Lock part;
  for (const auto& locked : lock.packages()) {
    if (there.contains(locked.blake2b())) *part.add_packages() = locked;
  }
  return part;
}

}  // namespace fiona::marketplace
