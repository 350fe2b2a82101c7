#include "map_name.hpp"

#include <algorithm>

#include "fiona/building/levels.hpp"

namespace fiona::map_server {

std::optional<MapName> MapName::parse(std::string_view text) {
  const std::size_t at = text.rfind('@');
  if (at == std::string_view::npos || at == 0) return std::nullopt;
  const auto levels = building::parse_levels(text.substr(at + 1));
  if (!levels || levels->size() != 1) return std::nullopt;
  return MapName{std::string(text.substr(0, at)), levels->front()};
}

std::string MapName::text() const { return name + '@' + building::level_text(level); }

bool is_map_name(std::string_view name) {
  const auto forbidden = [](unsigned char c) { return c < 0x20 || c == 0x7f || c == '@' || c == '/'; };
  return !name.empty() && name.size() <= 200 && name.find("..") == std::string_view::npos &&
         std::none_of(name.begin(), name.end(), forbidden);
}

}  // namespace fiona::map_server
