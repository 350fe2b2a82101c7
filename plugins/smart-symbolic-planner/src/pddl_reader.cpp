#include "pddl_reader.hpp"

#include <utility>

namespace fiona::planning {
namespace {

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == '\f' || c == '\v'; }

bool ends_word(char c) { return is_blank(c) || c == '(' || c == ')' || c == ';'; }

/// Letters, digits and what PDDL's names, variables, keywords and numbers have besides.
bool belongs_to_word(char c) {
  return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') ||
         std::string_view("-_?:=.+*/<>@#!$%&^~,'[]{}|").find(c) != std::string_view::npos;
}

std::string byte_text(char c) {
  static constexpr std::string_view kDigits = "0123456789abcdef";
  const auto byte = static_cast<unsigned char>(c);
  if (byte > 0x20 && byte < 0x7f) return std::string("'") + c + "'";
  return std::string("the byte 0x") + kDigits[byte >> 4] + kDigits[byte & 0xf];
}

}  // namespace

std::string quoted(std::string_view word) {
  static constexpr std::size_t kLongest = 60;
  if (word.size() <= kLongest) return "'" + std::string(word) + "'";
  return "'" + std::string(word.substr(0, kLongest)) + "...'";
}

std::pmr::string lower_case(std::string_view text, std::pmr::memory_resource* memory) {
  std::pmr::string lowered(text, memory);
  for (char& c : lowered) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return lowered;
}

bool PddlReader::Word::is_name() const {
  return !text.empty() && text != "(" && text != ")" && text != "-" && !is_variable() && !is_keyword();
}

void PddlReader::skip_blanks() {
  while (at_ < text_.size()) {
    if (text_[at_] == ';') {
      while (at_ < text_.size() && text_[at_] != '\n') ++at_;
    } else if (is_blank(text_[at_])) {
      ++at_;
    } else {
      return;
    }
  }
}

PddlReader::Word PddlReader::next() {
  pace_.due();
  skip_blanks();
  const std::size_t begin = at_;
  if (at_ == text_.size()) return {{}, begin};
  if (text_[at_] == '(' || text_[at_] == ')') return {text_.substr(at_++, 1), begin};
  for (; at_ < text_.size() && !ends_word(text_[at_]); ++at_) {
    if (!belongs_to_word(text_[at_]))
      fail(at_, {.what = byte_text(text_[at_]) + " has no place in PDDL",
                 .next = "take it out: words are of ASCII letters, digits, '-' and '_'"});
  }
  return {text_.substr(begin, at_ - begin), begin};
}

PddlReader::Word PddlReader::peek() {
  const std::size_t here = at_;
  const Word word = next();
  at_ = here;
  return word;
}

PddlReader::Word PddlReader::expect(std::string_view word, std::string_view what) {
  const Word found = next();
  if (found.text != word) fail_expected(found, what);
  return found;
}

bool PddlReader::take(std::string_view word) {
  const std::size_t here = at_;
  if (next().text == word) return true;
  at_ = here;
  return false;
}

PddlReader::Word PddlReader::name(std::string_view what) {
  const Word found = next();
  if (!found.is_name()) fail_expected(found, what);
  return found;
}

PddlReader::Word PddlReader::variable(std::string_view what) {
  const Word found = next();
  if (!found.is_variable()) fail_expected(found, what);
  return found;
}

void PddlReader::skip_rest(std::size_t opened) {
  std::size_t depth = 1;
  for (Word word = next(); depth > 0; word = next()) {
    if (word.text.empty()) fail(opened, {.what = "this '(' is never closed", .next = "add the ')' that is missing"});
    if (word == ")" && --depth == 0) return;
    if (word != "(") continue;
    ++depth;
    if (const Word inner = peek(); inner.is_keyword())
      fail(word.offset, {.what = "the section " + quoted(inner.text) + " begins inside the one of " +
                                 place(opened).to_string() + ": a ')' is missing before it",
                         .next = "add it"});
  }
}

void PddlReader::fail(std::size_t offset, ErrorText text) const { throw PddlError(place(offset), std::move(text)); }

void PddlReader::fail(const Word& word, std::string what, std::string next) const {
  fail(word.offset, {.what = std::move(what), .next = std::move(next)});
}

void PddlReader::fail_expected(const Word& word, std::string_view expected) const {
  fail(word.offset, {.what = word.text.empty() ? "the text ends too early" : quoted(word.text) + " has no place here",
                     .expected = std::string(expected)});
}

}  // namespace fiona::planning
