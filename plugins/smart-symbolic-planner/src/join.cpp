#include "join.hpp"

#include <algorithm>
#include <bit>
#include <tuple>

namespace fiona::planning {
namespace {

std::uint64_t bit(Index index) { return std::uint64_t{1} << index; }

/// Plans the joins of one action.
class JoinPlanner {
 public:
  JoinPlanner(const LiftedTask& task, Index action, Index trigger)
      : task_(task), action_(task.actions[action]), plan_(task.memory), waiting_(task.memory), tests_(task.memory) {
    plan_.action = action;
    plan_.trigger = trigger;
    for (Index i = 0; i < action_.conditions.positive.size(); ++i)
      if (i != trigger) waiting_.push_back(i);
    for (Index i = 0; i < action_.conditions.equalities.size(); ++i) tests_.push_back({true, i});
    for (Index i = 0; i < action_.conditions.negative.size(); ++i)
      if (task.predicates[action_.conditions.negative[i].symbol].is_static) tests_.push_back({false, i});
  }

  JoinPlan plan() {
    // A plan without trigger begins with a step that has nothing to do but the tests of constants.
    if (plan_.trigger == kNone) {
      add_step({JoinPlan::Kind::Check, kNone, 0, 0}, 0);
    } else {
      add_match(plan_.trigger);
    }
    while (!waiting_.empty()) {
      const auto best =
          std::max_element(waiting_.begin(), waiting_.end(), [this](Index a, Index b) { return rank(a) < rank(b); });
      const Index condition = *best;
      waiting_.erase(best);
      add_match(condition);
    }
    for (Index parameter = 0; parameter < action_.parameters.size(); ++parameter)
      if ((known_ & bit(parameter)) == 0) add_step({JoinPlan::Kind::Enumerate, parameter, 0, 0}, bit(parameter));
    return std::move(plan_);
  }

 private:
  std::uint64_t parameters_of(const Atom& atom) const {
    std::uint64_t parameters = 0;
    for (const Term term : task_.terms_of(atom))
      if (!term.is_object()) parameters |= bit(term.index());
    return parameters;
  }

  /// Which arguments are known.
  std::uint64_t bound_arguments(const Atom& atom) const {
    std::uint64_t bound = 0;
    std::uint64_t known = known_;
    Index place = 0;
    for (const Term term : task_.terms_of(atom)) {
      if (term.is_object() || (known & bit(term.index())) != 0) bound |= bit(place);
      if (!term.is_object()) known |= bit(term.index());
      ++place;
    }
    return bound;
  }

  std::tuple<bool, int, bool, int> rank(Index condition) const {
    const Atom& atom = action_.conditions.positive[condition];
    const int open = std::popcount(parameters_of(atom) & ~known_);
    return {open == 0, std::popcount(bound_arguments(atom)), task_.predicates[atom.symbol].is_static, -open};
  }

  void add_match(Index condition) {
    const Atom& atom = action_.conditions.positive[condition];
    const std::uint64_t parameters = parameters_of(atom);
    const bool is_known = (parameters & ~known_) == 0 && condition != plan_.trigger;
    add_step({is_known ? JoinPlan::Kind::Check : JoinPlan::Kind::Match, condition, bound_arguments(atom), 0},
             parameters);
  }

  void add_step(JoinPlan::Step step, std::uint64_t binds) {
    known_ |= binds;
    const auto can_wait = [this](const JoinPlan::Test& test) { return (needs(test) & ~known_) != 0; };
    const auto ready = std::stable_partition(tests_.begin(), tests_.end(), can_wait);
    plan_.tests.insert(plan_.tests.end(), ready, tests_.end());
    tests_.erase(ready, tests_.end());
    step.tests_end = static_cast<Index>(plan_.tests.size());
    plan_.steps.push_back(step);
  }

  std::uint64_t needs(const JoinPlan::Test& test) const {
    if (!test.is_equality) return parameters_of(action_.conditions.negative[test.what]);
    const Equality& equality = action_.conditions.equalities[test.what];
    return (equality.left.is_object() ? 0 : bit(equality.left.index())) |
           (equality.right.is_object() ? 0 : bit(equality.right.index()));
  }

