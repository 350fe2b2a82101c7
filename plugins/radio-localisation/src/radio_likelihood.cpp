#include "radio_likelihood.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace fiona::radio {
namespace {

constexpr int kDeviations = 511;  // -255 … 255 half decibels
constexpr int kMiddle = 255;
constexpr int kHeardShift = 2;

}  // namespace

RadioLikelihood::RadioLikelihood(const RadioMap& map, const LikelihoodOptions& options) : map_(map), options_(options) {
  table_.resize((256 >> kHeardShift) * kDeviations);
  const double scale = 1.0 / (options.sd_db * std::sqrt(2.0 * std::numbers::pi));
  for (int heard = 0; heard < 256 >> kHeardShift; ++heard) {
    const double p = (heard + 0.5) / (256 >> kHeardShift);
    for (int deviation = 0; deviation < kDeviations; ++deviation) {
      const double z = 0.5 * (deviation - kMiddle) / options.sd_db;
      const double density = p * scale * std::exp(-0.5 * z * z) + options.outlier_density;
      table_[heard * kDeviations + deviation] =
          static_cast<float>(std::log(density / options.outlier_density) - options.silence_weight * std::log1p(-p));
    }
  }
}

void RadioLikelihood::add_rows(std::span<const HeardRow> rows, double offset_db, std::span<float> field) const {
  for (const HeardRow& row : rows) {
    const int rssi_half_db = static_cast<int>(std::lround(2.0 * (row.rssi_dbm - offset_db)));
    for (const auto& span : map_.transmitters[row.transmitter].spans) {
      float* level = field.data() + map_.levels[span.level_index].first_cell;
      for (std::uint32_t i = span.begin; i < span.end; ++i) {
        const Expectation& e = map_.expectations[i];
        const int deviation = std::clamp(rssi_half_db + e.rssi_q + kMiddle, 0, kDeviations - 1);
        level[e.cell] += row.weight * table_[(e.heard_q >> kHeardShift) * kDeviations + deviation];
      }
    }
  }
}

void RadioLikelihood::add_silence(std::span<float> field) const {
  const auto silence = map_.silence();
  const auto weight = static_cast<float>(options_.silence_weight);
  for (std::size_t cell = 0; cell < field.size(); ++cell) field[cell] += weight * silence[cell];
}

std::vector<double> RadioLikelihood::log_mean_by_level(std::span<const float> field) const {
  std::vector<double> result;
  for (const Level& level : map_.levels) {
    const auto cells = field.subspan(level.first_cell, level.cell_count);
    const double largest = cells.empty() ? 0.0 : *std::max_element(cells.begin(), cells.end());
    double sum = 0.0;
    for (const float value : cells) sum += std::exp(value - largest);
    result.push_back(cells.empty() ? -std::numeric_limits<double>::infinity()
                                   : largest + std::log(sum / static_cast<double>(cells.size())));
  }
  return result;
}

void RadioLikelihood::add_excess(std::span<const HeardRow> rows, double offset_db, std::span<double> levels) const {
  const double outlier = options_.outlier_density * options_.sd_db * std::sqrt(2.0 * std::numbers::pi);
  std::vector<double> strongest_dbm(levels.size());
  for (const HeardRow& row : rows) {
    std::fill(strongest_dbm.begin(), strongest_dbm.end(), options_.quietest_dbm);
    for (const auto& span : map_.transmitters[row.transmitter].spans) {
      double& strongest = strongest_dbm[span.level_index];
      strongest = std::max<double>(strongest, span.strongest_dbm);
    }
    for (std::size_t level = 0; level < levels.size(); ++level) {
      const double z = std::max(0.0, row.rssi_dbm - offset_db - strongest_dbm[level]) / options_.sd_db;
      levels[level] += row.weight * std::log(std::exp(-0.5 * z * z) + outlier);
    }
  }
}

float RadioLikelihood::at(std::span<const float> field, std::size_t level_index, double x_m, double y_m,
                          float outside) const {
  const Level& level = map_.levels[level_index];
  const double column = (x_m - level.west_m) / map_.cell_m - 0.5;
  const double row = (y_m - level.south_m) / map_.cell_m - 0.5;
  const double column0 = std::floor(column), row0 = std::floor(row);
  double sum = 0.0, weights = 0.0;
  for (int corner = 0; corner < 4; ++corner) {
    const double c = column0 + (corner & 1), r = row0 + (corner >> 1);
    if (!(c >= 0 && c < level.columns && r >= 0 && r < level.rows)) continue;
    const std::int32_t cell = level.cell_at[static_cast<std::size_t>(r) * level.columns + static_cast<std::size_t>(c)];
    if (cell < 0) continue;
    const double weight = (1.0 - std::abs(column - c)) * (1.0 - std::abs(row - r));
    sum += weight * field[cell];
    weights += weight;
  }
  return weights > 1e-3 ? static_cast<float>(sum / weights) : outside;
}

std::pair<double, double> RadioLikelihood::deviation_db(std::span<const HeardRow> rows, std::size_t level_index,
                                                        double x_m, double y_m) const {
  const std::int32_t cell = map_.cell_at(level_index, x_m, y_m);
  double sum = 0.0, weights = 0.0;
  if (cell < 0) return {0.0, 0.0};
  const auto local = static_cast<std::uint16_t>(cell - map_.levels[level_index].first_cell);
  for (const HeardRow& row : rows) {
    for (const auto& span : map_.transmitters[row.transmitter].spans) {
      if (span.level_index != level_index) continue;
      const auto begin = map_.expectations.begin() + span.begin, end = map_.expectations.begin() + span.end;
      const auto found = std::lower_bound(begin, end, local,
                                          [](const Expectation& e, std::uint16_t wanted) { return e.cell < wanted; });
      if (found == end || found->cell != local || heard_probability(*found) < 0.3) continue;
      sum += row.weight * std::clamp(row.rssi_dbm - expected_rssi_dbm(*found), -15.0, 15.0);
      weights += row.weight;
    }
  }
  return {weights > 0.0 ? sum / weights : 0.0, weights};
}

}  // namespace fiona::radio
