#include "grounder.hpp"

#include <algorithm>
#include <utility>

#include "pddl_error.hpp"
#include "pruner.hpp"
#include "reachable.hpp"

namespace fiona::planning {
/// Makes facts of atoms and operators of instances.
class Grounder {
 public:
  Grounder(const LiftedTask& task, const Reachable& reachable, GroundTask& into, Pace& pace)
      : task_(task),
        reachable_(reachable),
        into_(into),
        pace_(pace),
        deletable_(reachable.atoms.size(), false, task.memory),
        fact_of_(reachable.atoms.size(), kNone, task.memory),
        absence_of_(reachable.atoms.size(), kNone, task.memory),
        values_(task.memory),
        costs_(task.memory),
        arguments_(task.memory),
        needs_(task.memory),
        adds_(task.memory),
        deletes_(task.memory),
        absent_(task.memory) {}

  Async<> run() {
    for (const auto& [function, value] : task_.values) {
      const auto [number, is_new] = values_.insert(function.symbol, ground_arguments(function, {}));
      if (is_new) costs_.push_back(value);
      costs_[number] = value;
    }
    auto looked_at = look_at_deletes();
    co_await looked_at;
    auto absent = number_absences();
    co_await absent;
    number_facts();
    add_goal();
    if (!into_.is_solvable) co_return;
    for (Index instance = 0; instance < reachable_.actions.size(); ++instance) {
      if (pace_.due()) co_await pace_.pause();
      add_operator(instance);
    }
  }

 private:
  std::span<const Index> ground_arguments(const Atom& atom, std::span<const Index> binding) {
    arguments_.clear();
    for (const Term term : task_.terms_of(atom))
      arguments_.push_back(term.is_object() ? term.index() : binding[term.index()]);
    return arguments_;
  }
  Index number_of(const Atom& atom, std::span<const Index> binding) {
    return reachable_.atoms.find(atom.symbol, ground_arguments(atom, binding));
  }
  const Action& action_of(Index instance) const { return task_.actions[reachable_.actions[instance]]; }
  bool is_in_init(Index atom) const { return atom < reachable_.first_reached; }
  bool always_holds(Index atom) const { return is_in_init(atom) && !deletable_[atom]; }

  Async<> look_at_deletes() {
    for (Index instance = 0; instance < reachable_.actions.size(); ++instance) {
      if (pace_.due()) co_await pace_.pause();
      const Action& action = action_of(instance);
      if (action.deleted.empty()) continue;
      adds_.clear();
      for (const Atom& atom : action.added) adds_.push_back(number_of(atom, reachable_.bindings[instance]));
      for (const Atom& atom : action.deleted) {
        const Index number = number_of(atom, reachable_.bindings[instance]);
        if (number != kNone && std::find(adds_.begin(), adds_.end(), number) == adds_.end()) deletable_[number] = true;
      }
    }
  }

  void want_absence(const Atom& atom, std::span<const Index> binding) {
    const Index number = number_of(atom, binding);
    if (number != kNone && !always_holds(number) && absence_of_[number] == kNone)
      absence_of_[number] = into_.fact_count++;
  }

  /// Facts for what some operator or the goal needs not to hold, and which now and then does.
  Async<> number_absences() {
    for (const Atom& atom : task_.goal.negative) want_absence(atom, {});
    for (Index instance = 0; instance < reachable_.actions.size(); ++instance) {
      if (pace_.due()) co_await pace_.pause();
      for (const Atom& atom : action_of(instance).conditions.negative)
        want_absence(atom, reachable_.bindings[instance]);
    }
  }

  void number_facts() {
    for (Index atom = reachable_.first_fluent; atom < reachable_.atoms.size(); ++atom) {
      if (always_holds(atom)) continue;
      fact_of_[atom] = into_.fact_count++;
      if (is_in_init(atom)) {
        into_.init.push_back(fact_of_[atom]);
      } else if (absence_of_[atom] != kNone) {
        into_.init.push_back(absence_of_[atom]);
      }
    }
    std::sort(into_.init.begin(), into_.init.end());
  }

  void add_goal() {
    for (const Equality& equality : task_.goal.equalities)
      into_.is_solvable &= (equality.left.index() == equality.right.index()) == equality.holds;
    for (const Atom& atom : task_.goal.positive) {
      const Index number = number_of(atom, {});
      into_.is_solvable &= number != kNone;
      if (number != kNone && !always_holds(number)) into_.goal.push_back(fact_of_[number]);
    }
    for (const Atom& atom : task_.goal.negative) {
      const Index number = number_of(atom, {});
      if (number == kNone) continue;
      into_.is_solvable &= !always_holds(number);
      if (!always_holds(number)) into_.goal.push_back(absence_of_[number]);
    }
    sort_unique(into_.goal);
  }

