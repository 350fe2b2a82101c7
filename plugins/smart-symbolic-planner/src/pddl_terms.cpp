#include "pddl_terms.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace fiona::planning {
namespace {

using Word = PddlReader::Word;

constexpr std::array<std::string_view, 5> kRequirements{":strips", ":typing", ":negative-preconditions", ":equality",
                                                        ":action-costs"};

/// What a condition may not have here, and the requirement that would allow it.
constexpr std::array<std::pair<std::string_view, std::string_view>, 8> kRefused{
    {{"or", ":disjunctive-preconditions"},
     {"imply", ":disjunctive-preconditions"},
     {"exists", ":existential-preconditions"},
     {"forall", ":universal-preconditions"},
     {"preference", ":preferences"},
     {"<", ":numeric-fluents"},
     {">", ":numeric-fluents"},
     {"when", ":conditional-effects"}}};

}  // namespace

List<PddlTerms::Section> PddlTerms::sections(std::string_view kind, std::string_view& name,
                                             std::initializer_list<std::string_view> known, std::string_view repeated) {
  List<Section> all(task_.memory);
  const std::string kind_text(kind);
  const Word begin = in_.expect("(", "'(define (" + kind_text + " NAME) ...)'");
  in_.expect("define", "'define'");
  in_.expect("(", "'(" + kind_text + " NAME)'");
  in_.expect(kind, "'" + kind_text + "'");
  name = in_.name("the name of the " + kind_text).text;
  in_.expect(")", "')'");
  for (Word open = in_.next(); open.text != ")"; open = in_.next()) {
    if (open.text.empty())
      in_.fail(begin.offset, {.what = "this '(' is never closed", .next = "add the ')' that is missing"});
    if (open.text != "(") in_.fail_expected(open, "a section, '(:...', or ')'");
    const Word keyword = in_.next();
    if (std::find(known.begin(), known.end(), keyword.text) == known.end()) {
      std::string expected;
      for (const std::string_view one : known) expected += (expected.empty() ? "one of " : ", ") + std::string(one);
      in_.fail(keyword.offset,
               {.what = keyword.is_keyword() ? "the section " + quoted(keyword.text) + " is not supported"
                                             : quoted(keyword.text) + " begins no section",
                .expected = std::move(expected)});
    }
    const bool again = std::any_of(all.begin(), all.end(), [&](const Section& s) { return s.keyword == keyword.text; });
    if (again && keyword.text != repeated)
      in_.fail(keyword, "a second section " + quoted(keyword.text), "make one of both");
    all.push_back({keyword.text, open.offset, in_.offset()});
    in_.skip_rest(open.offset);
  }
  if (const Word more = in_.next(); !more.text.empty()) in_.fail_expected(more, "the end of the text");
  return all;
}

void PddlTerms::requirements() {
  for (Word word = in_.next(); word.text != ")"; word = in_.next()) {
    if (!word.is_keyword()) in_.fail_expected(word, "a requirement, ':...', or ')'");
    if (std::find(kRequirements.begin(), kRequirements.end(), word.text) != kRequirements.end()) continue;
    in_.fail(word.offset, {.what = "the requirement " + quoted(word.text) + " is not supported", .next = kTakes});
  }
}

Index PddlTerms::type_set() {
  const auto one = [&](const Word& word) {
    const auto found = task_.type_index.find(word.text);
    if (found == task_.type_index.end()) fail_unknown(word, "the type", task_.type_index);
    return found->second;
  };
  if (!in_.take("(")) return one(in_.name("a type, or '(either TYPE ...)'"));
  in_.expect("either", "'either'");
  TypeSet set(task_.memory);
  set.bits.resize(task_.type_sets.front().bits.size());
  do {
    const Index type = one(in_.name("a type"));
    for (std::size_t i = 0; i < set.bits.size(); ++i) set.bits[i] |= task_.type_sets[type].bits[i];
  } while (!in_.take(")"));
  task_.type_sets.push_back(std::move(set));
  return static_cast<Index>(task_.type_sets.size() - 1);
}

void PddlTerms::objects() {
  std::size_t untyped = task_.objects.size();
  typed_list(
      [&](const Word& word) {
        const auto [place, is_new] =
            task_.object_index.try_emplace(word.text, static_cast<Index>(task_.objects.size()));
        if (!is_new)
          in_.fail(word, "the object " + quoted(word.text) + " is declared twice",
                   "take one out, or give it another name");
        task_.objects.push_back(word.text);
      },
      [&](Index set) {
        if (set >= task_.types.size())
          in_.fail(in_.offset() - 1, {.what = "an object is of one type, not of 'either'", .next = "name that one"});
        task_.object_types.resize(task_.objects.size(), set);
        untyped = task_.objects.size();
      },
      false);
}

Term PddlTerms::term() {
  const Word word = in_.next();
  if (word.is_variable()) {
    if (!action_) in_.fail(word, "a variable has no place here, " + quoted(word.text), "name an object");
    const auto found = std::find(action_->parameters.begin(), action_->parameters.end(), word.text);
    if (found == action_->parameters.end())
      in_.fail(
          word,
          "the variable " + quoted(word.text) + " is no parameter of the action '" + std::string(action_->name) + "'",
          "declare it in :parameters, or name one of those");
    return Term::parameter(static_cast<Index>(found - action_->parameters.begin()));
  }
  if (!word.is_name()) in_.fail_expected(word, action_ ? "a variable or an object" : "an object");
  const auto found = task_.object_index.find(word.text);
  if (found == task_.object_index.end())
    fail_unknown(word, action_ ? "the constant" : "the object", task_.object_index);
  return Term::object(found->second);
}

