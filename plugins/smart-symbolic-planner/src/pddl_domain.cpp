#include <algorithm>
#include <utility>

#include "pddl_terms.hpp"

namespace fiona::planning {
namespace {

using Word = PddlReader::Word;

class DomainReader {
 public:
  DomainReader(LiftedTask& task, Pace& pace)
      : task_(task), in_(Text::Domain, task.domain_text, pace), terms_(task, in_), parents_(1, task.memory) {}

  void read() {
    auto sections =
        terms_.sections("domain", task_.domain_name,
                        {":requirements", ":types", ":constants", ":predicates", ":functions", ":action"}, ":action");
    const auto in_each = [&](std::string_view keyword, auto read) {
      for (const auto& section : sections) {
        if (section.keyword != keyword) continue;
        in_.go_to(section.inside);
        read(section);
      }
    };
    // Some authors have them in another order than the one in which they need each other.
    in_each(":requirements", [&](const auto&) { terms_.requirements(); });
    in_each(":types", [&](const auto& section) { types(section.inside); });
    close_types();
    in_each(":constants", [&](const auto&) { terms_.objects(); });
    in_each(":predicates", [&](const auto&) { predicates(); });
    in_each(":functions", [&](const auto&) { functions(); });
    in_each(":action", [&](const auto&) { action(); });
    for (const Action& action : task_.actions) {
      for (const auto* effects : {&action.added, &action.deleted})
        for (const Atom& atom : *effects) task_.predicates[atom.symbol].is_static = false;
    }
  }

 private:
  void add_type(const Word& word) {
    if (!task_.type_index.try_emplace(word.text, static_cast<Index>(task_.types.size())).second) return;
    if (task_.types.size() > kMostTypes)  // the first is `object`, which nobody wrote
      in_.fail(word, "a domain has at most " + std::to_string(kMostTypes) + " types",
               "leave out those that no parameter has");
    task_.types.push_back(word.text);
    parents_.emplace_back();
  }

  // A type that is only named as another's parent is one too.
  void types(std::size_t begin) {
    List<Word> waiting(task_.memory);
    while (true) {
      const Word word = in_.next();
      if (word == ")") break;
      if (word == "-" && !waiting.empty()) {
        parents_of(waiting);
        waiting.clear();
      } else if (word.is_name()) {
        add_type(word);
        waiting.push_back(word);
      } else {
        in_.fail_expected(word, "a type, '- TYPE' or ')'");
      }
    }
    check_acyclic(begin);
  }

  void parents_of(const List<Word>& children) {
    const auto parent = [&](const Word& word) {
      add_type(word);
      const Index index = task_.type_index.at(word.text);
      for (const Word& child : children) {
        const Index child_index = task_.type_index.at(child.text);
        if (child_index == index && index != 0)
          in_.fail(child, "the type " + quoted(child.text) + " is its own parent",
                   "take the parent away, or name another one");
        if (child_index == 0 && index != 0)
          in_.fail(child, "'object' is the kind of all types, and of no other kind", "declare it without a parent");
        parents_[child_index].push_back(index);
        if (++parent_count_ > kMostParents)
          in_.fail(word, "the types have too many parents", "name each parent once, and no parent's parent");
      }
    };
    if (!in_.take("(")) return parent(in_.name("a type, or '(either TYPE ...)'"));
    in_.expect("either", "'either'");
    do parent(in_.name("a type"));
    while (!in_.take(")"));
  }

  /// What is a kind of itself has no kind: found by taking away, again and again, what has no parents left.
  void check_acyclic(std::size_t begin) {
    std::vector<std::size_t> left(parents_.size());
    std::vector<std::vector<Index>> children(parents_.size());
    std::vector<Index> done;
    for (Index type = 0; type < parents_.size(); ++type) {
      for (const Index parent : parents_[type]) {
        if (type == 0) continue;
        children[parent].push_back(type);
        ++left[type];
      }
      if (left[type] == 0) done.push_back(type);
    }
    for (std::size_t i = 0; i < done.size(); ++i) {
      for (const Index child : children[done[i]])
        if (--left[child] == 0) done.push_back(child);
    }
    if (done.size() == parents_.size()) return;
    const auto cyclic = std::find_if(left.begin(), left.end(), [](std::size_t count) { return count > 0; });
    in_.fail(begin, {.what = "the type " + quoted(task_.types[static_cast<std::size_t>(cyclic - left.begin())]) +
                             " is a kind of itself, by way of its parents",
                     .next = "take one of the parents on that way out"});
  }