  const LiftedTask& task_;
  const Action& action_;
  JoinPlan plan_;
  List<Index> waiting_;
  List<JoinPlan::Test> tests_;
  std::uint64_t known_ = 0;  ///< parameters
};

}  // namespace

JoinPlan plan_join(const LiftedTask& task, Index action, Index trigger) {
  return JoinPlanner(task, action, trigger).plan();
}

Join::Join(const LiftedTask& task, const AtomTable& atoms, const AtomIndex& index, const List<ObjectSet>& objects)
    : task_(task),
      atoms_(atoms),
      index_(index),
      objects_(objects),
      binding_(task.memory),
      frames_(task.memory),
      scratch_(task.memory) {}

void Join::start(const JoinPlan& plan, Index atom) {
  plan_ = &plan;
  action_ = &task_.actions[plan.action];
  atom_ = atom;
  binding_.assign(action_->parameters.size(), kNone);
  frames_.assign(plan.steps.size(), {});
  depth_ = 0;
  done_ = false;
}

Join::Progress Join::advance() {
  if (done_) return Progress::Done;
  bool has_more = true;
  const bool fits = try_next(depth_, has_more);
  if (!has_more) {
    done_ = depth_ == 0;
    if (!done_) --depth_;
    return done_ ? Progress::Done : Progress::More;
  }
  if (!fits || !tests_pass(depth_)) return Progress::More;
  if (depth_ + 1 == plan_->steps.size()) return Progress::Found;
  open(++depth_);
  return Progress::More;
}

void Join::open(std::size_t depth) {
  const JoinPlan::Step& step = plan_->steps[depth];
  Frame& frame = frames_[depth];
  frame = {};
  if (step.kind == JoinPlan::Kind::Check) return;
  if (step.kind == JoinPlan::Kind::Enumerate) {
    frame.candidates = &objects_[action_->parameter_types[step.what]].objects;
    return;
  }
  const Atom& pattern = action_->conditions.positive[step.what];
  frame.candidates = &index_.with(pattern.symbol);
  const auto terms = task_.terms_of(pattern);
  for (Index place = 0; place < terms.size(); ++place) {
    // What is bound by an earlier argument of the same atom has no value yet.
    if ((step.bound & bit(place)) == 0) continue;
    const bool is_repeated =
        !terms[place].is_object() && std::any_of(terms.begin(), terms.begin() + place, [&](const Term& earlier) {
          return !earlier.is_object() && earlier.index() == terms[place].index();
        });
    if (is_repeated) continue;
    const auto& shorter = index_.with(pattern.symbol, place, object_of(terms[place]));
    if (shorter.size() < frame.candidates->size()) frame.candidates = &shorter;
  }
}

/// Whether the next candidate of this step fits.
bool Join::try_next(std::size_t depth, bool& has_more) {
  const JoinPlan::Step& step = plan_->steps[depth];
  Frame& frame = frames_[depth];
  if (depth == 0 || step.kind == JoinPlan::Kind::Check) {
    has_more = frame.next++ == 0;
    if (!has_more || step.what == kNone) return has_more;
    const Atom& pattern = action_->conditions.positive[step.what];
    if (depth == 0) return match(pattern, step.bound, atom_);
    const Index atom = atoms_.find(pattern.symbol, arguments_of(pattern));
    return atom != kNone && is_among(step.what, atom);
  }
  has_more = frame.next < frame.candidates->size();
  if (!has_more) return false;
  const Index candidate = (*frame.candidates)[frame.next++];
  if (step.kind == JoinPlan::Kind::Enumerate) {
    binding_[step.what] = candidate;
    return true;
  }
  has_more = is_among(step.what, candidate);  // the candidates ascend
  return has_more && match(action_->conditions.positive[step.what], step.bound, candidate);
}

bool Join::is_among(Index condition, Index atom) const {
  return atom < atom_ || (plan_->trigger != kNone && condition > plan_->trigger && atom == atom_);
}

bool Join::match(const Atom& pattern, std::uint64_t bound, Index atom) {
  const auto terms = task_.terms_of(pattern);
  const auto arguments = atoms_.arguments(atom);
  for (Index place = 0; place < terms.size(); ++place) {
    const Term term = terms[place];
    if ((bound & bit(place)) != 0) {
      if (object_of(term) != arguments[place]) return false;
    } else if (!objects_[action_->parameter_types[term.index()]].has(arguments[place])) {
      return false;
    } else {
      binding_[term.index()] = arguments[place];
    }
  }
  return true;
}

bool Join::tests_pass(std::size_t depth) const {
  const Index begin = depth == 0 ? 0 : plan_->steps[depth - 1].tests_end;
  for (Index i = begin; i < plan_->steps[depth].tests_end; ++i) {
    const JoinPlan::Test& test = plan_->tests[i];
    if (test.is_equality) {
      const Equality& equality = action_->conditions.equalities[test.what];
      if ((object_of(equality.left) == object_of(equality.right)) != equality.holds) return false;
    } else {
      const Atom& atom = action_->conditions.negative[test.what];
      if (atoms_.find(atom.symbol, arguments_of(atom)) != kNone) return false;
    }
  }
  return true;
}

std::span<const Index> Join::arguments_of(const Atom& pattern) const {
  scratch_.clear();
  for (const Term term : task_.terms_of(pattern)) scratch_.push_back(object_of(term));
  return scratch_;
}

}  // namespace fiona::planning
