#pragma once

#include <string>
#include <string_view>

#include "fiona/unicode.hpp"

namespace fiona::console {

using unicode::append_utf8;
using unicode::Character;
using unicode::decode;

/// The text with everything that could act on a terminal or mislead a reader made visible: control bytes (C0, C1, DEL),
/// escape sequences, line and paragraph separators, bidirectional overrides, zero-width and other invisible
/// characters become `\u{…}` (newline and tab `\n`, `\t`), bytes that are no UTF-8 become `\x{…}`. The result is valid
/// UTF-8 on one line, and inert(inert(x)) == inert(x). Every text that comes from a host, a component, a file or a
/// marketplace passes through here before it is printed.
std::string inert(std::string_view text);

/// The same for text that is meant to have lines: newlines stay, each line is inert.
std::string inert_lines(std::string_view text);

/// The columns that the text takes on a terminal: wide East Asian characters and emoji count 2, combining marks 0.
std::size_t display_width(std::string_view text);

}  // namespace fiona::console
