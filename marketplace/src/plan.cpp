#include <algorithm>
#include <fiona/abi.hpp>
#include <fiona/error.hpp>
#include <fiona/marketplace/plan.hpp>
#include <fiona/plugin.hpp>
#include <map>
#include <optional>
#include <set>

#include "installed.hpp"
#include "services.hpp"
#include "solver.hpp"

namespace fiona::marketplace {
namespace {

// What the platform brings itself needs no introduction.
constexpr std::string_view kFirstParty = "fiona";
constexpr std::size_t kMostNotes = 10;

Version version_in(const Manifest& manifest) { return *Version::parse(manifest.version()); }

std::string listed(const std::vector<std::string>& parts, const char* between = ", ", const char* last = " and ") {
  std::string text;
  for (std::size_t i = 0; i < parts.size(); ++i)
    text += (i == 0 ? "" : i + 1 == parts.size() ? last : between) + parts[i];
  return text;
}

std::vector<std::string> difference(const google::protobuf::RepeatedPtrField<std::string>& after,
                                    const google::protobuf::RepeatedPtrField<std::string>& before) {
  std::vector<std::string> added;
  for (const auto& one : after) {
    if (std::ranges::find(before, one) == before.end()) added.push_back(one);
  }
  return added;
}

// The step from one version of a package to another; `before` is null where none is there.
PlanStep step_to(const Manifest& after, const Manifest* before) {
  PlanStep step;
  step.package = full_name(after);
  step.version = after.version();
  step.rights = {after.rights().begin(), after.rights().end()};
  step.new_rights = before ? difference(after.rights(), before->rights()) : step.rights;
  if (!before) return step;
  step.previous_version = before->version();
  const auto order = version_in(after) <=> version_in(*before);
  step.kind = order > 0 ? StepKind::Upgrade : order < 0 ? StepKind::Downgrade : StepKind::Replace;
  return step;
}

PlanStep removal_of(const Manifest& manifest) {
  PlanStep step;
  step.kind = StepKind::Remove;
  step.package = full_name(manifest);
  step.version = step.previous_version = manifest.version();
  return step;
}

void sort_steps(Plan& plan) { std::ranges::sort(plan.steps, {}, &PlanStep::package); }

using Manifests = std::map<std::string, const Manifest*>;

// Of these packages those that somebody has asked for, and what they require.
std::set<std::string> needed_of(const Manifests& manifests, std::vector<std::string> asked) {
  std::set<std::string> needed;
  while (!asked.empty()) {
    const std::string name = std::move(asked.back());
    asked.pop_back();
    if (!manifests.contains(name) || !needed.insert(name).second) continue;
    for (const auto& text : manifests.at(name)->requirements()) asked.push_back(Requirement::parse(text, name).package);
  }
  return needed;
}

std::vector<std::string> asked_for(const Installed& list) {
  std::vector<std::string> asked;
  for (const auto& package : list.packages()) {
    if (!package.as_requirement()) asked.push_back(full_name(package.manifest()));
  }
  return asked;
}

/// What a marketplace has.
struct Offer {
  const IndexEntry* entry;
  const Marketplace* from;
};

/// Whether a package that stays in its version gets what this marketplace has of it, where that is something else.
enum class OtherContent { Taken, TakenFromItsSource, Left };

/// One question to the solver: what is there, what is offered, what is wanted.
class Planner {
 public:
  Planner(const Marketplace& from, const Store& store, const Platform& platform)
      : from_(from), store_(store), platform_(platform), installed_(read_installed(store.directory())) {
    solver_.emplace(platform_);
    plan_.generation = installed_.generation();
    for (const auto& package : installed_.packages()) present_[full_name(package.manifest())] = &package;
    for (const auto& entry : from.index().entries()) offers_[full_name(entry.manifest())].push_back(&entry);
  }

  void want(const PackageRequest& request) {
    plan_.asked.push_back(request.package);
    if (!request.version) return wanted_.install.push_back({request.package, {}});
    want_exactly({&best_of(request.package, *request.version), &from_});
  }

  void want_exactly(const Offer& offer) {
    exact_.insert(full_name(offer.entry->manifest()));
    wanted_.exact.push_back(&offer.entry->manifest());
    entries_[&offer.entry->manifest()] = offer;
  }

  void want_update(const std::string& package) { wanted_.update.push_back(package); }
  void want_all_updates() { wanted_.update_all = true; }
  void ask_for(const std::string& package) { plan_.asked.push_back(package); }

