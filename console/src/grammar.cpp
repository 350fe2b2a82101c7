#include "grammar.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>

#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr std::size_t kMostBytes = 16U << 20U;  // of a script: as much as one control message may be
constexpr int kDeepestNesting = 32;
constexpr std::array<std::string_view, 8> kKeywords{"as", "in", "to", "else", "for", "with", "at", "every"};

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool is_name_character(char c) {
  return is_letter(c) || (c >= '0' && c <= '9') || c == '.' || c == '-' || c == '[' || c == ']';
}

std::shared_ptr<const std::vector<std::string>> physical_lines(std::string_view text) {
  std::vector<std::string> lines;
  while (true) {
    const std::size_t end = text.find('\n');
    std::string_view line = text.substr(0, end);
    if (line.ends_with('\r')) line.remove_suffix(1);
    lines.emplace_back(line);
    if (end == std::string_view::npos) break;
    text.remove_prefix(end + 1);
  }
  return std::make_shared<const std::vector<std::string>>(std::move(lines));
}

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

  void advance() {
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

  /// A `\` at the end of a physical line, which joins the next one to it.
  bool at_continuation() const { return peek() == '\\' && (peek(1) == '\n' || (peek(1) == '\r' && peek(2) == '\n')); }

  bool skip_continuation() {
    if (!at_continuation()) return false;
    while (peek() != '\n') advance();
    advance();
    return true;
  }

  void skip_blanks() {
    while (!at_end() && (skip_continuation() || is_blank(peek()))) {
      if (is_blank(peek())) advance();
    }
    if (peek() == '#') {
      while (!at_end() && peek() != '\n') advance();
    }
  }

  bool at_word_end() const { return at_end() || is_blank(peek()) || peek() == '\n' || at_continuation(); }

  /// The name before a `=`; nothing where no `name=value` starts (`==` is a comparison).
  std::optional<Word> take_name() {
    std::size_t length = 0;
    if (!is_letter(peek())) return std::nullopt;
    while (is_name_character(peek(length))) ++length;
    if (peek(length) != '=' || peek(length + 1) == '=') return std::nullopt;
    Word name{.text = std::string(text_.substr(0, length)), .kind = WordKind::Plain, .place = place_};
    for (std::size_t i = 0; i <= length; ++i) advance();
    return name;
  }

  Word take_word() {
    const Place start = place_;
    Word word = peek() == '"' ? take_quoted() : peek() == '[' || peek() == '{' ? take_bracketed() : take_plain("");
    word.place = start;
    if (!at_word_end())
      fail(place_,
           {.what = "a blank is missing here", .expected = "a blank or the end of the line after the closing mark"});
    return word;
  }

  /// One element of a list.
  Word take_element() {
    const Place start = place_;
    Word word = peek() == '"' ? take_quoted() : peek() == '[' || peek() == '{' ? take_bracketed() : take_plain(",]");
    word.place = start;
    if (word.text.empty() && word.kind == WordKind::Plain)
      fail(start, {.what = "a value is missing in the list", .expected = "[a, b]"});
    return word;
  }

 private:
  Word take_plain(std::string_view ends) {
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

  Word take_quoted() {
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

  void take_escape(std::string& out) {
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

  void take_code_point(std::string& out, const Place& start) {
    const std::size_t end = text_.substr(0, 10).find('}');
    const std::string_view digits =
        end == std::string_view::npos || end < 2 || peek(1) != '{' ? "" : text_.substr(2, end - 2);
    char32_t code = 0;
    bool sound = !digits.empty() && digits.size() <= 6;
    for (const char digit : digits) {
      const std::size_t value = std::string_view("0123456789abcdef")
                                    .find(digit >= 'A' && digit <= 'F' ? static_cast<char>(digit + 32) : digit);
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

  /// From `[` or `{` to its partner, as typed; quotes hide brackets.
  Word take_bracketed() {
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

  void skip_quoted(char mark) {
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

  std::string_view text_;
  const WordLine& frame_;
  Place place_;
};

std::optional<WordLine> next_line(Scanner& scanner, const WordLine& frame) {
  WordLine line = frame;
  for (scanner.skip_blanks(); !scanner.at_end() && scanner.peek() != '\n'; scanner.skip_blanks()) {
    if (line.items.empty()) line.place = scanner.place();
    if (scanner.peek() == '\\') {
      const bool last = scanner.rest().size() == 1;
      scanner.fail(scanner.place(),
                   {.what = last ? "the line goes on after \\, and nothing follows" : "a \\ stands outside of quotes",
                    .next = last ? "write the rest, or take the \\ away" : "quote the word and write \\\\"});
    }
    WordLine::Item item;
    item.name = scanner.take_name();
    if (item.name && scanner.at_word_end()) {
      scanner.fail(scanner.place(), {.what = fmt::format("no value follows {}=", item.name->text),
                                     .expected = "a value without a blank before it; \"\" is the empty text"});
    }
    item.word = scanner.take_word();
    line.items.push_back(std::move(item));
  }
  if (!scanner.at_end()) scanner.advance();
  if (line.empty()) return std::nullopt;
  return line;
}

WordLine frame_of(std::string_view text, const std::string& origin) {
  WordLine frame;
  frame.origin = origin;
  frame.source = physical_lines(text);
  return frame;
}

std::string made_caret(const WordLine& line, const Place& place) {
  if (!line.source || place.line == 0 || place.line > line.source->size()) return {};
  const std::string& source = (*line.source)[place.line - 1];
  std::size_t before = source.starts_with("\xef\xbb\xbf") ? 3 : 0;
  for (std::size_t column = 1; column < place.column && before < source.size(); ++column) {
    before += decode(std::string_view(source).substr(before)).bytes;
  }
  // A long line is shown around the word only.
  constexpr std::size_t kShownBefore = 60;
  constexpr std::size_t kShown = 100;
  const std::string lead = inert(std::string_view(source).substr(0, before));
  const bool cut = display_width(lead) > kShownBefore;
  std::string shown = cut ? "…" : lead;
  const std::size_t width = display_width(shown);
  std::string_view rest = std::string_view(source).substr(before);
  std::size_t bytes = 0;
  for (std::size_t count = 0; count < kShown && bytes < rest.size(); ++count) bytes += decode(rest.substr(bytes)).bytes;
  shown += inert(rest.substr(0, bytes));
  if (bytes < rest.size()) shown += "…";
  return fmt::format("{}\n{}^", shown, std::string(width, ' '));
}

ErrorText placed(ErrorText text, const WordLine& line, const Place& place) {
  const std::string where = place_text(line, place);
  // Of a typed line the caret says where; a file needs its name and line as well.
  if (text.where.empty())
    text.where = where;
  else if (!line.origin.empty())
    text.where = where + ", " + text.where;
  return text;
}

}  // namespace

LineError::LineError(const WordLine& line, const Place& place, ErrorText text, ErrorCode code)
    : Error(code, placed(std::move(text), line, place)), caret_(made_caret(line, place)) {}

std::string place_text(const WordLine& line, const Place& place) {
  if (!line.origin.empty()) return fmt::format("{}:{}:{}", line.origin, place.line, place.column);
  if (line.source && line.source->size() > 1) return fmt::format("line {}, column {}", place.line, place.column);
  return fmt::format("column {}", place.column);
}

bool is_keyword(std::string_view word) {
  return std::find(kKeywords.begin(), kKeywords.end(), word) != kKeywords.end();
}

std::vector<WordLine> split_script(std::string_view text, const std::string& origin) {
  if (text.size() > kMostBytes) {
    throw Error(ErrorCode::Usage, ErrorText{.what = "the script is too long",
                                            .where = origin,
                                            .expected = "at most 16 MiB",
                                            .found = fmt::format("{} bytes", text.size())});
  }
  const WordLine frame = frame_of(text, origin);
  Scanner scanner(text, frame);
  std::vector<WordLine> lines;
  while (!scanner.at_end()) {
    if (auto line = next_line(scanner, frame)) lines.push_back(std::move(*line));
  }
  return lines;
}

WordLine split_line(std::string_view text, const std::string& origin) {
  std::vector<WordLine> lines = split_script(text, origin);
  if (lines.size() > 1)
    throw LineError(lines[1], lines[1].place, {.what = "a second command begins here", .expected = "one command"});
  return lines.empty() ? frame_of(text, origin) : std::move(lines.front());
}

WordLine ready_words(const std::vector<std::string>& words) {
  std::string shown;
  std::vector<Place> places;
  for (const std::string& word : words) {
    if (!shown.empty()) shown += ' ';
    std::size_t column = 1;
    for (std::string_view rest = shown; !rest.empty(); rest.remove_prefix(decode(rest).bytes)) ++column;
    places.push_back({1, column});
    shown += inert(word);
  }
  WordLine line = frame_of(shown, "");
  for (std::size_t i = 0; i < words.size(); ++i) {
    for (std::string_view rest = words[i]; !rest.empty(); rest.remove_prefix(decode(rest).bytes)) {
      if (!decode(rest).valid) throw LineError(line, places[i], {.what = "this word is not UTF-8"});
    }
    WordLine::Item item;
    std::string_view value = words[i];
    Scanner scanner(value, line, places[i]);
    item.name = scanner.take_name();
    item.word = {.text = std::string(item.name ? scanner.rest() : value),
                 .kind = WordKind::Plain,
                 .place = item.name ? scanner.place() : places[i]};
    const char first = scanner.peek();
    const bool bracketed = first == '[' || first == '{';
    if (bracketed || (item.name && first == '"')) {
      item.word = scanner.take_word();
      if (!scanner.at_end())
        scanner.fail(scanner.place(), {.what = "more follows after the value", .next = "quote the whole value"});
    } else if (item.word.text.empty() || item.word.text.find_first_of(" \t\n") != std::string::npos) {
      item.word.kind = WordKind::Quoted;
    }
    line.items.push_back(std::move(item));
  }
  return line;
}

bool continues(std::string_view text) {
  // Only a \ that the scanner would take as the end of the line counts, not one in a comment.
  if (!text.ends_with('\\')) return false;
  const std::string joined = std::string(text) + "\n#";
  const WordLine frame = frame_of(joined, "");
  try {
    Scanner scanner(joined, frame);
    for (scanner.skip_blanks(); !scanner.at_end() && scanner.peek() != '\n'; scanner.skip_blanks()) {
      scanner.take_name();
      scanner.take_word();
    }
    return scanner.at_end();
  } catch (const Error&) {
    return true;  // an open quote or bracket goes on in the next line; other mistakes are told when it is whole
  }
}

namespace detail {

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

}  // namespace detail

}  // namespace fiona::console