  /// The first type sets: of each type, with what is a kind of it.
  void close_types() {
    const std::size_t count = task_.types.size();
    parents_.resize(count);
    task_.type_sets.reserve(count);
    for (std::size_t type = 0; type < count; ++type) {
      task_.type_sets.emplace_back(task_.memory);
      task_.type_sets.back().bits.resize((count + 63) / 64);
    }
    std::vector<Index> open;
    std::vector<Index> seen_by(count, kNone);
    for (Index type = 0; type < count; ++type) {
      open.assign({type, 0});
      while (!open.empty()) {
        const Index kind = open.back();
        open.pop_back();
        if (std::exchange(seen_by[kind], type) == type) continue;
        task_.type_sets[kind].bits[type / 64] |= std::uint64_t{1} << (type % 64);
        open.insert(open.end(), parents_[kind].begin(), parents_[kind].end());
      }
    }
  }

  void parameters(std::string_view of, List<std::string_view>* names, List<Index>& types) {
    std::size_t count = 0;
    terms_.typed_list(
        [&](const Word& word) {
          if (++count > kMostParameters)
            in_.fail(word, quoted(of) + " has more than " + std::to_string(kMostParameters) + " parameters",
                     "make two of it");
          if (!names) return;
          if (std::find(names->begin(), names->end(), word.text) != names->end())
            in_.fail(word, "the parameter " + quoted(word.text) + " is declared twice",
                     "give one of them another name");
          names->push_back(word.text);
        },
        [&](Index set) { types.resize(count, set); }, true);
  }

  Index symbol(List<Symbol>& symbols, LiftedTask::Names& names, const Word& name, std::string_view kind) {
    const auto index = static_cast<Index>(symbols.size());
    if (!names.try_emplace(name.text, index).second)
      in_.fail(name, "the " + std::string(kind) + " " + quoted(name.text) + " is declared twice",
               "take one out, or give it another name");
    symbols.emplace_back(task_.memory).name = name.text;
    parameters(name.text, nullptr, symbols.back().parameter_types);
    return index;
  }

  void predicates() {
    while (!in_.take(")")) {
      in_.expect("(", "a predicate, '(NAME ...)', or ')'");
      const Word name = in_.name("the name of a predicate");
      if (name == "=")
        in_.fail(name, "'=' is a predicate already, of every domain", "take it out: with :equality it can be used");
      symbol(task_.predicates, task_.predicate_index, name, "predicate");
    }
  }

  void functions() {
    while (!in_.take(")")) {
      if (in_.take("-")) {
        const Word type = in_.next();
        if (type.text != "number") in_.fail_expected(type, "'number', the type that functions have");
        continue;
      }
      in_.expect("(", "a function, '(NAME ...)', '- number' or ')'");
      const Word name = in_.name("the name of a function");
      const Index index = symbol(task_.functions, task_.function_index, name, "function");
      if (name.text != "total-cost") continue;
      if (!task_.functions[index].parameter_types.empty())
        in_.fail(name, "'total-cost' takes no arguments", "declare it as (total-cost)");
      task_.total_cost = index;
    }
  }

  void action() {
    const Word name = in_.name("the name of an action");
    if (!task_.action_index.try_emplace(name.text, static_cast<Index>(task_.actions.size())).second)
      in_.fail(name, "the action " + quoted(name.text) + " is declared twice", "take one out, or give it another name");
    Action& action = task_.actions.emplace_back(task_.memory);
    action.name = name.text;
    terms_.use_parameters_of(&action);
    bool has_parameters = false, has_condition = false, has_effect = false;
    for (Word word = in_.next(); word.text != ")"; word = in_.next()) {
      const auto once = [&](bool& has) {
        if (std::exchange(has, true))
          in_.fail(word, "a second " + quoted(word.text) + " of the action " + quoted(name.text),
                   "take one out, or make one of both with 'and'");
      };
      if (word == ":parameters") {
        once(has_parameters);
        if (has_condition || has_effect)
          in_.fail(word, "':parameters' stands before what uses them", "move it to the front of the action");
        in_.expect("(", "the parameters, '(?NAME - TYPE ...)'");
        parameters(name.text, &action.parameters, action.parameter_types);
      } else if (word == ":precondition") {
        once(has_condition);
        terms_.conditions(action.conditions);
      } else if (word == ":effect") {
        once(has_effect);
        effects(action);
      } else {
        in_.fail_expected(word, "':parameters', ':precondition', ':effect' or ')'");
      }
    }
    terms_.use_parameters_of(nullptr);
  }

