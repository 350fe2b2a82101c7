#include "fiona/readable_text.hpp"

#include <algorithm>

namespace fiona {
namespace {

constexpr std::string_view kReplacement = "\xef\xbf\xbd";

/// The length of the character that the text begins with; 0: it begins with none.
std::size_t character_of(std::string_view text) {
  const auto byte = [text](std::size_t at) { return static_cast<unsigned char>(text[at]); };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  const std::size_t length = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
  if (first < 0xc2 || first > 0xf4 || text.size() < length) return 0;
  // Neither longer than it need be, nor half of a pair, nor above U+10FFFF.
  const unsigned char lowest = first == 0xe0 ? 0xa0 : first == 0xf0 ? 0x90 : 0x80;
  const unsigned char highest = first == 0xed ? 0x9f : first == 0xf4 ? 0x8f : 0xbf;
  if (byte(1) < lowest || byte(1) > highest) return 0;
  for (std::size_t at = 2; at < length; ++at) {
    if ((byte(at) & 0xc0) != 0x80) return 0;
  }
  return length;
}

}  // namespace

std::string readable_text(std::string_view text, std::size_t most) {
  std::string readable;
  while (!text.empty()) {
    const std::size_t length = character_of(text);
    const std::string_view next = length > 0 ? text.substr(0, length) : kReplacement;
    if (readable.size() + next.size() > most) break;
    readable += next;
    text.remove_prefix(std::max<std::size_t>(length, 1));
  }
  return readable;
}

}  // namespace fiona
