#include "scanner.hpp"

#include <utility>

#include <fmt/format.h>

#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr int kDeepestNesting = 32;

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool is_name_character(char c) {
  return is_letter(c) || (c >= '0' && c <= '9') || c == '.' || c == '-' || c == '[' || c == ']';
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

}  // namespace

void Scanner::advance() {
  const Character next = decode(text_);
  if (!next.valid) fail(place_, {.what = "this byte is not UTF-8", .next = "save the text as UTF-8"});
  const bool control =
      (next.code < 0x20 && next.code != '\n' && next.code != '\t' && next.code != '\r') || next.code == 0x7f;
  if (control) {
    fail(place_, {.what = fmt::format("a control character (U+{:04X}) stands in the line", std::uint32_t{next.code}),
                  .next = fmt::format("write it as \\u{{{:x}}} inside quotes", std::uint32_t{next.code})});
  }
  text_.remove_prefix(next.bytes);
  if (next.code == '\n') {
    ++place_.line;
    place_.column = 1;
  } else {
    ++place_.column;
  }
}

bool Scanner::skip_continuation() {
  if (!at_continuation()) return false;
  while (peek() != '\n') advance();
  advance();
  return true;
}

void Scanner::skip_blanks() {
  while (!at_end() && (skip_continuation() || is_blank(peek()))) {
    if (is_blank(peek())) advance();
  }
  if (peek() == '#') {
    const std::string_view begin = text_.substr(1);
    while (!at_end() && peek() != '\n') advance();
    comment_ = trimmed(begin.substr(0, begin.size() - text_.size()));
  }
}

bool Scanner::at_word_end() const { return at_end() || is_blank(peek()) || peek() == '\n' || at_continuation(); }

std::optional<Word> Scanner::take_name() {
  std::size_t length = 0;
  if (!is_letter(peek())) return std::nullopt;
  while (is_name_character(peek(length))) ++length;
  if (peek(length) != '=' || peek(length + 1) == '=') return std::nullopt;
  Word name{.text = std::string(text_.substr(0, length)), .kind = WordKind::Plain, .place = place_};
  for (std::size_t i = 0; i <= length; ++i) advance();
  return name;
}

Word Scanner::take_word() {
  const Place start = place_;
  Word word = peek() == '"' ? take_quoted() : peek() == '[' || peek() == '{' ? take_bracketed() : take_plain("");
  word.place = start;
  if (!at_word_end())
    fail(place_,
         {.what = "a blank is missing here", .expected = "a blank or the end of the line after the closing mark"});
  return word;
}

Word Scanner::take_element() {
  const Place start = place_;
  Word word = peek() == '"' ? take_quoted() : peek() == '[' || peek() == '{' ? take_bracketed() : take_plain(",]");
  word.place = start;
  if (word.text.empty() && word.kind == WordKind::Plain)
    fail(start, {.what = "a value is missing in the list", .expected = "[a, b]"});
  return word;
}

Word Scanner::take_plain(std::string_view ends) {
  Word word{.kind = WordKind::Plain};
  while (!at_word_end() && ends.find(peek()) == std::string_view::npos) {
    if (peek() == '"') fail(place_, {.what = "a quote stands inside a word", .next = "quote the whole word: \"…\""});
    if (peek() == '\\') {
      fail(place_, {.what = "a \\ stands outside of quotes",
                    .next = "quote the word and write \\\\; at the end of a line, \\ goes on with the next"});
    }
    const std::string_view before = text_;
    advance();
    word.text += before.substr(0, before.size() - text_.size());
  }
  return word;
}

Word Scanner::take_quoted() {
  const Place start = place_;
  Word word{.kind = WordKind::Quoted};
  advance();
  while (peek() != '"') {
    if (at_end() || peek() == '\n')
      fail(start, {.what = "this quote is never closed", .next = "close it with \" on the same line"});
    if (skip_continuation()) continue;
    if (peek() == '\\') {
      take_escape(word.text);
      continue;
    }
    const std::string_view before = text_;
    advance();
    word.text += before.substr(0, before.size() - text_.size());
  }
  advance();
  return word;
}