  void effects(Action& action) {
    in_.expect("(", "an effect, '(...)'");
    if (!in_.take(")")) effect(action, true, 0);
  }

  /// Behind its '('.
  void effect(Action& action, bool adds, std::size_t depth) {
    const Word word = in_.next();
    if (depth > kDeepestNesting)
      in_.fail(word, "effects are nested more than " + std::to_string(kDeepestNesting) + " deep",
               "write the inner 'and' as a part of the outer one");
    if (word == "and" && adds) {
      while (!in_.take(")")) {
        in_.expect("(", "an effect, '(...)', or ')'");
        effect(action, true, depth + 1);
      }
    } else if (word == "not" && adds) {
      in_.expect("(", "an atom, '(PREDICATE ...)'");
      effect(action, false, depth + 1);
      in_.expect(")", "')' behind the atom of 'not'");
    } else if (word == "increase" && adds) {
      increase(action);
    } else {
      atom_effect(action, word, adds);
    }
    if (action.added.size() + action.deleted.size() + action.costs.size() > kMostConditions)
      in_.fail(word, "an action has at most " + std::to_string(kMostConditions) + " effects", "make two actions of it");
  }

  void atom_effect(Action& action, const Word& word, bool adds) {
    if (!task_.predicate_index.contains(word.text)) {
      if (word == "when") in_.fail(word, "'when' needs :conditional-effects, which is not supported", kTakes);
      if (word == "forall")
        in_.fail(word, "'forall' in an effect needs :conditional-effects, which is not supported", kTakes);
      if (word == "assign" || word == "decrease" || word == "scale-up" || word == "scale-down")
        in_.fail(word, quoted(word.text) + " needs :numeric-fluents, which is not supported", kTakes);
    }
    if (!word.is_name() || word == "and" || word == "not" || word == "=")
      in_.fail_expected(word, adds ? "a predicate, 'and', 'not' or 'increase'" : "a predicate");
    (adds ? action.added : action.deleted).push_back(terms_.predicate(word));
  }

  void increase(Action& action) {
    in_.expect("(", "'(total-cost)'");
    const Word target = in_.next();
    if (target.text != "total-cost" || task_.total_cost == kNone)
      in_.fail(target,
               task_.total_cost == kNone ? "'total-cost' is not declared" : "only 'total-cost' can be increased",
               task_.total_cost == kNone ? kDeclareCost : "write (increase (total-cost) NUMBER)");
    in_.expect(")", "')' behind 'total-cost'");
    CostTerm cost;
    if (in_.take("(")) {
      const Word name = in_.name("a function");
      if (name == "total-cost" || !(name == "+" || name == "-" || name == "*" || name == "/")) {
        cost.function = terms_.function(name);
        cost.is_function = true;
        if (cost.function.symbol == task_.total_cost)
          in_.fail(name, "an action's cost cannot depend on the total cost", "name another function, or a number");
      } else {
        in_.fail(name, "an action's cost is a number or one function, not a sum", "write two 'increase'");
      }
    } else {
      cost.number = terms_.number(in_.next());
    }
    action.costs.push_back(cost);
    in_.expect(")", "')' behind the cost");
  }

  LiftedTask& task_;
  PddlReader in_;
  PddlTerms terms_;
  std::pmr::vector<std::pmr::vector<Index>> parents_{};
  std::size_t parent_count_ = 0;
};

}  // namespace

LiftedTask::LiftedTask(std::pmr::memory_resource* resource)
    : memory(resource),
      domain_text(resource),
      problem_text(resource),
      types(resource),
      type_sets(resource),
      objects(resource),
      object_types(resource),
      predicates(resource),
      functions(resource),
      actions(resource),
      terms(resource),
      init(resource),
      values(resource),
      goal(resource),
      type_index(resource),
      object_index(resource),
      predicate_index(resource),
      function_index(resource),
      action_index(resource) {
  types.push_back("object");
  type_index.emplace("object", 0);
}

void read_domain(LiftedTask& task, std::string_view text, Pace& pace) {
  task.domain_text = lower_case(text, task.memory);
  DomainReader(task, pace).read();
}

}  // namespace fiona::planning