  // `verb` is what cannot be done, if it cannot: "installed".
  Plan make(const char* verb, bool look_at_files, OtherContent other_content) {
    fill_solver();
    Solver::Outcome outcome = solver_->solve(wanted_);
    if (!outcome.solved()) refuse(outcome, verb);
    if (other_content != OtherContent::Left)
      outcome = with_other_content(std::move(outcome), other_content == OtherContent::Taken);
    for (const Manifest* manifest : outcome.packages) add_step(*manifest, outcome.packages);
    for (const auto& [name, package] : present_) {
      const bool stays = std::ranges::any_of(
          outcome.packages, [&, &wanted = name](const auto* one) { return full_name(*one) == wanted; });
      if (!stays) plan_.steps.push_back(removal_of(package->manifest()));
    }
    for (const Manifest* manifest : outcome.packages) {
      if (look_at_files) add_repair(*manifest);
    }
    add_notes(outcome);
    note_needless(outcome);
    sort_steps(plan_);
    add_missing(outcome);
    return std::move(plan_);
  }

  const Installed& installed() const { return installed_; }

 private:
  // Of several with this version, one that fits.
  const IndexEntry& best_of(const std::string& package, const Version& version) const {
    const IndexEntry* best = nullptr;
    for (const IndexEntry* entry : offers_of(package)) {
      if (version_in(entry->manifest()) != version) continue;
      if (!best || solver_->fits_platform(entry->manifest())) best = entry;
    }
    return *best;
  }

  bool is_eligible(const IndexEntry& entry) const {
    const std::string name = full_name(entry.manifest());
    if (const Manifest* there = present(name); there && !exact_.contains(name)) {
      if (version_in(*there) == version_in(entry.manifest())) return false;  // it is there
    }
    if (!version_in(entry.manifest()).is_prerelease() || !has_release(name)) return true;
    const auto present = present_.find(name);
    if (present != present_.end() && version_in(present->second->manifest()).is_prerelease()) return true;
    return std::ranges::find(wanted_.exact, &entry.manifest()) != wanted_.exact.end();
  }

  const std::vector<const IndexEntry*>& offers_of(const std::string& name) const {
    static const std::vector<const IndexEntry*> kNone;
    const auto found = offers_.find(name);
    return found == offers_.end() ? kNone : found->second;
  }

  bool has_release(const std::string& name) const {
    return std::ranges::any_of(offers_of(name),
                               [](const IndexEntry* one) { return !version_in(one->manifest()).is_prerelease(); });
  }

  void fill_solver() {
    solver_.emplace(platform_);
    for (const auto& package : installed_.packages()) {
      // Who names a version gives the one that is there away, also for an older one.
      if (!exact_.contains(full_name(package.manifest()))) solver_->add_installed(package.manifest());
    }
    for (const Manifest* exact : wanted_.exact) {
      if (entries_.at(exact).from != &from_) solver_->add_offered(*exact);
    }
    for (const auto& entry : from_.index().entries()) {
      entries_[&entry.manifest()] = {&entry, &from_};
      if (is_eligible(entry)) solver_->add_offered(entry.manifest());
    }
  }

  bool is_asked(const std::string& name) const {
    return wanted_.update_all || exact_.contains(name) || std::ranges::find(plan_.asked, name) != plan_.asked.end() ||
           std::ranges::find(wanted_.update, name) != wanted_.update.end();
  }

  const Manifest* present(const std::string& name) const {
    const auto found = present_.find(name);
    return found == present_.end() ? nullptr : &found->second->manifest();
  }

  void add_step(const Manifest& after, const std::vector<const Manifest*>& all) {
    const auto entry = entries_.find(&after);
    if (entry == entries_.end()) return;  // it stays
    const std::string name = full_name(after);
    const Manifest* before = present(name);
    const auto& [offered, from] = entry->second;
    if (before && hash_of(*present_.at(name)) == offered->blake2b()) return;
    PlanStep step = step_to(after, before);
    step.entry = *offered;
    step.source = from->source();
    look_at_publisher(step, after.publisher(), *from);
    if (!is_asked(name) || (wanted_.update_all && !before)) {
      for (const Manifest* other : all) {
        if (step.because.empty() && requires_package(*other, name)) step.because = full_name(*other) + " requires it";
      }
    }
    plan_.steps.push_back(std::move(step));
  }

  // A name is only as good as the keys behind it, and those the marketplace may change.
  void look_at_publisher(PlanStep& step, const std::string& publisher, const Marketplace& from) const {
    std::set<std::string> known;
    step.new_publisher = true;
    for (const auto& [name, package] : present_) {
      if (package->manifest().publisher() != publisher) continue;
      step.new_publisher = false;
      known.insert(package->keys().begin(), package->keys().end());
    }
    if (from.is_first_party() && publisher == kFirstParty) {
      step.new_publisher = false;
      return;
    }
    step.known_keys = {known.begin(), known.end()};
    for (const auto& key : from.keys_of(publisher)) {
      if (!known.contains(key)) step.new_keys.push_back(key);
    }
  }

