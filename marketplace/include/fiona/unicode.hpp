#pragma once

#include <cstddef>
#include <string>
#include <string_view>

/// What the Unicode standard says of characters (by utf8proc: version 15), and what FIONA makes of it.
namespace fiona::unicode {

/// One decoded character; `valid` is false for a byte that is no UTF-8 (RFC 3629), which then is taken alone.
struct Character {
  char32_t code = 0;
  std::size_t bytes = 1;
  bool valid = false;
};
/// The first of `text`; of an empty text, none of no bytes.
Character decode(std::string_view text);
void append_utf8(std::string& out, char32_t code);

/// What a terminal obeys or a reader cannot see: control, format, separator, private and unassigned characters,
/// variation selectors, and letters that show as blanks (categories Cc, Cf, Cs, Co, Cn, Zl, Zp, and default
/// ignorables).
bool is_hidden(char32_t code);
/// A mark that is drawn over or under the letter before it (categories Mn, Me).
bool is_mark(char32_t code);
/// The columns that it takes on a terminal: wide East Asian characters and emoji 2, marks 0.
std::size_t columns(char32_t code);

/// Whether `text` can be typed as a name and looks like no other one: a letter, then letters, digits, '-' and '_', in
/// normal form C (Unicode annex 15), of at most 64 bytes.
bool is_name(std::string_view text);

}  // namespace fiona::unicode
