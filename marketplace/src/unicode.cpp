#include "fiona/unicode.hpp"

#include <utf8proc.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <memory>

namespace fiona::unicode {
namespace {

constexpr std::size_t kLongestName = 64;  // bytes

utf8proc_category_t category(char32_t code) { return utf8proc_category(static_cast<utf8proc_int32_t>(code)); }

bool is_letter(char32_t code) {
  const auto is = category(code);
  return is >= UTF8PROC_CATEGORY_LU && is <= UTF8PROC_CATEGORY_LO && !is_hidden(code);
}

bool continues_name(char32_t code) {
  const auto is = category(code);
  const bool mark = is == UTF8PROC_CATEGORY_MN || is == UTF8PROC_CATEGORY_MC;
  return is_letter(code) || is == UTF8PROC_CATEGORY_ND || (mark && !is_hidden(code)) || code == '-' || code == '_';
}

bool is_composed(std::string_view text) {
  utf8proc_uint8_t* composed = nullptr;
  const auto size =
      utf8proc_map(reinterpret_cast<const utf8proc_uint8_t*>(text.data()), static_cast<utf8proc_ssize_t>(text.size()),
                   &composed, static_cast<utf8proc_option_t>(UTF8PROC_STABLE | UTF8PROC_COMPOSE));
  const std::unique_ptr<utf8proc_uint8_t, void (*)(void*)> owner(composed, std::free);
  return size >= 0 && text == std::string_view(reinterpret_cast<const char*>(composed), static_cast<std::size_t>(size));
}

}  // namespace

Character decode(std::string_view text) {
  if (text.empty()) return {0, 0, false};
  utf8proc_int32_t code = 0;
  const auto bytes = utf8proc_iterate(reinterpret_cast<const utf8proc_uint8_t*>(text.data()),
                                      static_cast<utf8proc_ssize_t>(std::min<std::size_t>(text.size(), 4)), &code);
  if (bytes <= 0) return {0, 1, false};
  return {static_cast<char32_t>(code), static_cast<std::size_t>(bytes), true};
}

void append_utf8(std::string& out, char32_t code) {
  std::array<utf8proc_uint8_t, 4> bytes{};
  const auto count = utf8proc_encode_char(static_cast<utf8proc_int32_t>(code), bytes.data());
  out.append(reinterpret_cast<const char*>(bytes.data()), static_cast<std::size_t>(count));
}

bool is_hidden(char32_t code) {
  switch (category(code)) {
    case UTF8PROC_CATEGORY_CC:
    case UTF8PROC_CATEGORY_CF:
    case UTF8PROC_CATEGORY_CS:
    case UTF8PROC_CATEGORY_CO:
    case UTF8PROC_CATEGORY_CN:
    case UTF8PROC_CATEGORY_ZL:
    case UTF8PROC_CATEGORY_ZP: return true;
    default: break;
  }
  const bool blank_letter = code == 0x2800;  // Braille without dots
  return blank_letter || utf8proc_get_property(static_cast<utf8proc_int32_t>(code))->ignorable;
}

bool is_mark(char32_t code) {
  const auto is = category(code);
  return is == UTF8PROC_CATEGORY_MN || is == UTF8PROC_CATEGORY_ME;
}

std::size_t columns(char32_t code) {
  if (is_mark(code)) return 0;
  return utf8proc_charwidth(static_cast<utf8proc_int32_t>(code)) == 2 ? 2 : 1;
}

bool is_name(std::string_view text) {
  if (text.empty() || text.size() > kLongestName || !is_composed(text)) return false;
  const Character first = decode(text);
  if (!first.valid || !is_letter(first.code)) return false;
  for (std::string_view rest = text; !rest.empty(); rest.remove_prefix(decode(rest).bytes)) {
    const Character next = decode(rest);
    if (!next.valid || !continues_name(next.code)) return false;
  }
  return true;
}

}  // namespace fiona::unicode
