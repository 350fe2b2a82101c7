// What a keeper does with what has come, and with what should not have.
#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <map>
#include <optional>
#include <set>

#include "durable.hpp"
#include "files.hpp"
#include "index_file.hpp"
#include "keeper_packages.hpp"
#include "keeper_parts.hpp"
#include "signed_market.hpp"
#include "text_check.hpp"
#include "tuf/digest.hpp"
#include "tuf/metadata.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr std::string_view kPackageEnding = ".fpk";
constexpr std::chrono::days kWarnedBefore{30};
constexpr std::int64_t kMostSignatures = 1'000'000;  // of a publisher between two acceptances

Withdrawal withdrawal_of(const IndexEntry& entry) {
  Withdrawal withdrawn;
  withdrawn.set_package(full_name(entry.manifest()));
  withdrawn.set_version(entry.manifest().version());
  withdrawn.set_architecture(entry.manifest().architecture());
  withdrawn.set_blake2b(entry.blake2b());
  return withdrawn;
}

template <class Entries, class Predicate>
void erase_if(Entries& entries, const Predicate& is_meant) {
  entries.erase(std::remove_if(entries.begin(), entries.end(), is_meant), entries.end());
}

// One acceptance: the marketplace as it is, and what it is to become.
class Acceptance {
 public:
  Acceptance(const filesystem::path& market, const KeeperOptions& options)
      : options_(options),
        how_(repository_options(market, options)),
        repository_(how_, options.keys),
        directory_(os_, how_.directory, 0755),
        incoming_(directory_.child("incoming", 0755)),
        targets_(directory_.child("targets", 0755)) {
    incoming_.lock(std::chrono::seconds{10});
    read_market_index();
  }

  std::vector<Revocation> revoke(const std::string& what, const std::string& reason) {
    const std::size_t at = what.find('@');
    const std::string name = what.substr(0, at), version = at == std::string::npos ? "" : what.substr(at + 1);
    const bool is_publisher = name.find('/') == std::string::npos;
    std::vector<Revocation> revoked;
    const auto is_meant = [&](const std::string& package, const std::string& its_version) {
      return (is_publisher ? package.substr(0, package.find('/')) : package) == name &&
             (version.empty() || its_version == version);
    };
    const auto is_meant_entry = [&](const IndexEntry& entry) {
      return is_meant(full_name(entry.manifest()), entry.manifest().version());
    };
    const auto is_meant_withdrawal = [&](const Withdrawal& one) { return is_meant(one.package(), one.version()); };
    for (const IndexEntry& entry : index_.entries()) {
      if (is_meant_entry(entry)) revoked.push_back(revocation_of(withdrawal_of(entry), reason));
    }
    // Who has what was withdrawn has it still.
    for (const Withdrawal& one : index_.withdrawn()) {
      if (is_meant_withdrawal(one)) revoked.push_back(revocation_of(one, reason));
    }
    const bool known = !revoked.empty() || (is_publisher && !repository_.key_ids_of(name).empty());
    if (!known || (is_publisher && !version.empty())) refuse_unknown(what);
    erase_if(*index_.mutable_entries(), is_meant_entry);
    erase_if(*index_.mutable_withdrawn(), is_meant_withdrawal);
    for (const Revocation& one : revoked) *index_.add_revoked() = one;
    index_.set_generation(index_.generation() + 1);
    if (is_publisher && !repository_.key_ids_of(name).empty()) repository_.undelegate(name);
    write_market_index();
    follow_online_keys();
    repository_.commit();
    remove_unlisted_targets();
    return revoked;
  }

