#include "radio_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace fiona::radio {
namespace {

float strongest_dbm(const std::vector<Expectation>& expectations, const Transmitter::Span& span) {
  std::uint8_t least_q = std::numeric_limits<std::uint8_t>::max();
  for (std::uint32_t i = span.begin; i < span.end; ++i) least_q = std::min(least_q, expectations[i].rssi_q);
  return -0.5f * static_cast<float>(least_q);
}

}  // namespace

std::string normalised_id(std::string_view id) {
  std::string result;
  result.reserve(id.size());
  for (const char c : id) {
    if (c == ':' || c == '-') continue;
    result.push_back(c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c);
  }
  return result;
}

void RadioMap::index() {
  by_id_.clear();
  silence_.assign(cells.size(), 0.0f);
  for (std::uint32_t number = 0; number < transmitters.size(); ++number) {
    Transmitter& transmitter = transmitters[number];
    by_id_.emplace(transmitter.id, number);
    for (auto& span : transmitter.spans) span.strongest_dbm = strongest_dbm(expectations, span);
    if (transmitter.radio != Radio::WiFi) continue;
    for (const auto& span : transmitter.spans) {
      const std::uint32_t first = levels[span.level_index].first_cell;
      for (std::uint32_t i = span.begin; i < span.end; ++i) {
        silence_[first + expectations[i].cell] += static_cast<float>(std::log1p(-heard_probability(expectations[i])));
      }
    }
  }
}

std::optional<std::uint32_t> RadioMap::find(std::string_view id) const {
  const auto found = by_id_.find(normalised_id(id));
  if (found == by_id_.end()) return std::nullopt;
  return found->second;
}

std::int32_t RadioMap::cell_at(std::size_t level_index, double x_m, double y_m) const {
  const Level& level = levels[level_index];
  const double column = std::floor((x_m - level.west_m) / cell_m);
  const double row = std::floor((y_m - level.south_m) / cell_m);
  if (!(column >= 0 && column < level.columns && row >= 0 && row < level.rows)) return -1;
  return level.cell_at[static_cast<std::size_t>(row) * level.columns + static_cast<std::size_t>(column)];
}

std::optional<std::size_t> RadioMap::level_index(int level) const {
  for (std::size_t i = 0; i < levels.size(); ++i) {
    if (levels[i].level == level) return i;
  }
  return std::nullopt;
}

}  // namespace fiona::radio