void PddlTerms::check_argument(const Term& term, const Word& word, const Symbol& symbol, std::size_t place) const {
  const TypeSet& wanted = task_.type_sets[symbol.parameter_types[place]];
  const Index type = term.is_object() ? task_.object_types[term.index()] : action_->parameter_types[term.index()];
  bool fits = false;
  if (term.is_object()) {
    fits = wanted.has(type);
  } else {
    const TypeSet& offered = task_.type_sets[type];
    for (std::size_t i = 0; i < wanted.bits.size(); ++i) fits |= (wanted.bits[i] & offered.bits[i]) != 0;
  }
  if (fits) return;
  const std::string kind = type < task_.types.size() ? "a " + quoted(task_.types[type]) : std::string("of other types");
  in_.fail(word,
           quoted(word.text) + " is " + kind + ", which argument " + std::to_string(place + 1) + " of " +
               quoted(symbol.name) + " cannot be",
           "name one that fits, or declare that argument of another type");
}

Atom PddlTerms::atom(const Word& name, const LiftedTask::Names& names, const List<Symbol>& symbols,
                     std::string_view kind) {
  const auto found = names.find(name.text);
  if (found == names.end()) fail_unknown(name, "the " + std::string(kind), names);
  const Symbol& symbol = symbols[found->second];
  Atom atom{found->second, static_cast<Index>(task_.terms.size()), 0, name.offset};
  const std::size_t wanted = symbol.parameter_types.size();
  const std::string takes =
      quoted(name.text) + " takes " + std::to_string(wanted) + (wanted == 1 ? " argument" : " arguments");
  while (!in_.take(")")) {
    const Word word = in_.peek();
    if (atom.term_count == wanted) in_.fail(word, takes + ", and here is one more", "take it out");
    const Term argument = term();
    check_argument(argument, word, symbol, atom.term_count);
    task_.terms.push_back(argument);
    ++atom.term_count;
  }
  if (atom.term_count != wanted)
    in_.fail(name, takes + ", and here are " + std::to_string(atom.term_count), "add what is missing");
  return atom;
}

void PddlTerms::conditions(Conditions& into, std::size_t depth) {
  in_.expect("(", "a condition, '(...)'");
  if (in_.take(")")) return;
  condition(into, true, depth);
}

/// Behind its '('.
void PddlTerms::condition(Conditions& into, bool holds, std::size_t depth) {
  const Word word = in_.next();
  if (depth > kDeepestNesting)
    in_.fail(word, "conditions are nested more than " + std::to_string(kDeepestNesting) + " deep",
             "write the inner 'and' as a part of the outer one");
  if (word == "and") {
    if (!holds)
      in_.fail(word.offset, {.what = "'not' of 'and' is a disjunction, which needs :disjunctive-preconditions",
                             .next = "this planner takes 'not' of one atom"});
    while (!in_.take(")")) {
      in_.expect("(", "a condition, '(...)', or ')'");
      condition(into, holds, depth + 1);
    }
    return;
  }
  if (word == "not") {
    in_.expect("(", "a condition, '(...)'");
    condition(into, !holds, depth + 1);
    in_.expect(")", "')' behind the condition of 'not'");
    return;
  }
  if (word == "=") {
    const Term left = term();
    into.equalities.push_back({left, term(), holds});
    in_.expect(")", "')' behind the two terms of '='");
  } else {
    const auto refused =
        std::find_if(kRefused.begin(), kRefused.end(), [&](const auto& entry) { return entry.first == word.text; });
    if (refused != kRefused.end() && !task_.predicate_index.contains(word.text))
      in_.fail(word, quoted(word.text) + " needs " + std::string(refused->second) + ", which is not supported", kTakes);
    if (!word.is_name()) in_.fail_expected(word, "a predicate, 'and', 'not' or '='");
    (holds ? into.positive : into.negative).push_back(predicate(word));
  }
  if (action_ && into.size() > kMostConditions)
    in_.fail(word, "an action has at most " + std::to_string(kMostConditions) + " conditions",
             "make two actions of it");
}

Cost PddlTerms::number(const Word& word) const {
  static constexpr std::string_view kExpected = "a number that is not negative, such as 12 or 2.5";
  const std::size_t point = std::min(word.text.find('.'), word.text.size());
  if (point == 0) in_.fail_expected(word, kExpected);
  Cost value = 0;
  Cost digit_value = kCostUnit;
  for (std::size_t i = 0; i < word.text.size(); ++i) {
    if (i == point) continue;
    if (word.text[i] < '0' || word.text[i] > '9') in_.fail_expected(word, kExpected);
    const Cost digit = word.text[i] - '0';
    if (i > point) digit_value /= 10;
    value = i < point ? value * 10 + digit * kCostUnit : value + digit * digit_value;
    if (value > kMostCost)
      in_.fail(word, "the number " + quoted(word.text) + " is above 1e9", "give all costs in a larger unit");
  }
  return value;
}

void PddlTerms::fail_unknown(const Word& word, std::string what, const LiftedTask::Names& known) const {
  // Who declares thousands of names, or names of a thousand letters, is not helped by those that look alike.
  static constexpr std::size_t kMostCompared = 2000;
  static constexpr std::size_t kLongest = 60;
  std::vector<std::string> names;
  for (const auto& [name, index] : known) {
    if (names.size() < kMostCompared && name.size() <= kLongest) names.emplace_back(name);
  }
  std::sort(names.begin(), names.end());
  ErrorText text{.what = what + " " + quoted(word.text) + " is not declared",
                 .near = nearest_names(word.text.substr(0, kLongest), names)};
  if (text.near.empty()) text.next = "declare it, or name one that is";
  in_.fail(word.offset, std::move(text));
}

}  // namespace fiona::planning