  Accepted run(const std::vector<Welcome>& welcome) {
    for (const auto& name : incoming_.names()) read_incoming(name);
    for (const auto& name : incoming_.names()) {
      if (!name.ends_with(".json")) continue;
      try {
        take_publisher(name, welcome);
      } catch (const Error& error) {
        refuse(name, error.text().what, error.text().next);
      } catch (const std::exception& error) {  // one publisher's file holds up nobody else
        refuse(name, error.what(), "its publisher is to sign with fiona plugin sign");
      }
    }
    look_at_packages_left();
    write_market_index();
    follow_online_keys();
    repository_.commit();
    for (const auto& name : done_) incoming_.remove_file(name);
    remove_unlisted_targets();
    look_at_ends();
    return std::move(result_);
  }

 private:
  Revocation revocation_of(const Withdrawal& package, const std::string& reason) const {
    Revocation revoked;
    revoked.set_package(package.package());
    revoked.set_version(package.version());
    revoked.set_blake2b(package.blake2b());
    revoked.set_reason(reason);
    revoked.set_time_s(now_of(options_).time_since_epoch().count());
    return revoked;
  }

  [[noreturn]] void refuse_unknown(const std::string& what) const {
    std::set<std::string> known;
    for (const auto& entry : index_.entries()) {
      known.insert({entry.manifest().publisher(), full_name(entry.manifest()),
                    full_name(entry.manifest()) + "@" + entry.manifest().version()});
    }
    for (const auto& one : index_.withdrawn()) known.insert({one.package(), one.package() + "@" + one.version()});
    throw Error(ErrorCode::NotFound,
                ErrorText{.what = "the marketplace offers nothing that is called " + what,
                          .where = how_.directory.string(),
                          .expected = "a publisher, publisher/name, or publisher/name@version",
                          .next = "fiona market search --from " + how_.directory.string(),
                          .near = nearest_names(what, std::vector<std::string>{known.begin(), known.end()})});
  }

  // Neither these bytes nor this version come back. Empty: nobody has revoked it.
  std::string revocation_fault(const IndexEntry& entry) const {
    for (const auto& one : index_.revoked()) {
      const bool same_version =
          one.package() == full_name(entry.manifest()) && one.version() == entry.manifest().version();
      if (!same_version && one.blake2b() != entry.blake2b()) continue;
      return fmt::format("{} {} has been revoked{}", one.package(), one.version(),
                         one.reason().empty() ? "" : ": " + one.reason());
    }
    return {};
  }

  void read_market_index() {
    for (const auto& target : repository_.targets_of(std::string(kIndexRole))) {
      if (target.path != kIndexFile) continue;
      const std::string name = target.hashes.at("sha256") + "." + target.path;
      const auto bytes = index_bytes(name);
      if (tuf::sha256_hex(bytes) != target.hashes.at("sha256")) {
        throw Error(ErrorCode::BadSignature, ErrorText{.what = "the marketplace's index is not the one that was signed",
                                                       .where = (targets_.path() / name).string(),
                                                       .next = "bring it back from a copy"});
      }
      index_file_ = name;
      try {
        index_ = parse_index(bytes, name);
      } catch (const Error&) {
        if (!options_.replace) throw;  // a build's own of an older format: it is filled again
      }
    }
  }

  std::string index_bytes(const std::string& name) const {
    const FileDescriptor file = open_regular(targets_.descriptor(), name, targets_.path() / name);
    if (!file)
      throw Error(ErrorCode::NotFound, ErrorText{.what = "the marketplace has lost its index",
                                                 .where = (targets_.path() / name).string(),
                                                 .next = "bring it back from a copy"});
    return read_all(file, kMostIndexFileBytes, targets_.path() / name);
  }

  void read_incoming(const std::string& name) {
    if (!name.ends_with(kPackageEnding)) return;
    try {
      packages_.emplace(name, read_for_keeping(incoming_.path() / name, options_));
    } catch (const Error& error) {
      refuse(name, error.text().what, error.text().next);
    }
  }

