#include "reachable.hpp"

#include <utility>

namespace fiona::planning {
class Reaching {
 public:
  Reaching(const LiftedTask& task, Reachable& into, Pace& pace)
      : task_(task),
        into_(into),
        pace_(pace),
        index_(task.memory),
        objects_(task.memory),
        plans_(task.memory),
        plans_of_(task.memory),
        arguments_(task.memory),
        join_(task, into.atoms, index_, objects_) {}

  Async<> run() {
    auto sorted = sort_objects();
    co_await sorted;
    auto statics = add_init(true);
    co_await statics;
    into_.first_fluent = into_.atoms.size();
    auto fluents = add_init(false);
    co_await fluents;
    into_.first_reached = into_.atoms.size();
    auto planned = plan_joins();
    co_await planned;
    for (const JoinPlan& plan : plans_) {
      if (plan.trigger != kNone) continue;
      auto joined = join(plan, into_.first_fluent);
      co_await joined;
    }
    for (Index atom = into_.first_fluent; atom < into_.atoms.size(); ++atom) {
      for (const Index plan : plans_of_[into_.atoms.symbol(atom)]) {
        auto joined = join(plans_[plan], atom);
        co_await joined;
      }
    }
  }

 private:
  /// Only for the sets that parameters of actions have.
  Async<> sort_objects() {
    List<bool> wanted(task_.type_sets.size(), false, task_.memory);
    for (const Action& action : task_.actions)
      for (const Index set : action.parameter_types) wanted[set] = true;
    objects_.reserve(wanted.size());
    for (Index set = 0; set < wanted.size(); ++set) {
      ObjectSet& objects = objects_.emplace_back(task_.memory);
      if (!wanted[set]) continue;
      objects.bits.resize((task_.objects.size() + 63) / 64);
      for (Index object = 0; object < task_.objects.size(); ++object) {
        if (pace_.due()) co_await pace_.pause();
        if (!task_.type_sets[set].has(task_.object_types[object])) continue;
        objects.objects.push_back(object);
        objects.bits[object / 64] |= std::uint64_t{1} << (object % 64);
      }
    }
  }

  Async<> add_init(bool statics) {
    for (const Atom& atom : task_.init) {
      if (pace_.due()) co_await pace_.pause();
      if (task_.predicates[atom.symbol].is_static == statics) add(atom);
    }
  }

  Async<> plan_joins() {
    plans_of_.resize(task_.predicates.size());
    for (Index action = 0; action < task_.actions.size(); ++action) {
      const auto& conditions = task_.actions[action].conditions.positive;
      bool has_trigger = false;
      for (Index i = 0; i < conditions.size(); ++i) {
        if (task_.predicates[conditions[i].symbol].is_static) continue;
        has_trigger = true;
        if (pace_.look()) co_await pace_.pause();
        plans_of_[conditions[i].symbol].push_back(static_cast<Index>(plans_.size()));
        plans_.push_back(plan_join(task_, action, i));
      }
      if (!has_trigger) plans_.push_back(plan_join(task_, action, kNone));
    }
  }

  Async<> join(const JoinPlan& plan, Index atom) {
    join_.start(plan, atom);
    for (auto progress = join_.advance(); progress != Join::Progress::Done; progress = join_.advance()) {
      if (progress == Join::Progress::Found) add_instance(plan.action);
      if (pace_.due()) co_await pace_.pause();
    }
  }

  void add_instance(Index action) {
    into_.actions.push_back(action);
    into_.bindings.add(join_.binding());
    for (const Atom& atom : task_.actions[action].added) add(atom);
  }

  void add(const Atom& atom) {
    arguments_.clear();
    for (const Term term : task_.terms_of(atom))
      arguments_.push_back(term.is_object() ? term.index() : join_.binding()[term.index()]);
    const auto [number, is_new] = into_.atoms.insert(atom.symbol, arguments_);
    if (is_new) index_.add(atom.symbol, arguments_, number);
  }

  const LiftedTask& task_;
  Reachable& into_;
  Pace& pace_;
  AtomIndex index_;
  List<ObjectSet> objects_;
  List<JoinPlan> plans_;
  List<List<Index>> plans_of_;  ///< for each predicate those that it triggers
  List<Index> arguments_;
  Join join_;
};

Async<> reach(const LiftedTask& task, Reachable& reachable, Pace& pace) {
  Reaching reaching(task, reachable, pace);
  auto work = reaching.run();
  co_await work;
}

}  // namespace fiona::planning
