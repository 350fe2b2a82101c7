#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "radio_map.hpp"

namespace fiona::radio {

struct LikelihoodOptions {
  double sd_db = 6.0;             ///< of one RSSI around its expectation: body, hand, people, other phone
  double outlier_density = 3e-4;  ///< per dB: the transmitter was moved, or heard where the survey did not hear it
  double silence_weight = 0.3;    ///< of "not heard" against "heard": receivers skip channels and cut lists
  double quietest_dbm = -95.0;    ///< that receivers hear: the most that a level without the transmitter expects
};

/// One transmitter heard now.
struct HeardRow {
  std::uint32_t transmitter;
  float rssi_dbm;
  float weight;  ///< below 1 where several rows are one radio
};

/// How well heard rows fit each cell of a map: log of p N(rssi; expectation, sd) + outlier, against 1 - p of silence,
/// per row (the measurement model of Ferris, Hähnel, Fox, "Gaussian processes for signal strength-based location
/// estimation", RSS 2006, with the probability of detection added). Independent of where the particles are, so one
/// evaluation serves the particles, the first fix and the recovery.
class RadioLikelihood {
 public:
  explicit RadioLikelihood(const RadioMap& map, const LikelihoodOptions& options = {});

  /// Adds the log-likelihood of the rows to `field`, one value per cell. `offset_db` is what this receiver reads
  /// above the survey's receivers.
  void add_rows(std::span<const HeardRow> rows, double offset_db, std::span<float> field) const;

  /// Adds what not hearing all other transmitters says; once per sweep.
  void add_silence(std::span<float> field) const;

  /// Log of the mean likelihood over each level's cells: what the field says of the level, wherever on it.
  std::vector<double> log_mean_by_level(std::span<const float> field) const;

  /// Adds, one value per level, how badly the rows exceed what is expected of their transmitters anywhere on the level:
  /// half a Gaussian above the strongest expectation, and the same outliers. A place that the survey left out hears
  /// other networks than its neighbours, yet seldom one from the level above much stronger than that level itself does.
  void add_excess(std::span<const HeardRow> rows, double offset_db, std::span<double> levels) const;

  /// The field at a point, interpolated between the cells around it; `outside` where there are none.
  float at(std::span<const float> field, std::size_t level_index, double x_m, double y_m, float outside) const;

  /// Mean deviation of the rows from what the map expects at the point, and the number of rows it rests on.
  std::pair<double, double> deviation_db(std::span<const HeardRow> rows, std::size_t level_index, double x_m,
                                         double y_m) const;

 private:
  const RadioMap& map_;
  LikelihoodOptions options_;
  std::vector<float> table_;  // [heard_q / 4][deviation in half dB + 255]
};

}  // namespace fiona::radio