  void take_publisher(const std::string& file_name, const std::vector<Welcome>& welcome) {
    const std::string publisher = file_name.substr(0, file_name.size() - 5);
    const std::string role_file = content_if_there(incoming_.path() / file_name).value_or("");
    const auto key = tuf::claimed_key(role_file, file_name);
    if (!is_publisher(publisher) || !key) {
      return refuse(file_name, "it does not say which key has signed it",
                    "its publisher is to sign with fiona plugin sign");
    }
    const tuf::RoleContent role = tuf::read_role(role_file, *key, file_name);
    const auto known = repository_.key_ids_of(publisher);
    const bool is_known = known == std::vector<std::string>{tuf::key_id_of(*key)};
    const auto is_welcome = [&](const Welcome& one) { return one.name == publisher && one.key == *key; };
    if (!is_known && std::ranges::none_of(welcome, is_welcome)) {
      result_.unknown.push_back({publisher, *key, !known.empty()});
      return;
    }
    if (is_known && says_what_is_here(publisher, role)) return done_.push_back(file_name);
    if (const auto fault = role_fault(publisher, role)) return refuse(file_name, fault->what, fault->next);
    take_packages(publisher, role);
    // Not before: a publisher whose file is not taken keeps the key that his file here is signed with.
    if (!is_known) repository_.delegate(publisher, {*key}, {publisher + "/*"});
    repository_.take_role(publisher, role_file);
    done_.push_back(file_name);
  }

  bool says_what_is_here(const std::string& publisher, const tuf::RoleContent& role) const {
    if (role.version != repository_.version_of(publisher)) return false;
    const auto here = repository_.targets_of(publisher);
    const auto is_here = [&here](const tuf::TargetInfo& target) {
      const auto* found = find_target(here, target.path);
      return found != nullptr && found->hashes.at("sha256") == target.hashes.at("sha256");
    };
    return role.targets.size() == here.size() && std::ranges::all_of(role.targets, is_here);
  }

  void refuse(const std::string& file, const std::string& what, const std::string& next) {
    result_.refused.push_back({file, what, next});
  }

  /// "fiona plugin sign FILE after=…": with that a publisher goes on from what is here.
  std::string sign_after(const std::string& publisher) const {
    const auto here =
        how_.directory / "metadata" / fmt::format("{}.{}.json", repository_.version_of(publisher), publisher);
    return "fiona plugin sign FILE after=" + here.string();
  }

  // What has keys here was signed anew; the rest is for others to sign.
  void look_at_ends() {
    std::vector<std::string> roles = repository_.delegated_roles();
    std::erase(roles, kIndexRole);
    roles.insert(roles.begin(), {std::string(tuf::kRoot), std::string(tuf::kTargets)});
    for (const auto& role : roles) {
      try {
        const std::string until = repository_.expires(role);
        if (until.empty() || tuf::parse_time(until, role) > now_of(options_) + kWarnedBefore) continue;
        result_.ending.push_back({role, until, tuf::parse_time(until, role) <= now_of(options_), next_signature(role)});
      } catch (const Error& error) {  // damaged in the marketplace
        refuse(role, error.text().what, next_signature(role));
      }
    }
  }

  std::string next_signature(const std::string& role) const {
    const std::string market = how_.directory.string();
    if (role != tuf::kRoot && role != tuf::kTargets)
      return role + " is to sign again: fiona plugin sign FILE, then fiona market publish FILE";
    const auto keys = repository_.keys_of(role);
    if (keys.threshold == 1) return "who has its key: fiona market accept " + market;
    return fmt::format("fiona market rotate {} {} {} threshold={}, then each of them: fiona market sign {}", market,
                       role, fmt::join(keys.keys, " "), keys.threshold, market);
  }

