// Who signs what in a marketplace, and how that changes.
#include <fcntl.h>
#include <fmt/format.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <map>

#include "files.hpp"
#include "keeper_packages.hpp"
#include "keeper_parts.hpp"
#include "signed_market.hpp"

namespace fiona::marketplace {

namespace filesystem = std::filesystem;

tuf::Time now_of(const KeeperOptions& options) {
  return options.now ? options.now() : std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
}

filesystem::path place_of(const filesystem::path& market) {
  const filesystem::path place = filesystem::absolute(market).lexically_normal();
  return place.has_filename() ? place : place.parent_path();
}

std::string key_name_of(const filesystem::path& place) {
  constexpr std::size_t kLongest = 60;  // of a key's name 80, with role and number
  std::string name;
  for (char c : place.filename().string().substr(0, kLongest)) {
    c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
    const bool fits = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '.';
    name += fits ? c : '-';
  }
  return !name.empty() && name[0] >= 'a' && name[0] <= 'z' ? name : "market" + name;
}

tuf::RepositoryOptions repository_options(const filesystem::path& market, const KeeperOptions& options) {
  const filesystem::path place = place_of(market);
  const filesystem::path trusted =
      options.trusted.empty() ? options.keys.path() / "kept" / tuf::percent_encoded(place.string()) : options.trusted;
  return {.directory = place, .trusted = trusted, .lifetimes = options.lifetimes, .now = options.now};
}

std::optional<std::string> content_if_there(const filesystem::path& path) {
  constexpr std::uint64_t kMostRoleFileBytes = 8 << 20;
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) return std::nullopt;
  return read_all(file, kMostRoleFileBytes, path);
}

namespace {

bool is_top_level(const std::string& role) { return role == "root" || role == "targets" || role == "online"; }

const std::vector<std::string>& top_level_of(const std::string& role) {
  static const std::map<std::string, std::vector<std::string>> kRoles{
      {"root", {"root"}}, {"targets", {"targets"}}, {"online", {"snapshot", "timestamp"}}};
  const auto found = kRoles.find(role);
  if (found != kRoles.end()) return found->second;
  throw Error(ErrorCode::Usage,
              ErrorText{.what = "a marketplace has no role '" + role + "'", .expected = "root, targets or online"});
}

// A key of this user by its name, or of somebody else as he gives it.
tuf::OpenKey key_named(const std::string& text, const KeeperOptions& options) {
  return tuf::is_open_key(text) ? text : options.keys.get(text).open();
}

std::string new_key_name(const std::string& market, const std::string& role, const KeeperOptions& options) {
  const auto names = options.keys.names();
  for (int number = 2;; ++number) {
    const std::string name = fmt::format("{}.{}-{}", market, role, number);
    if (std::ranges::find(names, name) == names.end()) return name;
  }
}

// What the keys are called that sign now: those of another marketplace of the same last name are called otherwise.
std::string name_of_keys(const tuf::Repository& repository, const filesystem::path& market, const std::string& role,
                         const KeeperOptions& options) {
  const auto signs = repository.keys_of(top_level_of(role).back()).keys;
  for (const std::string& name : options.keys.names()) {
    const std::size_t end = name.rfind("." + role);
    try {
      if (end != std::string::npos && std::ranges::find(signs, options.keys.get(name).open()) != signs.end())
        return name.substr(0, end);
    } catch (const Error&) {  // one that cannot be read signs nothing
    }
  }
  return key_name_of(place_of(market));
}

// As far as the keys here reach.
RootChange carry_on(const filesystem::path& market, RootChange change, const KeeperOptions& options) {
  bool may_commit = false;
  {
    const tuf::Repository repository{repository_options(market, options), options.keys};
    change.lacking = repository.proposal_lacks().value_or(0);
    may_commit = repository.may_commit();
  }
  if (change.lacking == 0 && may_commit) accept(market, {}, options);
  return change;
}

// Who keeps nothing but one of its keys trusts a marketplace as a user does.
void begin_as_user(const tuf::RepositoryOptions& how, const KeeperOptions& options) {
  std::error_code failure;
  if (filesystem::exists(how.trusted / "root.json", failure)) return;
  const std::string place = how.directory.string();
  const auto root =
      content_if_there(options.keys.path().parent_path() / "markets" / tuf::percent_encoded(place) / "root.json");
  if (!root) {
    throw Error(
        ErrorCode::NotFound,
        ErrorText{.what = "nobody has said that this marketplace is to be trusted, so its roots cannot be checked",
                  .where = place,
                  .next = "fiona keys trust ROOT.json --from " + place});
  }
  tuf::Client::trust(how.trusted, *root);
}

}  // namespace