  // What the marketplace has of a package that stays in its version; null: nothing, or nobody has asked.
  const IndexEntry* same_version(const Manifest& manifest) const {
    const std::string name = full_name(manifest);
    const Manifest* before = present(name);
    if (before != &manifest || !is_asked(name)) return nullptr;
    const std::string hash = hash_of(*present_.at(name));
    const IndexEntry* same = nullptr;
    for (const IndexEntry* entry : offers_of(name)) {
      const bool fits = entry->manifest().version() == before->version() &&
                        entry->manifest().architecture() == before->architecture();
      if (fits && (!same || entry->blake2b() == hash)) same = entry;
    }
    return same;
  }

  bool has_content_of(const IndexEntry& entry) const {
    return hash_of(*present_.at(full_name(entry.manifest()))) == entry.blake2b();
  }

  // Other content of a version that would stay may require other packages: it comes where that can be solved.
  Solver::Outcome with_other_content(Solver::Outcome outcome, bool of_any_source) {
    const Solver::Wanted wanted = wanted_;
    const std::set<std::string> exact = exact_;
    std::vector<std::string> names;
    for (const Manifest* manifest : outcome.packages) {
      const IndexEntry* entry = same_version(*manifest);
      if (entry == nullptr || has_content_of(*entry)) continue;
      const std::string name = full_name(*manifest);
      if (!of_any_source && present_.at(name)->source() != from_.source()) continue;
      want_exactly({entry, &from_});
      std::erase(wanted_.update, name);
      std::erase_if(wanted_.install, [&name](const Requirement& one) { return one.package == name; });
      names.push_back(name + " " + manifest->version());
    }
    if (names.empty()) return outcome;
    fill_solver();
    Solver::Outcome other = solver_->solve(wanted_);
    if (other.solved()) return other;
    wanted_ = wanted;
    exact_ = exact;
    fill_solver();
    plan_.notes.push_back("other content of " + listed(names) +
                          " is not taken: " + listed(other.reasons, ", ", ", and "));
    return outcome;
  }

  void add_repair(const Manifest& manifest) {
    const IndexEntry* same = same_version(manifest);
    if (same == nullptr || !has_content_of(*same) || is_whole(full_name(manifest))) return;
    PlanStep step = step_to(same->manifest(), &manifest);
    step.kind = StepKind::Repair;
    step.entry = *same;
    step.source = from_.source();
    plan_.steps.push_back(std::move(step));
  }

  bool is_whole(const std::string& name) const {
    try {
      store_.verify(store_.find(name));
      return true;
    } catch (const Error& error) {
      if (error.code() != ErrorCode::BadSignature) throw;
      return false;
    }
  }

  // What came as a requirement of a version that goes.
  void note_needless(const Solver::Outcome& outcome) {
    Manifests now, then;
    for (const auto& [name, package] : present_) now[name] = &package->manifest();
    for (const Manifest* manifest : outcome.packages) then[full_name(*manifest)] = manifest;
    std::vector<std::string> asked = asked_for(installed_);
    const std::set<std::string> before = needed_of(now, asked);
    asked.insert(asked.end(), plan_.asked.begin(), plan_.asked.end());
    const std::set<std::string> after = needed_of(then, asked);
    for (const auto& name : before) {
      if (!after.contains(name) && then.contains(name))
        plan_.notes.push_back("nothing requires " + name + " any more: market remove " + name);
    }
  }

  // Why a newer version than the chosen one is not taken.
  void add_notes(const Solver::Outcome& outcome) {
    for (const Manifest* chosen : outcome.packages) {
      const std::string name = full_name(*chosen);
      if (plan_.notes.size() >= kMostNotes || !is_asked(name) || exact_.contains(name)) continue;
      const Manifest* newest = nullptr;
      for (const IndexEntry* entry : offers_of(name)) {
        const Version version = version_in(entry->manifest());
        if (!is_eligible(*entry) || version <= version_in(*chosen)) continue;
        if (!newest || version > version_in(*newest)) newest = &entry->manifest();
      }
      if (!newest) continue;
      Solver::Wanted wanted{.exact = {newest}};
      for (const auto& other : wanted_.install) {
        if (other.package != name) wanted.install.push_back(other);
      }
      const Solver::Outcome tried = solver_->solve(wanted);
      if (!tried.solved())
        plan_.notes.push_back(name + " " + newest->version() +
                              " is not taken: " + listed(tried.reasons, ", ", ", and "));
    }
  }

