// Any text, be it a file, a line that is typed or the words that a shell has split, is either refused with a
// fiona::Error, whose caret is safe to show, or read into lines whose values are read back the same from their own
// typing.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "grammar.hpp"
#include "inert.hpp"
#include "verb_table.hpp"

using namespace fiona::console;

namespace {

void require(bool holds) {
  if (!holds) std::abort();
}

/// Runs what may refuse a place in its text.
template <class Read>
void read_or_refuse(Read read) try {
  read();
} catch (const LineError& error) {
  const std::string caret = error.caret();
  require(inert_lines(caret) == caret && std::count(caret.begin(), caret.end(), '\n') <= 1);
  (void)error.is_in_secret({});
}

/// A word is read as what a verb may want there.
void check_readers(const Word& word, const WordLine& line) {
  read_or_refuse([&] { require(duration_ms(word, line) >= 0); });
  read_or_refuse([&] { require(count_of(word, line) >= 1); });
  read_or_refuse([&] { require(!watched_name(word, line).port().empty()); });
  read_or_refuse([&] {
    const auto name = port_name(word, line);
    require(name.instance() + "." + name.port() == word.text);
  });
}

void check_value(const Word& word, const WordLine& line) {
  const auto value = value_of(word, line);
  const std::string text = typed(value);
  // Protobuf text may hold what a line cannot, like a joint of two physical lines; all else must come back.
  if (word.kind == WordKind::Message || word.kind == WordKind::List) return;
  const WordLine again = split_line("x=" + text);
  require(value_of(again.items.at(0).word, again).SerializeAsString() == value.SerializeAsString());
}

void check_line(const WordLine& words) {
  if (words.empty()) return;
  for (const auto& item : words.items) check_value(item.word, words);
  const Line line = read_line(words);
  for (const auto& [keyword, given] : line.clauses)
    require(line.clause(keyword)->text == given.front().text && line.clause_words(keyword).size() == given.size());
  for (const auto& [name, option] : line.options) require(line.option(name) != nullptr);
  for (const auto& argument : line.arguments) require(line.argument(argument.name.text) != nullptr);
  require(line.control_arguments().size() == line.arguments.size());
}

/// As a shell hands them over.
std::vector<std::string> words_of(std::string_view text) {
  std::vector<std::string> words;
  for (std::size_t end = 0; end != std::string_view::npos; text.remove_prefix(std::min(text.size(), end + 1))) {
    end = text.find('\n');
    words.emplace_back(text.substr(0, end));
  }
  return words;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  (void)continues(text);
  try {
    read_or_refuse([&] {
      for (const WordLine& line : split_script(text, "fuzz")) check_line(line);
    });
    read_or_refuse([&] {
      const WordLine line = split_line(text);
      if (!line.empty()) check_readers(line.items.back().word, line);
      check_line(line);
    });
    read_or_refuse([&] { check_line(ready_words(words_of(text))); });
  } catch (const fiona::Error&) {
  }
  return 0;
}
