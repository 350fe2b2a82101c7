// What a publisher does: he signs packages, and hands them in.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <set>

#include "keeper_packages.hpp"
#include "keeper_parts.hpp"
#include "tuf/role_file.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

[[noreturn]] void refuse_unsigned(const filesystem::path& package, const std::string& publisher,
                                  const std::string& what) {
  throw Error(ErrorCode::BadSignature, ErrorText{.what = what,
                                                 .where = package.string(),
                                                 .expected = "a signature with the key of " + publisher,
                                                 .next = "fiona plugin sign " + package.string()});
}

void sign_after(const std::string& publisher, const filesystem::path& published, const KeeperOptions& options) {
  const auto file = content_if_there(published);
  const auto claimed = file ? tuf::claimed_key(*file, published.string()) : std::nullopt;
  if (!claimed) {
    throw Error(file ? ErrorCode::BadSignature : ErrorCode::NotFound,
                ErrorText{.what = file ? "this is not what a publisher has signed" : "there is no such file",
                          .where = published.string(),
                          .expected = "what a marketplace has of him: metadata/NUMBER." + publisher + ".json",
                          .next = "fetch it from there"});
  }
  const tuf::SigningKey key = options.keys.get(publisher);
  const tuf::RoleContent role = tuf::read_role(*file, *claimed, published.string());
  const auto kept = options.keys.signed_role(publisher);
  const std::int64_t last = kept ? tuf::read_role(*kept, key.open(), publisher + ".json").version : 0;
  const bool is_own = *claimed == key.open();
  if (is_own && last < role.version) return options.keys.keep_signed_role(publisher, *file);
  // What another key has signed for is that key's: of it the number counts, and nothing else.
  if (!is_own && last >= role.version) return;
  const std::int64_t next = tuf::version_after(std::max(last, role.version));
  const tuf::Time until = now_of(options) + options.lifetimes.targets;
  options.keys.keep_signed_role(publisher, tuf::next_role(is_own ? file : kept, key, {}, false, until, next));
}

}  // namespace

std::string signed_role(const std::string& publisher, const std::vector<ReadPackage>& packages, bool only,
                        const KeeperOptions& options) {
  const tuf::SigningKey key = options.keys.get(publisher);
  const auto before = options.keys.signed_role(publisher);
  const tuf::Time now = now_of(options);
  if (before) {
    const tuf::RoleContent role = tuf::read_role(*before, key.open(), publisher + ".json");
    const bool says_all =
        std::ranges::all_of(packages, [&](const auto& package) { return signs_for(role, package); }) &&
        (!only || role.targets.size() == packages.size());
    if (says_all && role.expires > now + options.lifetimes.targets / 2) return *before;
  }
  std::vector<tuf::TargetInfo> targets;
  for (const auto& package : packages) {
    targets.emplace_back().path = package.path;
    targets.back().length = package.entry.size();
    targets.back().hashes["sha256"] = package.sha256;
  }
  const std::string role = tuf::next_role(before, key, targets, only, now + options.lifetimes.targets);
  options.keys.keep_signed_role(publisher, role);
  return role;
}

filesystem::path sign_package(const filesystem::path& package, const KeeperOptions& options,
                              const filesystem::path& after) {
  const ReadPackage read = read_for_keeping(package, options);
  const std::string publisher = read.entry.manifest().publisher();
  options.keys.get(publisher);
  const SigningLock lock{options};
  if (!after.empty()) sign_after(publisher, after, options);
  const std::string role = signed_role(publisher, {read}, false, options);
  const OsCalls os = system_calls();
  const filesystem::path beside = filesystem::absolute(package).parent_path();
  DurableDirectory{os, beside, 0755}.replace(publisher + ".json", role);
  return beside / (publisher + ".json");
}

