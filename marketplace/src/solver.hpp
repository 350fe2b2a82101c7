#pragma once

#include <solv/pooltypes.h>

#include <fiona/marketplace/plan.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

struct s_Pool;
struct s_Repo;
struct s_Solver;

namespace fiona::marketplace {

/// Chooses versions of packages that can be installed together, with libsolv. Packages that are offered for another
/// ABI, machine or version of FIONA are candidates that lack something: that way a refusal can say what.
class Solver {
 public:
  explicit Solver(const Platform& platform);
  ~Solver();
  Solver(const Solver&) = delete;
  Solver& operator=(const Solver&) = delete;

  /// A package that is there, and stays in this version or a newer one; the manifest must outlive this object.
  void add_installed(const Manifest& manifest);
  /// One that could be installed; likewise.
  void add_offered(const Manifest& manifest);

  struct Wanted {
    std::vector<Requirement> install{};    ///< in any version of these, the newest if possible
    std::vector<const Manifest*> exact{};  ///< these offered ones and no others of their names
    std::vector<std::string> update{};     ///< full names of installed packages
    bool update_all = false;
  };
  struct Outcome {
    std::vector<const Manifest*> packages;  ///< what is there then, kept ones as they were given
    std::vector<std::string> reasons;       ///< if nothing fits: why, each a clause: "acme/nav 2.0.0 requires …"
    std::vector<std::string> installed;     ///< and of those that stand in the way, the installed ones
    std::vector<std::string> missing;       ///< and packages that are required and that nobody offers
    bool solved() const { return reasons.empty(); }
  };
  Outcome solve(const Wanted& wanted);

  /// Whether this offered package fits the platform, whatever else is there.
  bool fits_platform(const Manifest& manifest) const;

 private:
  struct Reason;
  using PoolPointer = std::unique_ptr<s_Pool, void (*)(s_Pool*)>;

  Id add(s_Repo* repo, const Manifest& manifest);
  Id id_of(const CompiledProto& proto);
  Id relation(Id name, const VersionRange::Bound& bound);
  void require(Id package, const Requirement& requirement);
  void require(Id package, Id dependency, std::string clause);
  void explain(s_Solver* solver, Outcome& outcome) const;
  void add_reason(std::map<std::string, Reason>& found, s_Solver* solver, Id rule) const;

  const Platform& platform_;
  PoolPointer pool_;
  s_Repo* installed_;
  s_Repo* offered_;
  Id platform_package_ = 0;
  bool indexed_ = false;
  std::map<Id, const Manifest*> manifests_;
  std::map<const Manifest*, Id> packages_;
  std::map<std::pair<Id, Id>, std::string> clauses_;  // of package and dependency: "requires acme/maps >= 2.0.0"
};

/// A semantic version as Debian's order compares it: the same order for any two. The '-' before a pre-release becomes
/// '~', build metadata is left out, and its words become letters that compare as the words do.
std::string debian_version(const Version& version);

}  // namespace fiona::marketplace
