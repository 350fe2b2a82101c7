#include "inert.hpp"

#include <cstdint>

#include <fmt/format.h>

namespace fiona::console {
namespace {

// A text of only combining marks could climb over the lines above it, so no more than this many in a row.
constexpr int kMostMarks = 4;

std::string made_inert(std::string_view text, bool keep_newlines) {
  std::string out;
  out.reserve(text.size());
  int marks = 0;
  while (!text.empty()) {
    const Character next = decode(text);
    marks = next.valid && unicode::is_mark(next.code) ? marks + 1 : 0;
    if (!next.valid) {
      out += fmt::format("\\x{{{:02x}}}", static_cast<unsigned char>(text[0]));
    } else if (next.code == '\n') {
      out += keep_newlines ? "\n" : "\\n";
    } else if (next.code == '\t') {
      out += "\\t";
    } else if (unicode::is_hidden(next.code) || marks > kMostMarks) {
      out += fmt::format("\\u{{{:x}}}", static_cast<std::uint32_t>(next.code));
    } else {
      out += text.substr(0, next.bytes);
    }
    text.remove_prefix(next.bytes);
  }
  return out;
}

}  // namespace

std::string inert(std::string_view text) { return made_inert(text, false); }

std::string inert_lines(std::string_view text) { return made_inert(text, true); }

std::size_t display_width(std::string_view text) {
  std::size_t width = 0;
  while (!text.empty()) {
    const Character next = decode(text);
    width += next.valid ? unicode::columns(next.code) : 1;
    text.remove_prefix(next.bytes);
  }
  return width;
}

}  // namespace fiona::console
