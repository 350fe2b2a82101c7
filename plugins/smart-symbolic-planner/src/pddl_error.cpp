#include "pddl_error.hpp"

#include <algorithm>
#include <utility>

namespace fiona::planning {
namespace {

ErrorText with_place(ErrorText text, const Place& place) {
  text.where = place.to_string();
  return text;
}

}  // namespace

std::string Place::to_string() const {
  return std::string(text == Text::Domain ? "domain " : "problem ") + std::to_string(line) + ':' +
         std::to_string(column);
}

Place place_of(Text which, std::string_view text, std::size_t offset) {
  const std::string_view before = text.substr(0, offset);
  const auto lines = std::count(before.begin(), before.end(), '\n');
  const std::size_t line_begin = before.rfind('\n') + 1;  // npos + 1 is 0: the first line
  return {which, static_cast<std::uint32_t>(lines + 1), static_cast<std::uint32_t>(offset - line_begin + 1)};
}

PddlError::PddlError(Place place, ErrorText text)
    : Error(ErrorCode::Usage, with_place(std::move(text), place)), place_(place) {}

std::string PddlError::sentence() const {
  std::string line = text().where + ": " + text().what;
  if (!text().expected.empty()) line += ": expected " + text().expected;
  if (!text().found.empty()) line += ", found " + text().found;
  for (std::size_t i = 0; i < text().near.size(); ++i)
    line += (i == 0 ? "; did you mean '" : " or '") + text().near[i] + "'";
  if (!text().next.empty()) line += "; " + text().next;
  return line;
}

}  // namespace fiona::planning