  void add_missing(const Solver::Outcome& outcome) {
    std::vector<ServingPackage> changed, all;
    for (const Manifest* manifest : outcome.packages) {
      const std::string name = full_name(*manifest);
      const auto step = std::ranges::find(plan_.steps, name, &PlanStep::package);
      if (step != plan_.steps.end() && step->entry) {
        all.push_back({name, step->entry->interface()});
        changed.push_back(all.back());
      } else if (present_.contains(name)) {
        try {
          all.push_back({name, store_.find(name).interface()});
        } catch (const Error&) {
          // A damaged package serves nobody.
        }
      }
    }
    plan_.missing = missing_services(changed, all, from_);
  }

  [[noreturn]] void refuse(const Solver::Outcome& outcome, const char* verb) {
    std::vector<std::string> names;
    for (const auto& one : wanted_.install) names.push_back(one.package);
    for (const auto* one : wanted_.exact) names.push_back(full_name(*one) + " " + one->version());
    names.insert(names.end(), wanted_.update.begin(), wanted_.update.end());
    const std::string who = names.empty() ? "what is installed" : listed(names);
    throw Error(ErrorCode::DependencyConflict,
                ErrorText{.what = who + " cannot be " + verb + (names.size() > 1 ? " together: " : ": ") +
                                  listed(outcome.reasons, ", ", ", and "),
                          .where = from_.source(),
                          .next = next_step(outcome)});
  }

  // The nearest thing that would go.
  std::string next_step(const Solver::Outcome& refused) {
    if (wanted_.exact.size() == 1 && wanted_.install.empty()) {
      const std::string name = full_name(*wanted_.exact.front());
      const Solver::Outcome other = solver_->solve({.install = {{name, {}}}});
      for (const Manifest* manifest : other.packages) {
        if (full_name(*manifest) == name)
          return "market install " + name + "@" + manifest->version() + from_.option() +
                 (present(name) ? "" : ", which fits");
      }
    }
    if (!refused.missing.empty() && refused.reasons.size() == 1)
      return "market install " + listed(refused.missing, " ", " ") + " first, from a marketplace that has it";
    if (!refused.installed.empty())
      return "market remove " + listed(refused.installed, " ", " ") + ", or choose another version";
    return "market info " +
           (wanted_.exact.empty() ? wanted_.install.empty() ? std::string("NAME") : wanted_.install.front().package
                                  : full_name(*wanted_.exact.front())) +
           from_.option() + " shows what there is";
  }

