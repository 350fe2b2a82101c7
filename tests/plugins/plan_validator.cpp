#include "plan_validator.hpp"

#include <cctype>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>

namespace fiona::testing {
namespace {

/// A word, or a list in parentheses.
struct Node {
  std::string word{};
  std::vector<Node> items{};
  bool is_list = false;
  const Node& at(std::size_t i) const { return items.at(i); }
  bool begins_with(const std::string& head) const { return is_list && !items.empty() && items[0].word == head; }
};

std::vector<std::string> words_of(const std::string& text) {
  std::vector<std::string> words;
  bool comment = false;
  std::string word;
  const auto end_word = [&] {
    if (!word.empty()) words.push_back(word);
    word.clear();
  };
  for (const char c : text) {
    if (c == '\n') comment = false;
    if (c == ';') comment = true;
    if (comment || std::isspace(static_cast<unsigned char>(c))) {
      end_word();
    } else if (c == '(' || c == ')') {
      end_word();
      words.emplace_back(1, c);
    } else {
      word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    }
  }
  end_word();
  return words;
}

Node tree_of(const std::string& text) {
  std::vector<Node> open(1);
  for (const std::string& word : words_of(text)) {
    if (word == "(") {
      open.push_back({{}, {}, true});
    } else if (word == ")") {
      Node done = std::move(open.back());
      open.pop_back();
      open.at(open.size() - 1).items.push_back(std::move(done));
    } else {
      open.back().items.push_back({word, {}, false});
    }
  }
  return open.at(0).items.at(0);
}

using Fact = std::vector<std::string>;
using Types = std::vector<std::string>;

/// (name, types) of a typed list, from item `begin`.
std::vector<std::pair<std::string, Types>> typed(const Node& list, std::size_t begin) {
  std::vector<std::pair<std::string, Types>> all;
  std::size_t untyped = 0;
  for (std::size_t i = begin; i < list.items.size(); ++i) {
    if (list.at(i).word != "-") {
      all.push_back({list.at(i).word, {"object"}});
      continue;
    }
    const Node& type = list.at(++i);
    Types types;
    if (type.is_list) {
      for (std::size_t k = 1; k < type.items.size(); ++k) types.push_back(type.at(k).word);
    } else {
      types.push_back(type.word);
    }
    for (; untyped < all.size(); ++untyped) all[untyped].second = types;
  }
  return all;
}

class World {
 public:
  World(const Node& domain, const Node& problem) {
    for (const Node* file : {&domain, &problem}) {
      for (std::size_t i = 2; i < file->items.size(); ++i) read_section(file->at(i));
    }
  }

  void execute(const Node& step) {
    const auto found = actions_.find(step.at(0).word);
    if (found == actions_.end()) throw std::runtime_error("the domain has no such action");
    const Node& action = found->second;
    std::map<std::string, std::string> binding;
    const Node *condition = nullptr, *effect = nullptr;
    for (std::size_t i = 2; i + 1 < action.items.size(); i += 2) {
      const std::string& key = action.at(i).word;
      if (key == ":parameters") bind(typed(action.at(i + 1), 0), step, binding);
      if (key == ":precondition") condition = &action.at(i + 1);
      if (key == ":effect") effect = &action.at(i + 1);
    }
    if (condition && !holds(*condition, binding)) throw std::runtime_error("its precondition does not hold");
    std::set<Fact> added, deleted;
    double paid = 0;
    if (effect) collect(*effect, binding, added, deleted, paid);
    for (const Fact& fact : deleted) state_.erase(fact);
    state_.insert(added.begin(), added.end());
    cost_ += has_metric_ ? paid : 1;
  }

  bool is_at_goal() const { return holds(goal_, {}); }
  double cost() const { return cost_; }

 private:
  using Binding = std::map<std::string, std::string>;

