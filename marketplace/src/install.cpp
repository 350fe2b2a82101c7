#include <google/protobuf/text_format.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>
#include <map>
#include <set>

#include "index_file.hpp"
#include "installed.hpp"
#include "store_change.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

void list_package(StoreChange& change, const Marketplace& from, const PlanStep& step) {
  fiona::InstalledPackage* listed = change.find(step.package);
  if (!listed) {
    listed = change.list().add_packages();
    listed->set_as_requirement(true);  // those that were asked for are told apart below
  }
  *listed->mutable_manifest() = step.entry->manifest();
  listed->set_directory(std::string(kPackagesDirectory) + "/" + step.entry->blake2b());
  listed->set_source(from.source());
  listed->set_first_party(from.is_first_party());
  const auto keys = from.keys_of(step.entry->manifest().publisher());
  listed->mutable_keys()->Assign(keys.begin(), keys.end());
}

void unlist_package(StoreChange& change, const std::string& name) {
  auto& packages = *change.list().mutable_packages();
  packages.erase(std::ranges::find_if(packages, [&](const auto& one) { return full_name(one.manifest()) == name; }));
}

// Whether that changed the list.
bool mark_asked(StoreChange& change, const Plan& plan) {
  bool changed = false;
  for (const auto& name : plan.asked) {
    fiona::InstalledPackage* listed = change.find(name);
    if (!listed || !listed->as_requirement()) continue;
    listed->set_as_requirement(false);
    changed = true;
  }
  return changed;
}

const Marketplace& market_of(const PlanStep& step, const Marketplaces& from) {
  return **std::ranges::find(from, step.source, &Marketplace::source);
}

// Nothing that this plan brought is left if it fails.
void perform(StoreChange& change, const Plan& plan, const Marketplaces& from) {
  try {
    for (const auto& step : plan.steps) {
      if (step.entry) change.add_files(*step.entry, [&] { return market_of(step, from).package(*step.entry); });
    }
    for (const auto& step : plan.steps) {
      if (step.kind == StepKind::Remove) {
        unlist_package(change, step.package);
      } else {
        list_package(change, market_of(step, from), step);
      }
    }
    if (mark_asked(change, plan) || !plan.steps.empty()) change.commit(plan.change);
  } catch (...) {
    for (const auto& step : plan.steps) {
      if (step.entry) change.drop_unlisted(step.entry->blake2b());
    }
    throw;
  }
}

void roll_back(StoreChange& change, const Plan& plan, const filesystem::path& store) {
  const Installed then = read_generation(store, plan.rollback_to);
  for (const auto& package : then.packages()) {
    if (change.is_whole(package.manifest(), hash_of(package))) continue;
    const std::string name = full_name(package.manifest()) + " " + package.manifest().version();
    throw Error(ErrorCode::BadSignature,
                ErrorText{.what = "the files of " + name + ", to which this would go back, are damaged or gone",
                          .where = (store / package.directory()).string(),
                          .next = "market install " + full_name(package.manifest()) + "@" +
                                  package.manifest().version() + from_option(package.source())});
  }
  change.commit_rollback(then);
}

}  // namespace

bool apply(const Plan& plan, const Marketplaces& from, const filesystem::path& store, const InstallOptions& options) {
  StoreChange change{store, options};
  if (change.list().generation() != plan.generation) return false;
  if (plan.rollback_to != 0) {
    roll_back(change, plan, store);
  } else {
    perform(change, plan, from);
  }
  return true;
}

namespace {

/// What a store has of a marketplace, in its list or in one that it may go back to.
std::set<std::string> hashes_from(const std::string& source, const filesystem::path& store) {
  std::set<std::string> hashes;
  const auto add = [&](const Installed& list) {
    for (const auto& package : list.packages()) {
      if (package.source() == source) hashes.insert(hash_of(package));
    }
  };
  add(read_installed(store));
  for (const auto number : kept_generations(store)) {
    try {
      add(read_generation(store, number));
    } catch (const Error&) {
      // A list that cannot be read cannot be gone back to.
    }
  }
  return hashes;
}

/// Of a marketplace's revocations those that concern this store and are not noted yet.
std::vector<Revocation> news_of(const Marketplace& from, const filesystem::path& store) {
  std::vector<Revocation> news;
  if (from.index().revoked().empty()) return news;
  const std::set<std::string> here = hashes_from(from.source(), store);
  const Revocations noted = here.empty() ? Revocations{} : read_revocations(store);
  for (const auto& one : from.index().revoked()) {
    const bool known = std::ranges::any_of(noted.packages(), [&](const Revocation& before) {
      return before.blake2b() == one.blake2b() && before.marketplace() == from.source();
    });
    if (!here.contains(one.blake2b()) || known) continue;
    news.push_back(one);
    news.back().set_marketplace(from.source());
  }
  return news;
}

}  // namespace

std::vector<Revocation> note_revocations(const Marketplace& from, const filesystem::path& store,
                                         const InstallOptions& options) {
  if (news_of(from, store).empty()) return {};
  DurableDirectory directory{options.os, store, 0700};
  directory.lock(options.lock_wait, options.on_wait);
  const std::vector<Revocation> news = news_of(from, store);
  Revocations noted = read_revocations(store);
  for (const auto& one : news) *noted.add_packages() = one;
  std::string text;
  google::protobuf::TextFormat::PrintToString(noted, &text);
  directory.replace(std::string(kRevokedFile), text);
  return news;
}

void install_unsigned(const std::vector<filesystem::path>& packages, const filesystem::path& store) {
  filesystem::remove_all(store);
  const InstallOptions options;
  StoreChange change{store, options};
  std::map<std::string, filesystem::path> names;
  for (const auto& path : packages) {
    const IndexEntry entry = entry_for(inspect_package(path));
    const auto [other, added] = names.emplace(entry.manifest().name(), path);
    if (!added) {
      throw Error(ErrorCode::NotAllowed,
                  ErrorText{.what = "two packages without a signature have the name " + entry.manifest().name() +
                                    ", and nothing says whose they are",
                            .where = path.string(),
                            .found = other->second.string(),
                            .next = "leave one of them out"});
    }
    change.add_files(entry, [&path] { return path; });
    auto& listed = *change.list().add_packages();
    *listed.mutable_manifest() = entry.manifest();
    listed.set_directory(std::string(kPackagesDirectory) + "/" + entry.blake2b());
    listed.set_source(path.string());
  }
  change.commit("unsigned");
}

}  // namespace fiona::marketplace