std::vector<MarketRole> market_roles(const filesystem::path& market, const KeeperOptions& options) {
  const tuf::RepositoryOptions how = repository_options(market, options);
  begin_as_user(how, options);
  const tuf::Repository repository{how, options.keys};
  const auto expires = [&repository](const std::string& role) -> std::string {
    try {
      return repository.expires(role);
    } catch (const Error&) {
      return "";  // damaged in the marketplace, as `accept` says; the others are shown
    }
  };
  std::vector<MarketRole> roles;
  for (const std::string role : {"root", "targets", "online"}) {
    const std::string& first = top_level_of(role).back();
    MarketRole& added = roles.emplace_back(MarketRole{role, repository.keys_of(first), {}, expires(first)});
    const auto proposed = repository.proposed(first);
    if (!proposed || (proposed->keys == added.keys.keys && proposed->threshold == added.keys.threshold)) continue;
    added.proposed = proposed;
  }
  for (const auto& publisher : repository.delegated_roles()) {
    if (publisher != kIndexRole) roles.push_back({publisher, repository.keys_of(publisher), {}, expires(publisher)});
  }
  return roles;
}

RootChange rotate(const filesystem::path& market, const std::string& role, const std::vector<std::string>& keys,
                  std::int64_t threshold, const KeeperOptions& options) {
  const auto& roles = top_level_of(role);
  if (threshold > 1 && role != "root") {
    throw Error(ErrorCode::Usage,
                ErrorText{.what = "several signatures are for the root, whose holders sign one after the other",
                          .expected = "a threshold of 1 for " + role});
  }
  RootChange change;
  tuf::Repository::RoleKeys wanted{{}, threshold};
  for (const auto& key : keys) wanted.keys.push_back(key_named(key, options));
  {
    tuf::Repository repository{repository_options(market, options), options.keys};
    if (keys.empty()) {
      change.made.push_back(new_key_name(name_of_keys(repository, market, role, options), role, options));
      wanted.keys.push_back(options.keys.make(change.made.back()).open());
    }
    repository.propose(roles, wanted);
    repository.sign_proposed();
  }
  return carry_on(market, std::move(change), options);
}

RootChange sign_root(const filesystem::path& market, const std::vector<MarketRole>& seen,
                     const KeeperOptions& options) {
  {
    const tuf::Repository repository{repository_options(market, options), options.keys};
    for (const MarketRole& role : seen) {
      for (const auto& top_level : is_top_level(role.name) ? top_level_of(role.name) : std::vector<std::string>{}) {
        const auto keys = repository.proposed(top_level);
        const auto& expected = role.proposed ? *role.proposed : role.keys;
        if (!keys || (keys->keys == expected.keys && keys->threshold == expected.threshold)) continue;
        throw Error(ErrorCode::BadSignature, ErrorText{.what = "another root has been proposed meanwhile",
                                                       .next = "look at it: fiona market keys"});
      }
    }
    repository.sign_proposed();
  }
  return carry_on(market, {}, options);
}

tuf::OpenKey renew_key(const std::string& publisher, const KeeperOptions& options) {
  const tuf::SigningKey former = options.keys.get(publisher);
  const SigningLock lock{options};
  const auto before = options.keys.signed_role(publisher);
  if (before) tuf::read_role(*before, former.open(), publisher + ".json");
  const tuf::SigningKey key = options.keys.renew(publisher);
  if (before) {
    const tuf::Time until = now_of(options) + options.lifetimes.targets;
    options.keys.keep_signed_role(publisher, tuf::next_role(before, key, {}, false, until));
  }
  return key.open();
}

}  // namespace fiona::marketplace
