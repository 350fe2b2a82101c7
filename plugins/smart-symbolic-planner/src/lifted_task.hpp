#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory_resource>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "fiona/async.hpp"

namespace fiona::planning {

class Pace;

using Index = std::uint32_t;
inline constexpr Index kNone = ~Index{0};

/// Costs are kept exactly, in millionths.
using Cost = std::int64_t;
inline constexpr Cost kCostUnit = 1'000'000;
/// All costs and sums of them are below it: those that are not stay just below.
inline constexpr Cost kNoCost = Cost{1} << 60;
inline Cost sum(Cost a, Cost b) { return std::min(a + b, kNoCost - 1); }

/// What one text may have of each; all else is bounded by memory.
inline constexpr std::size_t kMostTypes = 4096;
inline constexpr std::size_t kMostParents = 4 * kMostTypes;
inline constexpr std::size_t kMostParameters = 64;
inline constexpr std::size_t kMostConditions = 512;
inline constexpr std::size_t kDeepestNesting = 100;
inline constexpr Cost kMostCost = 1'000'000'000 * kCostUnit;

template <class T>
using List = std::pmr::vector<T>;

/// A parameter of an action, or an object.
class Term {
 public:
  static Term parameter(Index index) { return Term(index); }
  static Term object(Index index) { return Term(index | kObject); }
  bool is_object() const { return (value_ & kObject) != 0; }
  Index index() const { return value_ & ~kObject; }

 private:
  static constexpr Index kObject = Index{1} << 31;
  explicit Term(Index value) : value_(value) {}
  Index value_;
};

/// A predicate or function with its arguments, of which the task has a list.
struct Atom {
  Index symbol = 0;
  Index first_term = 0;
  Index term_count = 0;
  std::size_t offset = 0;  ///< in the text that has it
};

struct Equality {
  Term left;
  Term right;
  bool holds = true;  ///< false: they must differ
};

/// What an action adds to the total cost: a number, or the value of a function.
struct CostTerm {
  Cost number = 0;
  Atom function{};
  bool is_function = false;
};

struct Symbol {
  explicit Symbol(std::pmr::memory_resource* memory) : parameter_types(memory) {}
  std::string_view name{};
  List<Index> parameter_types;  ///< sets of types
  bool is_static = true;        ///< no action changes it
};

struct Conditions {
  explicit Conditions(std::pmr::memory_resource* memory) : positive(memory), negative(memory), equalities(memory) {}
  std::size_t size() const { return positive.size() + negative.size() + equalities.size(); }
  List<Atom> positive;
  List<Atom> negative;
  List<Equality> equalities;
};

struct Action {
  explicit Action(std::pmr::memory_resource* memory)
      : parameters(memory),
        parameter_types(memory),
        conditions(memory),
        added(memory),
        deleted(memory),
        costs(memory) {}
  std::string_view name{};
  List<std::string_view> parameters;
  List<Index> parameter_types;  ///< sets of types
  Conditions conditions;
  List<Atom> added;
  List<Atom> deleted;
  List<CostTerm> costs;
};

/// A set of types: those named, and all that are kinds of them.
struct TypeSet {
  explicit TypeSet(std::pmr::memory_resource* memory) : bits(memory) {}
  bool has(Index type) const { return (bits[type / 64] >> (type % 64) & 1) != 0; }
  List<std::uint64_t> bits;
};

/// A planning task as its two texts say it: actions with parameters. Its names are views into the texts, in lower case,
/// which it holds itself.
struct LiftedTask {
  explicit LiftedTask(std::pmr::memory_resource* memory);
  LiftedTask(const LiftedTask&) = delete;
  LiftedTask& operator=(const LiftedTask&) = delete;

  std::span<const Term> terms_of(const Atom& atom) const { return {terms.data() + atom.first_term, atom.term_count}; }

  std::pmr::memory_resource* memory;
  std::pmr::string domain_text;
  std::pmr::string problem_text;
  std::string_view domain_name{};

  List<std::string_view> types;  ///< the first is `object`
  List<TypeSet> type_sets;       ///< the first ones are those of one type each, in its order; then those with `either`
  List<std::string_view> objects;
  List<Index> object_types;
  List<Symbol> predicates;
  List<Symbol> functions;
  List<Action> actions;
  List<Term> terms;

  List<Atom> init;  ///< without arguments that are parameters
  List<std::pair<Atom, Cost>> values;
  Conditions goal;
  bool has_metric = false;  ///< else each action costs one

  /// Not hashed: names come from outside, and may be chosen to collide.
  using Names = std::pmr::map<std::string_view, Index>;
  Names type_index, object_index, predicate_index, function_index, action_index;
  Index total_cost = kNone;  ///< the function of that name
};

/// Reads the domain into an empty task, then the problem. Throw PddlError, OutOfTime, OutOfMemory. Only the initial
/// state can be so long that reading it has pauses.
void read_domain(LiftedTask& task, std::string_view text, Pace& pace);
Async<> read_problem(LiftedTask& task, std::string_view text, Pace& pace);

}  // namespace fiona::planning