  const Marketplace& from_;
  const Store& store_;
  const Platform platform_;
  const Installed installed_;
  std::optional<Solver> solver_;
  Plan plan_;
  Solver::Wanted wanted_;
  std::set<std::string> exact_;
  std::map<std::string, std::vector<const IndexEntry*>> offers_;  // all, by name
  std::map<std::string, const fiona::InstalledPackage*> present_;
  std::map<const Manifest*, Offer> entries_;  // all, by manifest
};

Offer locked_offer(const LockedPackage& locked, const Marketplaces& from) {
  const IndexEntry* other = nullptr;
  const Marketplace* where = from.front();
  for (const Marketplace* market : from) {
    for (const auto& entry : market->index().entries()) {
      if (full_name(entry.manifest()) != locked.package()) continue;
      if (entry.blake2b() == locked.blake2b()) return {&entry, market};
      if (entry.manifest().version() != locked.version()) continue;
      other = &entry;
      where = market;
    }
  }
  ErrorText text{
      .what = "the marketplace does not have " + locked.package() + " " + locked.version() + ", which the lock names",
      .where = where->source(),
      .next = "market install --locked FILE --from " + locked.marketplace()};
  if (!other) throw Error(ErrorCode::NotFound, text);
  text.what =
      "the marketplace has " + locked.package() + " " + locked.version() + " with other content than the lock says";
  text.expected = locked.blake2b();
  text.found = other->blake2b();
  throw Error(ErrorCode::BadSignature, text);
}

void refuse_if_required(const Installed& list, const std::set<std::string>& removed) {
  std::vector<std::string> clauses, all{removed.begin(), removed.end()};
  for (const auto& package : list.packages()) {
    const std::string name = full_name(package.manifest());
    if (removed.contains(name)) continue;
    for (const auto& one : removed) {
      if (!requires_package(package.manifest(), one)) continue;
      clauses.push_back(name + " " + package.manifest().version() + " requires " + (removed.size() > 1 ? one : "it"));
      if (all.back() != name) all.push_back(name);
    }
  }
  if (clauses.empty()) return;
  throw Error(ErrorCode::DependencyConflict,
              ErrorText{.what = listed({removed.begin(), removed.end()}) + " cannot be removed: " + listed(clauses),
                        .next = "market remove " + listed(all, " ", " ") + " removes both"});
}

std::string change_text(const char* verb, const std::vector<std::string>& names) {
  return verb + (names.empty() ? std::string() : " " + listed(names, " ", " "));
}

}  // namespace

Platform Platform::here() { return {FIONA_VERSION, kAbiTag, std::string(this_architecture())}; }

bool Plan::needs_consent() const {
  return std::ranges::any_of(steps, [](const PlanStep& step) {
    return !step.because.empty() || !step.new_rights.empty() || step.new_publisher || !step.new_keys.empty();
  });
}

Plan plan_install(const std::vector<std::string>& requests, const Marketplace& from, const Store& store,
                  const Platform& platform) {
  Planner planner{from, store, platform};
  for (const auto& request : requests) planner.want(from.resolve(request));
  Plan plan = planner.make("installed", true, OtherContent::Taken);
  plan.change = change_text("install", requests);
  return plan;
}

Plan plan_update(const std::vector<std::string>& names, const Marketplace& from, const Store& store,
                 const Platform& platform) {
  Planner planner{from, store, platform};
  for (const auto& name : names) planner.want_update(store.find(name).name());
  if (names.empty()) planner.want_all_updates();
  Plan plan = planner.make("updated", false, OtherContent::TakenFromItsSource);
  plan.change = change_text("update", names);
  return plan;
}

Plan plan_locked(const Lock& lock, const Marketplaces& from, const Store& store, const Platform& platform) {
  Planner planner{*from.front(), store, platform};
  for (const auto& locked : lock.packages()) {
    const auto& present = planner.installed().packages();
    const bool there = std::ranges::any_of(present, [&](const auto& one) { return hash_of(one) == locked.blake2b(); });
    if (!there) planner.want_exactly(locked_offer(locked, from));
    if (!locked.as_requirement()) planner.ask_for(locked.package());
  }
  Plan plan = planner.make("installed", false, OtherContent::Left);
  plan.change = "install --locked";
  return plan;
}

Plan plan_remove(const std::vector<std::string>& names, const Store& store) {
  std::set<std::string> removed;
  for (const auto& name : names) removed.insert(store.find(name).name());
  const Installed list = read_installed(store.directory());
  refuse_if_required(list, removed);
  Manifests stay;
  for (const auto& package : list.packages()) stay[full_name(package.manifest())] = &package.manifest();
  for (const auto& name : removed) stay.erase(name);
  const std::set<std::string> needed = needed_of(stay, asked_for(list));
  Plan plan;
  plan.generation = list.generation();
  plan.change = change_text("remove", {removed.begin(), removed.end()});
  for (const auto& package : list.packages()) {
    const std::string name = full_name(package.manifest());
    if (needed.contains(name)) continue;
    PlanStep& step = plan.steps.emplace_back(removal_of(package.manifest()));
    if (!removed.contains(name)) step.because = "nothing requires it any more";
  }
  return plan;
}

Plan plan_rollback(std::optional<std::uint64_t> generation, const Store& store) {
  const Installed now = read_installed(store.directory());
  Plan plan;
  plan.generation = now.generation();
  plan.rollback_to = generation.value_or(now.previous());
  if (plan.rollback_to == now.generation()) plan.rollback_to = 0;
  if (plan.rollback_to == 0) {
    throw Error(ErrorCode::NotFound,
                ErrorText{.what = generation ? "this generation is the present one" : "there is nothing to go back to",
                          .where = store.directory().string(),
                          .next = "market history"});
  }
  const Installed then = read_generation(store.directory(), plan.rollback_to);
  plan.change = "rollback to " + std::to_string(plan.rollback_to);
  const auto same_name = [](const auto& a) {
    return [&a](const auto& b) { return full_name(a.manifest()) == full_name(b.manifest()); };
  };
  for (const auto& package : then.packages()) {
    const auto before = std::ranges::find_if(now.packages(), same_name(package));
    if (before != now.packages().end() && hash_of(*before) == hash_of(package)) continue;
    plan.steps.push_back(step_to(package.manifest(), before == now.packages().end() ? nullptr : &before->manifest()));
  }
  for (const auto& package : now.packages()) {
    if (std::ranges::none_of(then.packages(), same_name(package))) plan.steps.push_back(removal_of(package.manifest()));
  }
  sort_steps(plan);
  return plan;
}

}  // namespace fiona::marketplace