void Scanner::take_escape(std::string& out) {
  const Place start = place_;
  advance();
  const char kind = peek();
  if (kind == 'u') return take_code_point(out, start);
  constexpr std::string_view kWritten = "\"\\nt";
  constexpr std::string_view kMeant = "\"\\\n\t";
  const std::size_t which = kind == '\0' ? std::string_view::npos : kWritten.find(kind);
  if (which == std::string_view::npos) {
    fail(start, {.what = "this escape is not known", .expected = "\\\" \\\\ \\n \\t or \\u{…}"});
  }
  out += kMeant[which];
  advance();
}

void Scanner::take_code_point(std::string& out, const Place& start) {
  const std::size_t end = text_.substr(0, 10).find('}');
  const std::string_view digits =
      end == std::string_view::npos || end < 2 || peek(1) != '{' ? "" : text_.substr(2, end - 2);
  char32_t code = 0;
  bool sound = !digits.empty() && digits.size() <= 6;
  for (const char digit : digits) {
    const std::size_t value =
        std::string_view("0123456789abcdef").find(digit >= 'A' && digit <= 'F' ? static_cast<char>(digit + 32) : digit);
    sound = sound && value != std::string_view::npos;
    code = code * 16 + static_cast<char32_t>(value & 0xfU);
  }
  if (!sound || code == 0 || code > 0x10ffff || (code >= 0xd800 && code <= 0xdfff)) {
    fail(start, {.what = "this is no character",
                 .expected = "\\u{…} with one to six hex digits, a Unicode character other than zero"});
  }
  append_utf8(out, code);
  for (std::size_t i = 0; i <= end; ++i) advance();
}

Word Scanner::take_bracketed() {
  const Place start = place_;
  const std::string_view before = text_;
  Word word{.kind = peek() == '[' ? WordKind::List : WordKind::Message};
  std::string open;
  do {
    if (at_end() || peek() == '\n')
      fail(start, {.what = fmt::format("this {} is never closed", before[0]),
                   .next = "close it on the same line, or continue the line with a trailing \\"});
    const char c = peek();
    if (c == '[' || c == '{') open += c == '[' ? ']' : '}';
    if (open.size() > kDeepestNesting)
      fail(place_,
           {.what = "brackets are nested too deep", .expected = fmt::format("at most {} levels", kDeepestNesting)});
    if ((c == ']' || c == '}') && c != open.back())
      fail(place_, {.what = fmt::format("this {} closes nothing", c), .expected = std::string(1, open.back())});
    if (c == ']' || c == '}') open.pop_back();
    if (c == '"' || (c == '\'' && word.kind == WordKind::Message)) {
      skip_quoted(c);
    } else if (!skip_continuation()) {
      advance();
    }
  } while (!open.empty());
  word.text = before.substr(0, before.size() - text_.size());
  return word;
}

void Scanner::skip_quoted(char mark) {
  const Place start = place_;
  advance();
  while (peek() != mark) {
    if (at_end() || peek() == '\n')
      fail(start,
           {.what = "this quote is never closed", .next = fmt::format("close it with {} on the same line", mark)});
    if (skip_continuation()) continue;
    if (peek() == '\\') advance();
    if (!at_end()) advance();
  }
  advance();
}

std::vector<Word> list_elements(const Word& list, const WordLine& line) {
  Scanner scanner(list.text, line, list.place);
  std::vector<Word> elements;
  scanner.advance();
  scanner.skip_blanks();
  while (scanner.peek() != ']') {
    elements.push_back(scanner.take_element());
    scanner.skip_blanks();
    if (scanner.peek() == ']') break;
    if (scanner.peek() != ',')
      scanner.fail(scanner.place(), {.what = "a comma is missing in the list", .expected = "[a, b]"});
    scanner.advance();
    scanner.skip_blanks();
    if (scanner.peek() == ']')
      scanner.fail(scanner.place(), {.what = "a value is missing in the list", .expected = "[a, b]"});
  }
  return elements;
}

}  // namespace fiona::console
