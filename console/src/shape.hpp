#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "grammar.hpp"

namespace fiona::console {

/// One place of a form that a word can take.
struct Slot {
  std::vector<std::string> choices;  ///< UPPER-CASE: any word of that meaning; lower case: that word
  bool required = true;
  bool repeated = false;

  /// The meaning where any word may stand ("INSTANCE.PORT"); empty where only given words may.
  std::string placeholder() const;
  std::vector<std::string> literals() const;
  bool accepts(const Word& word) const;
};

struct Clause {
  std::string keyword;
  Slot slot;
};

struct OptionSlot {
  std::string name;  ///< "--for", "-y"
  Slot slot;         ///< its value; without choices: it takes none
  bool takes_value() const { return !slot.choices.empty(); }
};

/// `hold=T`
struct ArgumentSlot {
  std::string name;
  Slot slot;
};

/// What a verb takes, read from the text that its help shows:
/// `load PLUGIN [as INSTANCE] [PARAM=VALUE …]`, `ls [instances|plugins]`, `run FILE … [--for T]`.
/// Parser, completion and help have no other source.
class Shape {
 public:
  explicit Shape(std::string_view form);

  const std::string& text() const { return text_; }
  const std::vector<Slot>& positional() const { return positional_; }
  const std::vector<Clause>& clauses() const { return clauses_; }
  const std::vector<OptionSlot>& options() const { return options_; }
  bool takes_arguments() const { return takes_arguments_; }
  /// Those that it takes (`[hold=T]`); empty: whatever the host knows, if any.
  const std::vector<ArgumentSlot>& arguments() const { return arguments_; }
  bool needs_arguments() const { return needs_arguments_; }

  const Clause* find_clause(std::string_view keyword) const;
  const OptionSlot* find_option(std::string_view name) const;
  const ArgumentSlot* find_argument(std::string_view name) const;

 private:
  std::string text_;
  std::vector<Slot> positional_;
  std::vector<Clause> clauses_;
  std::vector<OptionSlot> options_;
  std::vector<ArgumentSlot> arguments_;
  bool takes_arguments_ = false;
  bool needs_arguments_ = false;
};

/// `name=value` as typed.
struct TypedArgument {
  Word name;
  Word value;
};

/// A line read by a form of its verb.
struct Line {
  WordLine words{};
  Word verb{};
  std::vector<Word> positional{};
  std::map<std::string, std::vector<Word>, std::less<>> clauses{};
  std::vector<TypedArgument> arguments{};
  std::multimap<std::string, TypedArgument, std::less<>> options{};  ///< `--set a.b=c` has a name, others do not

  bool has(std::string_view option) const { return options.contains(option); }
  /// The word after the keyword, the first of several; null: it is not there.
  const Word* clause(std::string_view keyword) const;
  /// All of them.
  std::vector<Word> clause_words(std::string_view keyword) const;
  /// The value of `name=…`; null: it is not there.
  const Word* argument(std::string_view name) const;
  const Word* option(std::string_view name) const;

  /// The named arguments as the host takes them.
  std::vector<control::Argument> control_arguments() const;
  LineError error(const Word& word, ErrorText text, ErrorCode code = ErrorCode::Usage) const {
    return {words, word.place, std::move(text), code};
  }
};

/// Reads the line by the shape. Throws LineError (Usage) at the first word that does not belong.
Line bind(const WordLine& words, const Shape& shape, const std::vector<OptionSlot>& global_options);

}  // namespace fiona::console