void unsign_package(const std::string& package, const KeeperOptions& options) {
  const std::size_t slash = package.find('/');
  if (slash == std::string::npos || package.find('@') == std::string::npos)
    throw Error(ErrorCode::Usage,
                ErrorText{.what = "this names no version of a package", .expected = "publisher/name@version"});
  const std::string publisher = package.substr(0, slash);
  const tuf::SigningKey key = options.keys.get(publisher);
  const SigningLock lock{options};
  const auto before = options.keys.signed_role(publisher);
  std::vector<tuf::TargetInfo> stay;
  std::set<std::string> known;
  std::size_t all = 0;
  for (const auto& target : before ? tuf::read_role(*before, key.open(), publisher + ".json").targets : stay) {
    ++all;
    known.insert(package_named(target.path));
    if (package_named(target.path) != package) stay.push_back(target);
  }
  if (stay.size() == all)
    throw Error(ErrorCode::NotFound,
                ErrorText{.what = "the key of " + publisher + " has not signed for " + package,
                          .where = options.keys.path().string(),
                          .expected = known.empty() ? "" : fmt::format("one of {}", fmt::join(known, ", ")),
                          .near = nearest_names(package, std::vector<std::string>{known.begin(), known.end()})});
  const tuf::Time until = now_of(options) + options.lifetimes.targets;
  options.keys.keep_signed_role(publisher, tuf::next_role(before, key, stay, true, until));
}

namespace {

std::optional<tuf::RoleContent> waiting_role(const filesystem::path& file, const tuf::OpenKey& key) {
  const auto content = content_if_there(file);
  if (!content) return std::nullopt;
  try {
    return tuf::read_role(*content, key, file.string());
  } catch (const Error&) {
    return std::nullopt;  // damaged, or somebody else's: it gives way
  }
}

void require_directory_of_market(const filesystem::path& market) {
  if (market.string().find("://") != std::string::npos)
    throw Error(ErrorCode::NotAllowed,
                ErrorText{.what = "a marketplace at an address is read there, and nothing can be handed in",
                          .where = market.string(),
                          .next = "give package and PUBLISHER.json to its keeper: fiona market publish FILE --to DIR"});
  std::error_code failure;
  if (filesystem::exists(market / "metadata", failure)) return;
  throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no marketplace here: it has no metadata",
                                             .where = market.string(),
                                             .next = "name another with --to DIR; fiona market init DIR makes one"});
}

/// Whether a publisher's file that waits already, as new as this one, signs for the package: it stays then.
bool signed_by_what_waits(const filesystem::path& file, const tuf::OpenKey& key, const std::string& role_file,
                          const ReadPackage& package) {
  const auto waiting = waiting_role(file, key);
  const std::int64_t version = tuf::read_role(role_file, key, file.string()).version;
  if (!waiting || waiting->version < version || content_if_there(file) == role_file) return false;
  if (signs_for(*waiting, package)) return true;
  throw Error(ErrorCode::NotAllowed,
              ErrorText{.what = "what was signed later waits there already, and does not sign for this package",
                        .where = file.string(),
                        .expected = fmt::format("a version after {}", waiting->version),
                        .found = fmt::format("version {}", version),
                        .next = "fiona plugin sign FILE after=" + file.string()});
}

}  // namespace

Submitted submit(const filesystem::path& package, const filesystem::path& market, const KeeperOptions& options) {
  require_directory_of_market(market);
  const ReadPackage read = read_for_keeping(package, options);
  const std::string publisher = read.entry.manifest().publisher(), name = publisher + ".json";
  const auto role_file = content_if_there(filesystem::absolute(package).parent_path() / name);
  if (!role_file) refuse_unsigned(package, publisher, "this package is not signed: there is no " + name + " beside it");
  const auto key = tuf::claimed_key(*role_file, name);
  if (!key || !signs_for(tuf::read_role(*role_file, *key, name), read)) {
    refuse_unsigned(package, publisher, name + " does not sign for this package");
  }
  const OsCalls os = system_calls();
  DurableDirectory incoming{os, filesystem::absolute(market) / "incoming", 0755};
  incoming.lock(std::chrono::seconds{10});
  const bool waits = signed_by_what_waits(incoming.path() / name, *key, *role_file, read);
  copy_checked(package, read.sha256, incoming, read.entry.file());
  if (!waits) incoming.replace(name, *role_file);
  return {publisher, read.entry.file()};
}

}  // namespace fiona::marketplace
