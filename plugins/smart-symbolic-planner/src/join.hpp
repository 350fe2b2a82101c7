#pragma once

#include <span>

#include "atom_table.hpp"

namespace fiona::planning {

/// The objects of a set of types.
struct ObjectSet {
  explicit ObjectSet(std::pmr::memory_resource* memory) : objects(memory), bits(memory) {}
  bool has(Index object) const { return (bits[object / 64] >> (object % 64) & 1) != 0; }
  List<Index> objects;
  List<std::uint64_t> bits;
};

/// In which order the parameters of an action are bound, once one of its positive conditions (the trigger) is: what is
/// bound already first, then what is bound most, static predicates before others; parameters that no condition binds
/// run over all objects of their types, last.
struct JoinPlan {
  enum class Kind : std::uint8_t { Check, Match, Enumerate };
  struct Step {
    Kind kind = Kind::Check;
    Index what = 0;           ///< a positive condition; Enumerate: a parameter
    std::uint64_t bound = 0;  ///< Match: which of its arguments are bound before
    Index tests_end = 0;      ///< from the step before to here: the tests that can be made now
  };
  /// Something that is known as soon as its terms are: an equality, or a static predicate that must not hold.
  struct Test {
    bool is_equality = false;
    Index what = 0;
  };

  explicit JoinPlan(std::pmr::memory_resource* memory) : steps(memory), tests(memory) {}
  Index action = 0;
  Index trigger = kNone;  ///< kNone: all its positive conditions are static
  List<Step> steps;       ///< the first is the trigger's
  List<Test> tests;
};

JoinPlan plan_join(const LiftedTask& task, Index action, Index trigger);

/// Finds the ways to bind an action's parameters, one small piece of work at a time.
class Join {
 public:
  enum class Progress : std::uint8_t { Found, More, Done };

  Join(const LiftedTask& task, const AtomTable& atoms, const AtomIndex& index, const List<ObjectSet>& objects);

  /// With `atom` as the trigger's, of the atoms up to it: then each binding is found once, with its newest atom as the
  /// trigger's. Without trigger, of the atoms before `atom`.
  void start(const JoinPlan& plan, Index atom);
  /// Found: `binding` is one. Done: there are no more.
  Progress advance();
  /// An object for each parameter.
  std::span<const Index> binding() const { return binding_; }

 private:
  struct Frame {
    const List<Index>* candidates = nullptr;  ///< none: a Check
    std::size_t next = 0;
  };

  void open(std::size_t depth);
  bool try_next(std::size_t depth, bool& has_more);
  bool match(const Atom& pattern, std::uint64_t bound, Index atom);
  bool is_among(Index condition, Index atom) const;
  bool tests_pass(std::size_t depth) const;
  Index object_of(Term term) const { return term.is_object() ? term.index() : binding_[term.index()]; }
  std::span<const Index> arguments_of(const Atom& pattern) const;

  const LiftedTask& task_;
  const AtomTable& atoms_;
  const AtomIndex& index_;
  const List<ObjectSet>& objects_;
  const JoinPlan* plan_ = nullptr;
  const Action* action_ = nullptr;
  Index atom_ = kNone;
  List<Index> binding_;
  List<Frame> frames_;
  mutable List<Index> scratch_;
  std::size_t depth_ = 0;
  bool done_ = true;
};

}  // namespace fiona::planning
