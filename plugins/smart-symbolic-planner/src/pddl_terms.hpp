#pragma once

#include <initializer_list>
#include <string>
#include <string_view>

#include "lifted_task.hpp"
#include "pddl_reader.hpp"

namespace fiona::planning {

/// What domain and problem have in common: sections, typed lists, atoms, conditions. Reads into a task.
class PddlTerms {
 public:
  PddlTerms(LiftedTask& task, PddlReader& reader) : task_(task), in_(reader) {}

  struct Section {
    std::string_view keyword;
    std::size_t begin;   ///< of its '('
    std::size_t inside;  ///< behind its keyword
  };
  /// Reads "(define (KIND NAME) SECTION...)" to the end of the text, and says where the sections are; only those of
  /// `repeated` may come twice.
  List<Section> sections(std::string_view kind, std::string_view& name, std::initializer_list<std::string_view> known,
                         std::string_view repeated);

  /// Refuses what this planner does not know, by name.
  void requirements();

  /// A typed list: `each(word)` for every entry, then `typed(type set)` once for all since the last type.
  template <class Each, class Typed>
  void typed_list(Each each, Typed typed, bool variables);
  Index type_set();
  void objects();

  /// The variables that may stand in atoms.
  void use_parameters_of(const Action* action) { action_ = action; }
  Atom atom(const PddlReader::Word& name, const LiftedTask::Names& names, const List<Symbol>& symbols,
            std::string_view kind);
  Atom predicate(const PddlReader::Word& name) {
    return atom(name, task_.predicate_index, task_.predicates, "predicate");
  }
  Atom function(const PddlReader::Word& name) { return atom(name, task_.function_index, task_.functions, "function"); }
  Term term();
  /// "()" , an atom, an equality, or a conjunction of them, each perhaps in a `not`.
  void conditions(Conditions& into, std::size_t depth = 0);
  Cost number(const PddlReader::Word& word) const;

  [[noreturn]] void fail_unknown(const PddlReader::Word& word, std::string what, const LiftedTask::Names& known) const;

 private:
  void condition(Conditions& into, bool holds, std::size_t depth);
  void check_argument(const Term& term, const PddlReader::Word& word, const Symbol& symbol, std::size_t place) const;

  LiftedTask& task_;
  PddlReader& in_;
  const Action* action_ = nullptr;
};

template <class Each, class Typed>
void PddlTerms::typed_list(Each each, Typed typed, bool variables) {
  bool open = false;  // names wait for their type
  while (true) {
    const PddlReader::Word word = in_.next();
    if (word == ")") break;
    if (word == "-" && open) {
      typed(type_set());
      open = false;
    } else if (variables ? word.is_variable() : word.is_name()) {
      each(word);
      open = true;
    } else {
      in_.fail_expected(word, variables ? "a variable (?name), '- TYPE' or ')'" : "a name, '- TYPE' or ')'");
    }
  }
  if (open) typed(0);
}

}  // namespace fiona::planning
