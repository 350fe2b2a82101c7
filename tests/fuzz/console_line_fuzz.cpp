// Any text is either refused with a fiona::Error, or read into lines whose values are read back the same from their
// own typing.
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "grammar.hpp"
#include "verb_table.hpp"

using namespace fiona::console;

namespace {

void check_value(const Word& word, const WordLine& line) {
  const auto value = value_of(word, line);
  // Protobuf text may hold what a line cannot, like a joint of two physical lines; all else must come back.
  if (word.kind == WordKind::Message || word.kind == WordKind::List) return;
  const WordLine again = split_line("x=" + typed(value));
  if (value_of(again.items.at(0).word, again).SerializeAsString() != value.SerializeAsString()) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  (void)continues(text);
  try {
    for (const WordLine& line : split_script(text, "fuzz")) {
      for (const auto& item : line.items) check_value(item.word, line);
      (void)read_line(line);
    }
  } catch (const fiona::Error&) {
  }
  return 0;
}