  void read_section(const Node& section) {
    const std::string& head = section.at(0).word;
    if (head == ":types")
      for (const auto& [name, types] : typed(section, 1)) parents_[name].insert(types.begin(), types.end());
    if (head == ":constants" || head == ":objects")
      for (const auto& [name, types] : typed(section, 1)) type_of_[name] = types.at(0);
    if (head == ":action") actions_[section.at(1).word] = section;
    if (head == ":goal") goal_ = section.at(1);
    if (head == ":metric") has_metric_ = true;
    if (head != ":init") return;
    for (std::size_t i = 1; i < section.items.size(); ++i) {
      const Node& fact = section.at(i);
      if (fact.begins_with("=")) {
        values_[ground(fact.at(1), {})] = std::stod(fact.at(2).word);
      } else if (!fact.begins_with("not")) {
        state_.insert(ground(fact, {}));
      }
    }
  }

  bool is_kind_of(const std::string& type, const std::string& wanted) const {
    if (type == wanted || wanted == "object") return true;
    const auto found = parents_.find(type);
    if (found == parents_.end()) return false;
    for (const std::string& parent : found->second)
      if (parent != type && is_kind_of(parent, wanted)) return true;
    return false;
  }

  void bind(const std::vector<std::pair<std::string, Types>>& parameters, const Node& step, Binding& binding) const {
    if (parameters.size() + 1 != step.items.size())
      throw std::runtime_error("it has not as many arguments as parameters");
    for (std::size_t i = 0; i < parameters.size(); ++i) {
      const std::string& object = step.at(i + 1).word;
      const auto type = type_of_.find(object);
      if (type == type_of_.end()) throw std::runtime_error("there is no object " + object);
      bool fits = false;
      for (const std::string& wanted : parameters[i].second) fits = fits || is_kind_of(type->second, wanted);
      if (!fits) throw std::runtime_error(object + " is of a wrong type");
      binding[parameters[i].first] = object;
    }
  }

  static std::string value_of(const std::string& word, const Binding& binding) {
    return word[0] == '?' ? binding.at(word) : word;
  }
  static Fact ground(const Node& atom, const Binding& binding) {
    Fact fact;
    for (const Node& item : atom.items) fact.push_back(value_of(item.word, binding));
    return fact;
  }

  bool holds(const Node& condition, const Binding& binding) const {
    if (condition.items.empty()) return true;
    if (condition.begins_with("and")) {
      for (std::size_t i = 1; i < condition.items.size(); ++i)
        if (!holds(condition.at(i), binding)) return false;
      return true;
    }
    if (condition.begins_with("not")) return !holds(condition.at(1), binding);
    if (condition.begins_with("="))
      return value_of(condition.at(1).word, binding) == value_of(condition.at(2).word, binding);
    return state_.count(ground(condition, binding)) > 0;
  }

  void collect(const Node& effect, const Binding& binding, std::set<Fact>& added, std::set<Fact>& deleted,
               double& paid) const {
    if (effect.items.empty()) return;
    if (effect.begins_with("and")) {
      for (std::size_t i = 1; i < effect.items.size(); ++i) collect(effect.at(i), binding, added, deleted, paid);
    } else if (effect.begins_with("not")) {
      deleted.insert(ground(effect.at(1), binding));
    } else if (effect.begins_with("increase")) {
      const Node& by = effect.at(2);
      paid += by.is_list ? values_.at(ground(by, binding)) : std::stod(by.word);
    } else {
      added.insert(ground(effect, binding));
    }
  }

  std::map<std::string, std::set<std::string>> parents_;
  std::map<std::string, std::string> type_of_;
  std::map<std::string, Node> actions_;
  std::map<Fact, double> values_;
  std::set<Fact> state_;
  Node goal_;
  bool has_metric_ = false;
  double cost_ = 0;
};

}  // namespace

Validation validate(const std::string& domain, const std::string& problem, const PlanText& plan) {
  std::string where = "the texts";
  try {
    World world(tree_of(domain), tree_of(problem));
    for (std::size_t i = 0; i < plan.size(); ++i) {
      where = "step " + std::to_string(i + 1) + ", " + plan[i];
      world.execute(tree_of(plan[i]));
    }
    if (!world.is_at_goal()) return {"the goal is not reached", world.cost()};
    return {{}, world.cost()};
  } catch (const std::exception& error) {
    return {where + ": " + error.what(), 0};
  }
}

}  // namespace fiona::testing
