#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>

#include "installed.hpp"
#include "store_change.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr int kMostAttempts = 5;

void list_package(StoreChange& change, const Marketplace& from, const PlanStep& step) {
  fiona::InstalledPackage* listed = change.find(step.package);
  if (!listed) {
    listed = change.list().add_packages();
    listed->set_as_requirement(true);  // those that were asked for are told apart below
  }
  *listed->mutable_manifest() = step.entry->manifest();
  listed->set_directory(std::string(kPackagesDirectory) + "/" + step.entry->blake2b());
  listed->set_source(from.source());
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

// Nothing that this plan brought is left if it fails.
void perform(StoreChange& change, const Plan& plan, const Marketplace* from) {
  try {
    for (const auto& step : plan.steps) {
      if (step.entry) change.add_files(*from, *step.entry);
    }
    for (const auto& step : plan.steps) {
      if (step.kind == StepKind::Remove) {
        unlist_package(change, step.package);
      } else {
        list_package(change, *from, step);
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
    throw Error(
        ErrorCode::BadSignature,
        ErrorText{.what = "the files of " + name + ", to which this would go back, are damaged or gone",
                  .where = (store / package.directory()).string(),
                  .next = "market install " + full_name(package.manifest()) + "@" + package.manifest().version()});
  }
  change.commit_rollback(then);
}

InstallOutcome outcome_of(const Plan& plan, const std::string& name) {
  const auto step = std::ranges::find(plan.steps, name, &PlanStep::package);
  if (step == plan.steps.end()) return InstallOutcome::AlreadyInstalled;
  if (step->kind == StepKind::Repair) return InstallOutcome::Repaired;
  return step->kind == StepKind::Install ? InstallOutcome::Installed : InstallOutcome::Replaced;
}

[[noreturn]] void give_up(const filesystem::path& store) {
  throw Error(ErrorCode::Unreachable, ErrorText{.what = "others change this store all the time",
                                                .where = store.string(),
                                                .next = "try again when they have ended"});
}

}  // namespace

bool apply(const Plan& plan, const Marketplace* from, const filesystem::path& store, const InstallOptions& options) {
  StoreChange change{store, options};
  if (change.list().generation() != plan.generation) return false;
  if (plan.rollback_to != 0) {
    roll_back(change, plan, store);
  } else {
    perform(change, plan, from);
  }
  return true;
}

InstallResult install(std::string_view request, const Marketplace& from, const filesystem::path& store,
                      const InstallOptions& options) {
  const std::string name = from.resolve(request).package;
  for (int attempt = 0; attempt < kMostAttempts; ++attempt) {
    const Plan plan = plan_install({std::string(request)}, from, Store{store}, options.platform);
    if (!apply(plan, &from, store, options)) continue;
    const auto step = std::ranges::find(plan.steps, name, &PlanStep::package);
    const InstalledPackage package = Store{store}.find(name);
    return {outcome_of(plan, name), package,
            step == plan.steps.end() ? package.manifest.version() : step->previous_version};
  }
  give_up(store);
}

InstalledPackage remove(std::string_view name, const filesystem::path& store, const InstallOptions& options) {
  for (int attempt = 0; attempt < kMostAttempts; ++attempt) {
    const InstalledPackage package = Store{store}.find(name);
    if (apply(plan_remove({std::string(name)}, Store{store}), nullptr, store, options)) return package;
  }
  give_up(store);
}

}  // namespace fiona::marketplace
