#pragma once

#include <cstddef>
#include <memory_resource>
#include <string>
#include <string_view>

#include "budget.hpp"
#include "pddl_error.hpp"

namespace fiona::planning {

/// The words of a PDDL text, one after the other; comments and blanks between them do not show. Views into the text,
/// which must be in lower case already: PDDL knows no difference.
class PddlReader {
 public:
  struct Word {
    std::string_view text;  ///< "(", ")", a name, "?variable", ":keyword", "-", a number, "="; empty: the end
    std::size_t offset = 0;

    bool operator==(std::string_view other) const { return text == other; }
    bool is_variable() const { return text.starts_with('?'); }
    bool is_keyword() const { return text.starts_with(':'); }
    /// What may name something: neither parenthesis, variable, keyword nor the end.
    bool is_name() const;
  };

  /// Keeps to the time bound of `pace`, without a pause.
  PddlReader(Text which, std::string_view text, Pace& pace) : which_(which), text_(text), pace_(pace) {}

  /// The next word. Throws PddlError at a byte that no word may have, OutOfTime.
  Word next();
  Word peek();
  /// Reads the next word, which must be this one.
  Word expect(std::string_view word, std::string_view what);
  /// Reads it, if it is the next one.
  bool take(std::string_view word);
  Word name(std::string_view what);
  Word variable(std::string_view what);

  /// Behind the ')' that ends what began with the '(' at `opened`, which has been read. No section may begin inside: a
  /// "(:" there says that a parenthesis is missing before it.
  void skip_rest(std::size_t opened);

  std::size_t offset() const { return at_; }
  void go_to(std::size_t offset) { at_ = offset; }

  Place place(std::size_t offset) const { return place_of(which_, text_, offset); }
  [[noreturn]] void fail(std::size_t offset, ErrorText text) const;
  /// `next`: what whoever wrote the text does about it.
  [[noreturn]] void fail(const Word& word, std::string what, std::string next) const;
  /// `word` is not what belongs there.
  [[noreturn]] void fail_expected(const Word& word, std::string_view expected) const;

 private:
  void skip_blanks();

  const Text which_;
  const std::string_view text_;
  Pace& pace_;
  std::size_t at_ = 0;
};

/// The text as the reader wants it. Only ASCII letters have a lower case here: other bytes are refused later.
std::pmr::string lower_case(std::string_view text, std::pmr::memory_resource* memory);

/// A word as an error names it, cut where it is long.
std::string quoted(std::string_view word);

/// What to do where there is no cost, and where more is required than this planner has.
inline constexpr const char* kDeclareCost = "declare it in the domain: (:functions (total-cost) - number)";
inline constexpr const char* kTakes =
    "this planner takes :strips, :typing, :negative-preconditions, :equality, :action-costs";

}  // namespace fiona::planning
