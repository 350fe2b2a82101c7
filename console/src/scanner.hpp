#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "grammar.hpp"

namespace fiona::console {

/// Reads words from a text and knows where it stands.
class Scanner {
 public:
  Scanner(std::string_view text, const WordLine& frame, Place start = {}) : text_(text), frame_(frame), place_(start) {
    if (text_.starts_with("\xef\xbb\xbf")) text_.remove_prefix(3);
  }

  bool at_end() const { return text_.empty(); }
  char peek(std::size_t ahead = 0) const { return ahead < text_.size() ? text_[ahead] : '\0'; }
  const Place& place() const { return place_; }
  std::string_view rest() const { return text_; }

  [[noreturn]] void fail(const Place& place, ErrorText text) const { throw LineError(frame_, place, std::move(text)); }

  /// Past one character. Throws at bytes that are no UTF-8 and at control characters.
  void advance();

  /// A `\` at the end of a physical line, which joins the next one to it.
  bool at_continuation() const { return peek() == '\\' && (peek(1) == '\n' || (peek(1) == '\r' && peek(2) == '\n')); }

  bool skip_continuation();

  /// Past blanks, continuations and a comment.
  void skip_blanks();
  /// The last comment that was passed, without its mark and the blanks around it; once.
  std::string take_comment() { return std::exchange(comment_, {}); }

  bool at_word_end() const;

  /// The name before a `=`; nothing where no `name=value` starts (`==` is a comparison).
  std::optional<Word> take_name();

  /// A word up to a blank or the end of the line.
  Word take_word();

  /// One element of a list.
  Word take_element();

 private:
  Word take_plain(std::string_view ends);
  Word take_quoted();
  void take_escape(std::string& out);
  void take_code_point(std::string& out, const Place& start);

  /// From `[` or `{` to its partner, as typed; quotes hide brackets.
  Word take_bracketed();
  void skip_quoted(char mark);

  std::string_view text_;
  const WordLine& frame_;
  Place place_;
  std::string comment_;
};

/// The elements of a word of kind List, each with its place in the line.
std::vector<Word> list_elements(const Word& list, const WordLine& line);

}  // namespace fiona::console
