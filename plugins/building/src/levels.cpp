#include "fiona/building/levels.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>

namespace fiona::building {
namespace {

constexpr std::size_t kMostLevelsOfTag = 200;
constexpr double kHighestLevel = 1000.0;

std::string_view trim(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

/// Takes a number off the front of `text`.
std::optional<double> take_number(std::string_view& text) {
  double value = 0.0;
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, std::chars_format::fixed);
  if (error != std::errc{} || !std::isfinite(value)) return std::nullopt;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return value;
}

struct Range {
  double low;
  double high;
};

std::optional<Range> parse_range(std::string_view text) {
  text = trim(text);
  const std::optional<double> first = take_number(text);
  if (!first || std::abs(*first) > kHighestLevel) return std::nullopt;
  text = trim(text);
  if (text.empty()) return Range{*first, *first};
  if (!text.starts_with('-')) return std::nullopt;
  text = trim(text.substr(1));
  const std::optional<double> second = take_number(text);
  if (!second || !text.empty() || std::abs(*second) > kHighestLevel) return std::nullopt;
  return Range{std::min(*first, *second), std::max(*first, *second)};
}

void add_once(std::vector<double>& levels, double level) {
  if (std::find(levels.begin(), levels.end(), level) == levels.end()) levels.push_back(level);
}

}  // namespace

std::optional<std::vector<double>> parse_levels(std::string_view text) {
  std::vector<double> levels;
  while (true) {
    const std::size_t end = text.find(';');
    const std::optional<Range> range = parse_range(text.substr(0, end));
    if (!range || range->high - range->low >= kMostLevelsOfTag) return std::nullopt;
    for (double level = range->low; level < range->high; level += 1.0) add_once(levels, level);
    add_once(levels, range->high);
    if (levels.size() > kMostLevelsOfTag) return std::nullopt;
    if (end == std::string_view::npos) return levels;
    text.remove_prefix(end + 1);
  }
}

std::optional<double> parse_metres(std::string_view text) {
  text = trim(text);
  const std::optional<double> value = take_number(text);
  text = trim(text);
  if (!value || !(text.empty() || text == "m")) return std::nullopt;
  return value;
}

std::string level_text(double level) {
  char text[32];
  const double shown = level == 0.0 ? 0.0 : level;  // "-0" would be another name for the ground
  const auto result = std::to_chars(text, text + sizeof(text), shown);
  return {text, result.ptr};
}

Heights::Heights(double default_storey_m, std::map<int, double> storey_m)
    : default_storey_m_(default_storey_m), storey_m_(std::move(storey_m)) {}

double Heights::storey_m(int level) const {
  const auto known = storey_m_.find(level);
  return known == storey_m_.end() ? default_storey_m_ : known->second;
}

double Heights::floor_m(double level) const {
  const int whole = static_cast<int>(std::floor(level));
  double height = 0.0;
  for (int storey = 0; storey < whole; ++storey) height += storey_m(storey);
  for (int storey = whole; storey < 0; ++storey) height -= storey_m(storey);
  return height + (level - whole) * storey_m(whole);
}

double Heights::level_at(double height_m) const {
  height_m = std::clamp(height_m, -10'000.0, 10'000.0);  // bounds the two loops
  int level = 0;
  double floor = 0.0;
  while (height_m < floor) floor -= storey_m(--level);
  while (height_m >= floor + storey_m(level)) floor += storey_m(level++);
  return level + (height_m - floor) / storey_m(level);
}

}  // namespace fiona::building