  static void sort_unique(List<Index>& list) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
  static void remove(List<Index>& from, const List<Index>& sorted) {
    std::erase_if(from, [&](Index fact) { return std::binary_search(sorted.begin(), sorted.end(), fact); });
  }

  void add_operator(Index instance) {
    const Action& action = action_of(instance);
    const auto binding = reachable_.bindings[instance];
    if (!find_needs(action, binding)) return;
    find_effects(action, binding);
    if (adds_.empty()) return;
    into_.costs.push_back(cost_of(action, binding));
    into_.needs.add(needs_);
    into_.adds.add(adds_);
    into_.deletes.add(deletes_);
    into_.actions.push_back(reachable_.actions[instance]);
    into_.arguments.add(binding);
  }

  /// False: they cannot all hold.
  bool find_needs(const Action& action, std::span<const Index> binding) {
    needs_.clear();
    for (const Atom& atom : action.conditions.positive) {
      if (task_.predicates[atom.symbol].is_static) continue;
      if (const Index number = number_of(atom, binding); !always_holds(number)) needs_.push_back(fact_of_[number]);
    }
    for (const Atom& atom : action.conditions.negative) {
      const Index number = number_of(atom, binding);
      if (number == kNone) continue;
      if (always_holds(number)) return false;
      needs_.push_back(absence_of_[number]);
    }
    sort_unique(needs_);
    return true;
  }

  /// What is added and deleted at once holds afterwards.
  void find_effects(const Action& action, std::span<const Index> binding) {
    adds_.clear();
    deletes_.clear();
    for (const Atom& atom : action.added) {
      const Index number = number_of(atom, binding);
      if (always_holds(number)) continue;
      adds_.push_back(fact_of_[number]);
      if (absence_of_[number] != kNone) deletes_.push_back(absence_of_[number]);
    }
    sort_unique(adds_);
    absent_.clear();
    for (const Atom& atom : action.deleted) {
      const Index number = number_of(atom, binding);
      if (number == kNone || always_holds(number)) continue;
      if (std::binary_search(adds_.begin(), adds_.end(), fact_of_[number])) continue;
      deletes_.push_back(fact_of_[number]);
      if (absence_of_[number] != kNone) absent_.push_back(absence_of_[number]);
    }
    adds_.insert(adds_.end(), absent_.begin(), absent_.end());
    sort_unique(adds_);
    sort_unique(deletes_);
    remove(deletes_, adds_);
    remove(adds_, needs_);
  }

  Cost cost_of(const Action& action, std::span<const Index> binding) {
    if (!task_.has_metric) return kCostUnit;
    Cost total = 0;
    for (const CostTerm& term : action.costs) {
      if (!term.is_function) {
        total = sum(total, term.number);
        continue;
      }
      const Index value = values_.find(term.function.symbol, ground_arguments(term.function, binding));
      if (value == kNone) fail_without_value(action, binding, term.function);
      total = sum(total, costs_[value]);
    }
    return total;
  }

  [[noreturn]] void fail_without_value(const Action& action, std::span<const Index> binding, const Atom& function) {
    static constexpr std::size_t kLongest = 1000;
    std::string step(action.name), term(task_.functions[function.symbol].name);
    for (const Index object : binding)
      if (step.size() < kLongest) step += ' ' + std::string(task_.objects[object]);
    for (const Index object : ground_arguments(function, binding))
      if (term.size() < kLongest) term += ' ' + std::string(task_.objects[object]);
    throw PddlError(place_of(Text::Domain, task_.domain_text, function.offset),
                    {.what = "the cost of (" + step.substr(0, kLongest) + ") is (" + term.substr(0, kLongest) +
                             "), which has no value in the problem",
                     .next = "add it to :init, (= (" + term.substr(0, kLongest) + ") NUMBER)"});
  }

  const LiftedTask& task_;
  const Reachable& reachable_;
  GroundTask& into_;
  Pace& pace_;
  List<bool> deletable_;
  List<Index> fact_of_;     ///< of an atom; kNone: it always holds
  List<Index> absence_of_;  ///< the fact that it does not hold; kNone: nobody needs that
  AtomTable values_;
  List<Cost> costs_;
  List<Index> arguments_;
  List<Index> needs_, adds_, deletes_, absent_;
};

Async<> ground(const LiftedTask& task, GroundTask& ground_task, Pace& pace) {
  Reachable reachable(task.memory);
  auto reached = reach(task, reachable, pace);
  co_await reached;
  Grounder grounder(task, reachable, ground_task, pace);
  auto grounded = grounder.run();
  co_await grounded;
  if (!ground_task.is_solvable) co_return;
  auto pruned = prune(ground_task, pace, task.memory);
  co_await pruned;
}

}  // namespace fiona::planning