  // Those that wait with their publisher's file have been told of with that.
  void look_at_packages_left() {
    const std::set<std::string> done{done_.begin(), done_.end()};
    for (const auto& [name, package] : packages_) {
      const std::string publisher = package.entry.manifest().publisher(), role_file = publisher + ".json";
      if (done.contains(name) || (incoming_.has(role_file) && !done.contains(role_file))) continue;
      if (is_here(publisher, package)) {
        done_.push_back(name);
      } else {
        refuse(name, "its publisher does not sign for it",
               "he is to sign for it and hand it in again; or remove it: " + (incoming_.path() / name).string());
      }
    }
  }

  bool is_here(const std::string& publisher, const ReadPackage& package) const {
    try {
      const auto here = repository_.targets_of(publisher);
      const auto* target = find_target(here, package.path);
      return target != nullptr && target->hashes.at("sha256") == package.sha256;
    } catch (const Error&) {
      return false;  // damaged in the marketplace
    }
  }

  // Why a publisher's file cannot take the place of the one that is here. Nothing: it can.
  std::optional<ErrorText> role_fault(const std::string& publisher, const tuf::RoleContent& role) const {
    if (role.expires <= now_of(options_))
      return ErrorText{.what = "it has expired", .next = "its publisher is to sign again: fiona plugin sign FILE"};
    for (const auto& target : role.targets) {
      if (!target.path.starts_with(publisher + "/"))
        return ErrorText{.what = "it signs for " + target.path + ", and may for " + publisher + "/… only",
                         .next = "its publisher is to sign with fiona plugin sign"};
    }
    const std::int64_t here = repository_.version_of(publisher);
    if (role.version > here && role.version - here <= kMostSignatures) return std::nullopt;
    const char* fault = role.version > here ? "it is version {}, and version {} is here: nobody has signed so often"
                                            : "it is version {}, and version {} is here already";
    return ErrorText{.what = fmt::format(fmt::runtime(fault), role.version, here),
                     .next = "its publisher is to sign after that: " + sign_after(publisher)};
  }

  // How a publisher gets on who signs for what he does not hand in.
  std::string next_without(const std::string& publisher, const std::string& path) const {
    const std::string next = "its publisher is to hand in that too, or sign without it: ";
    if (repository_.version_of(publisher) > 0) return next + sign_after(publisher);
    return next + "fiona plugin unsign " + package_named(path) + ", then fiona plugin sign FILE";
  }

  // All that the role signs for must be there or have come; what it signs for no longer is withdrawn.
  void take_packages(const std::string& publisher, const tuf::RoleContent& role) {
    Index next = index_;
    const auto withdrawn = [&](const IndexEntry& entry) {
      return entry.manifest().publisher() == publisher && !find_target(role.targets, target_path(entry.manifest()));
    };
    for (const auto& entry : index_.entries()) {
      if (withdrawn(entry) && !options_.replace) *next.add_withdrawn() = withdrawal_of(entry);
    }
    erase_if(*next.mutable_entries(), withdrawn);
    const DurableDirectory home = targets_.child(publisher, 0755);
    std::vector<std::string> paths, done;
    for (const auto& target : role.targets) {
      const std::string& sha256 = target.hashes.at("sha256");
      const auto came = std::ranges::find_if(
          packages_, [&](const auto& one) { return one.second.path == target.path && one.second.sha256 == sha256; });
      const std::string fault = came == packages_.end() ? "" : revocation_fault(came->second.entry);
      if (!fault.empty()) {
        refuse(came->first, fault, "fiona plugin unsign " + package_named(target.path) + ", and another version");
        done.push_back(came->first);
      } else if (came != packages_.end()) {
        const std::string raise = "raise its version, pack it, and: " + sign_after(publisher);
        if (add_entry(next, came->second.entry, options_.replace, how_.directory, raise)) paths.push_back(target.path);
        copy_checked(incoming_.path() / came->first, sha256, home, consistent_name(target.path, sha256));
        done.push_back(came->first);
      } else if (!home.has(consistent_name(target.path, sha256))) {
        throw Error(ErrorCode::NotFound,
                    ErrorText{.what = "it signs for " + target.path + ", which has not come with it",
                              .next = next_without(publisher, target.path)});
      }
    }
    index_ = std::move(next);
    for (const auto& target : role.targets) {
      wanted_[publisher].insert(consistent_name(target.path, target.hashes.at("sha256")));
    }
    result_.packages.insert(result_.packages.end(), paths.begin(), paths.end());
    done_.insert(done_.end(), done.begin(), done.end());
  }

