#include "solver.hpp"

#include <solv/evr.h>
#include <solv/pool.h>
#include <solv/problems.h>
#include <solv/repo.h>
#include <solv/solvable.h>
#include <solv/solver.h>

#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <optional>
#include <set>

namespace fiona::marketplace {
namespace {

// A queue of libsolv's that frees itself.
class Ids {
 public:
  Ids() { queue_init(&queue_); }
  ~Ids() { queue_free(&queue_); }
  Ids(const Ids&) = delete;
  Ids& operator=(const Ids&) = delete;

  void add(Id first, Id second) { queue_push2(&queue_, first, second); }
  Queue* get() { return &queue_; }
  const Id* begin() const { return queue_.elements; }
  const Id* end() const { return queue_.elements + queue_.count; }

 private:
  Queue queue_;
};

int relation_flags(VersionRange::Comparison comparison) {
  switch (comparison) {
    case VersionRange::Comparison::Less: return REL_LT;
    case VersionRange::Comparison::LessEqual: return REL_LT | REL_EQ;
    case VersionRange::Comparison::Equal: return REL_EQ;
    case VersionRange::Comparison::GreaterEqual: return REL_GT | REL_EQ;
    case VersionRange::Comparison::Greater: return REL_GT;
  }
  return 0;
}

std::string display(const Manifest& manifest) { return full_name(manifest) + " " + manifest.version(); }

// Where order counts, a word becomes letters, two for each character, and ends with a digit: Debian sorts letters
// before signs and the end before both, semver a word before a longer one that begins with it.
void add_identifier(std::string& text, std::string_view identifier) {
  if (identifier.find_first_not_of("0123456789") == std::string_view::npos) {
    text += identifier;
    return;
  }
  for (const char c : identifier) {
    text += static_cast<char>('a' + (static_cast<unsigned char>(c) >> 4));
    text += static_cast<char>('a' + (static_cast<unsigned char>(c) & 15));
  }
  text += '0';
}

}  // namespace

std::string debian_version(const Version& version) {
  std::string_view text = version.text();
  text = text.substr(0, text.find('+'));
  const std::size_t dash = text.find('-');
  std::string result{text.substr(0, dash)};
  if (dash == std::string_view::npos) return result;
  result += '~';
  for (std::string_view rest = text.substr(dash + 1);;) {
    const std::size_t dot = rest.find('.');
    add_identifier(result, rest.substr(0, dot));
    if (dot == std::string_view::npos) return result;
    result += '.';
    rest = rest.substr(dot + 1);
  }
}

struct Solver::Reason {
  std::optional<Version> version;  // of several versions that are refused alike, the newest is named
  std::string clause;
  bool installed;
  std::string missing{};  ///< the package that nobody offers, if that is why
};

Solver::Solver(const Platform& platform) : platform_(platform), pool_(pool_create(), pool_free) {
  if (pool_setdisttype(pool_.get(), DISTTYPE_DEB) < 0)
    throw Error(ErrorCode::Failed, {.what = "this libsolv does not know Debian's order of versions",
                                    .next = "install Debian's own: apt-get install libsolv1"});
  installed_ = repo_create(pool_.get(), "installed");
  offered_ = repo_create(pool_.get(), "offered");
  pool_set_installed(pool_.get(), installed_);
  // FIONA itself is a package that is there.
  platform_package_ = repo_add_solvable(installed_);
  Solvable* self = pool_id2solvable(pool_.get(), platform_package_);
  self->name = pool_str2id(pool_.get(), "fiona", 1);
  self->evr = pool_str2id(pool_.get(), debian_version(*Version::parse(platform.version)).c_str(), 1);
  self->arch = ARCH_ALL;
  const auto provide = [&](Id what) { solvable_add_deparray(self, SOLVABLE_PROVIDES, what, 0); };
  provide(pool_rel2id(pool_.get(), self->name, self->evr, REL_EQ, 1));
  provide(pool_str2id(pool_.get(), ("abi:" + platform.abi).c_str(), 1));
  provide(pool_str2id(pool_.get(), ("machine:" + platform.architecture).c_str(), 1));
}

Solver::~Solver() = default;

void Solver::add_installed(const Manifest& manifest) { add(installed_, manifest); }
void Solver::add_offered(const Manifest& manifest) { add(offered_, manifest); }

Id Solver::relation(Id name, const VersionRange::Bound& bound) {
  const Id version = pool_str2id(pool_.get(), debian_version(bound.version).c_str(), 1);
  return pool_rel2id(pool_.get(), name, version, relation_flags(bound.comparison), 1);
}

Id Solver::id_of(const CompiledProto& proto) {
  return pool_str2id(pool_.get(), ("proto:" + proto.name() + "@" + proto.blake2b()).c_str(), 1);
}

void Solver::require(Id package, Id dependency, std::string clause) {
  solvable_add_deparray(pool_id2solvable(pool_.get(), package), SOLVABLE_REQUIRES, dependency, 0);
  clauses_[{package, dependency}] = std::move(clause);
}

void Solver::require(Id package, const Requirement& requirement) {
  const Id name = pool_str2id(pool_.get(), requirement.package.c_str(), 1);
  const std::string clause = "requires " + requirement.text();
  if (requirement.versions.bounds().empty()) require(package, name, clause);
  for (const auto& bound : requirement.versions.bounds()) require(package, relation(name, bound), clause);
}

Id Solver::add(Repo* repo, const Manifest& manifest) {
  const Id package = repo_add_solvable(repo);
  Solvable* solvable = pool_id2solvable(pool_.get(), package);
  solvable->name = pool_str2id(pool_.get(), full_name(manifest).c_str(), 1);
  solvable->evr = pool_str2id(pool_.get(), debian_version(*Version::parse(manifest.version())).c_str(), 1);
  solvable->arch = ARCH_ALL;
  solvable->vendor = pool_str2id(pool_.get(), manifest.publisher().c_str(), 1);
  solvable_add_deparray(solvable, SOLVABLE_PROVIDES, pool_rel2id(pool_.get(), solvable->name, solvable->evr, REL_EQ, 1),
                        0);
  for (const auto& proto : manifest.offered()) solvable_add_deparray(solvable, SOLVABLE_PROVIDES, id_of(proto), 0);
  for (const auto& proto : manifest.shared())
    require(package, id_of(proto), "was compiled with another form of " + proto.name());
  for (const auto& text : manifest.requirements()) require(package, Requirement::parse(text, full_name(manifest)));
  for (const auto& text : manifest.conflicts()) {
    const Requirement conflict = Requirement::parse(text, full_name(manifest));
    const Id name = pool_str2id(pool_.get(), conflict.package.c_str(), 1);
    const auto& bounds = conflict.versions.bounds();
    const Id dependency = bounds.empty() ? name : relation(name, bounds.front());
    solvable_add_deparray(solvable, SOLVABLE_CONFLICTS, dependency, 0);
    clauses_[{package, dependency}] = "does not go together with " + conflict.text();
  }
  manifests_[package] = &manifest;
  packages_[&manifest] = package;
  indexed_ = false;
  // What is installed already was taken then, and stays.
  if (repo == installed_) return package;
  if (!manifest.library().empty() && manifest.abi() != platform_.abi) {
    require(package, pool_str2id(pool_.get(), ("abi:" + manifest.abi()).c_str(), 1),
            "is built for the ABI " + manifest.abi() + ", and this FIONA has " + platform_.abi);
  }
  if (!manifest.architecture().empty() && manifest.architecture() != platform_.architecture) {
    require(package, pool_str2id(pool_.get(), ("machine:" + manifest.architecture()).c_str(), 1),
            "is made for " + manifest.architecture() + ", and this machine is " + platform_.architecture);
  }
  const VersionRange hosts = VersionRange::parse(manifest.host(), full_name(manifest));
  for (const auto& bound : hosts.bounds()) {
    require(package, relation(pool_str2id(pool_.get(), "fiona", 1), bound),
            "works with FIONA " + hosts.text() + ", and this is " + platform_.version);
  }
  return package;
}

bool Solver::fits_platform(const Manifest& manifest) const {
  return (manifest.library().empty() || manifest.abi() == platform_.abi) &&
         (manifest.architecture().empty() || manifest.architecture() == platform_.architecture) &&
         VersionRange::parse(manifest.host(), "").has(*Version::parse(platform_.version));
}

Solver::Outcome Solver::solve(const Wanted& wanted) {
  if (!std::exchange(indexed_, true)) pool_createwhatprovides(pool_.get());
  Ids jobs;
  jobs.add(SOLVER_INSTALL | SOLVER_SOLVABLE, platform_package_);
  jobs.add(SOLVER_LOCK | SOLVER_SOLVABLE, platform_package_);
  for (const auto& requirement : wanted.install) {
    const Id name = pool_str2id(pool_.get(), requirement.package.c_str(), 1);
    if (requirement.versions.bounds().empty()) {
      jobs.add(SOLVER_INSTALL | SOLVER_SOLVABLE_NAME, name);
      jobs.add(SOLVER_UPDATE | SOLVER_SOLVABLE_NAME, name);
    }
    for (const auto& bound : requirement.versions.bounds())
      jobs.add(SOLVER_INSTALL | SOLVER_SOLVABLE_NAME, relation(name, bound));
  }
  for (const Manifest* manifest : wanted.exact) jobs.add(SOLVER_INSTALL | SOLVER_SOLVABLE, packages_.at(manifest));
  for (const auto& name : wanted.update)
    jobs.add(SOLVER_UPDATE | SOLVER_SOLVABLE_NAME, pool_str2id(pool_.get(), name.c_str(), 1));
  if (wanted.update_all) jobs.add(SOLVER_UPDATE | SOLVER_SOLVABLE_ALL, 0);
  const std::unique_ptr<::Solver, void (*)(::Solver*)> solver{solver_create(pool_.get()), solver_free};
  Outcome outcome;
  if (solver_solve(solver.get(), jobs.get()) != 0) {
    explain(solver.get(), outcome);
    return outcome;
  }
  Ids decisions;
  solver_get_decisionqueue(solver.get(), decisions.get());
  for (const Id decision : decisions) {
    const auto found = manifests_.find(decision);
    if (found != manifests_.end()) outcome.packages.push_back(found->second);
  }
  std::ranges::sort(outcome.packages, {}, [](const Manifest* manifest) { return full_name(*manifest); });
  return outcome;
}

void Solver::add_reason(std::map<std::string, Reason>& found, ::Solver* solver, Id rule) const {
  Id from = 0, to = 0, dependency = 0;
  const SolverRuleinfo kind = solver_ruleinfo(solver, rule, &from, &to, &dependency);
  const auto package = manifests_.find(from);
  if (package == manifests_.end()) return;
  const auto said = clauses_.find({from, dependency});
  if (said == clauses_.end()) return;
  std::string clause = said->second, missing;
  if (kind == SOLVER_RULE_PKG_NOTHING_PROVIDES_DEP && clause.starts_with("requires ")) {
    const std::string name = clause.substr(9, clause.find(' ', 9) - 9);
    std::string versions;
    for (const auto& [id, manifest] : manifests_) {
      if (full_name(*manifest) == name) versions += (versions.empty() ? "" : ", ") + manifest->version();
    }
    clause += versions.empty() ? ", which the marketplace does not have" : ", and there is only " + versions;
    if (versions.empty()) missing = name;
  }
  const Version version = *Version::parse(package->second->version());
  const bool is_installed = pool_id2solvable(pool_.get(), from)->repo == installed_;
  Reason& reason = found[full_name(*package->second) + " " + clause];
  if (reason.version && *reason.version > version) return;
  reason = {version, display(*package->second) + (is_installed ? ", which is installed, " : " ") + clause, is_installed,
            std::move(missing)};
}

void Solver::explain(::Solver* solver, Outcome& outcome) const {
  Ids rules;
  solver_findallproblemrules(solver, 1, rules.get());
  std::map<std::string, Reason> found;
  for (const Id rule : rules) add_reason(found, solver, rule);
  std::set<std::string> installed;
  for (auto& [key, reason] : found) {
    if (reason.installed) installed.insert(key.substr(0, key.find(' ')));
    if (!reason.missing.empty()) outcome.missing.push_back(std::move(reason.missing));
    outcome.reasons.push_back(std::move(reason.clause));
  }
  outcome.installed = {installed.begin(), installed.end()};
  if (outcome.reasons.empty()) outcome.reasons.emplace_back("no choice of versions meets all of it");
}

}  // namespace fiona::marketplace