  void write_market_index() {
    const std::string bytes = index_.SerializeAsString(), sha256 = tuf::sha256_hex(bytes);
    const std::string name = sha256 + "." + std::string(kIndexFile);
    if (name == index_file_) return;
    targets_.replace(name, bytes);
    repository_.set_target(std::string(kIndexRole), std::string(kIndexFile), bytes.size(), sha256);
    former_index_ = std::exchange(index_file_, name);
  }

  // Who signs the time signs the index: the keys of both change together.
  void follow_online_keys() {
    const auto next = repository_.proposed(std::string(tuf::kTimestamp));
    if (!next || repository_.proposal_lacks() != 0) return;
    if (next->keys == repository_.keys_of(std::string(kIndexRole)).keys) return;
    repository_.delegate(std::string(kIndexRole), next->keys, {std::string(kIndexFile)});
    std::string bytes = index_.SerializeAsString();
    repository_.set_target(std::string(kIndexRole), std::string(kIndexFile), bytes.size(), tuf::sha256_hex(bytes));
  }

  // What no list names any more, but for the index before this one: somebody may be reading by it.
  void remove_unlisted_targets() const {
    for (const auto& name : targets_.names()) {
      if (name.ends_with(kIndexFile) && name != index_file_ && name != former_index_) targets_.remove_file(name);
    }
    for (const auto& [publisher, wanted] : wanted_) {
      const DurableDirectory home = targets_.existing_child(publisher);
      for (const auto& name : home.names()) {
        if (!wanted.contains(name)) home.remove_file(name);
      }
    }
  }

  const KeeperOptions& options_;
  const OsCalls os_ = system_calls();
  const tuf::RepositoryOptions how_;
  tuf::Repository repository_;
  DurableDirectory directory_, incoming_, targets_;
  Index index_;
  std::string index_file_, former_index_;
  std::map<std::string, ReadPackage> packages_;          // by file name in `incoming`
  std::map<std::string, std::set<std::string>> wanted_;  // by publisher: the files that are signed for
  std::vector<std::string> done_;
  Accepted result_;
};

void require_keys(const filesystem::path& market, const KeeperOptions& options) {
  if (keeps(market, options)) return;
  options.keys.require_readable();
  throw Error(ErrorCode::NotAllowed,
              ErrorText{.what = "this user has not the keys of this marketplace",
                        .where = market.string(),
                        .expected = "keys of snapshot and timestamp in " + options.keys.path().string(),
                        .next = "let who made it do this"});
}

}  // namespace

Accepted accept(const filesystem::path& market, const std::vector<Welcome>& welcome, const KeeperOptions& options) {
  require_keys(market, options);
  return Acceptance{market, options}.run(welcome);
}

std::vector<Revocation> revoke(const filesystem::path& market, const std::string& what, const std::string& reason,
                               const KeeperOptions& options) {
  require_keys(market, options);
  if (const std::string fault = text_fault(reason, false); !fault.empty())
    throw Error(ErrorCode::Usage, ErrorText{.what = "the reason " + fault, .expected = "one line of text"});
  return Acceptance{market, options}.revoke(what, reason);
}

bool keeps(const filesystem::path& market, const KeeperOptions& options) {
  const tuf::RepositoryOptions how = repository_options(market, options);
  std::error_code failure;
  if (!filesystem::exists(how.trusted / "root.json", failure)) return false;  // never opened here: not made here
  return tuf::Repository{how, options.keys}.may_commit();
}

}  // namespace fiona::marketplace
