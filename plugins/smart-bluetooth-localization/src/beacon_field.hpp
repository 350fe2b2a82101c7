#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "beacon_map.hpp"

namespace fiona::beacons {

/// What a receiver without offset hears of one beacon in one place.
struct Expected {
  float mean_dbm;
  float variance_db2;  ///< of the mean, where the survey says little
};

/// One beacon heard in one second.
struct Heard {
  std::uint32_t beacon;
  float rssi_dbm;
};

/// The rectangle of a level that a field covers, metres.
struct Extent {
  int level;
  double low_x_m, low_y_m, high_x_m, high_y_m;

  bool operator==(const Extent&) const = default;
};

/// How strongly each beacon is heard in each place of each level: a Gaussian process over the mean of a log-distance
/// path loss, conditioned on the survey (Ferris, Hähnel, Fox, "Gaussian processes for signal strength-based location
/// estimation", doi 10.15607/RSS.2006.II.039), worked out once on a grid. Immutable.
class BeaconField {
 public:
  /// Extents beyond what beacons and survey span, those of a plan, may be added; one level once.
  /// Cells of 0.5 m, and larger ones where that were more than 16 Mi values. Throws Error Usage for a map of more
  /// beacons and levels than that.
  explicit BeaconField(const BeaconMap& map, std::span<const Extent> more = {});

  struct Level {
    int level;
    double west_m, south_m;
    std::uint32_t columns, rows;
    std::size_t first_cell;
  };
  struct Cell {
    double x_m, y_m;
  };

  std::span<const Level> levels() const { return levels_; }  ///< ascending
  double cell_m() const { return cell_m_; }
  std::size_t cells() const { return cells_; }
  std::size_t beacons() const { return beacons_; }
  Cell centre(std::size_t level_index, std::size_t cell_of_level) const;

  std::optional<std::uint32_t> find(std::string_view id) const;

  /// Expectation of each beacon in the place, beacons() of them; of the nearest cell where it lies outside.
  std::span<const Expected> at(std::size_t level_index, double x_m, double y_m) const;
  std::span<const Expected> of_cell(std::size_t cell) const { return {&expected_[cell * beacons_], beacons_}; }

  /// By how much the building turns a compass around there, radians counter-clockwise, nearly 0 where no survey went: a
  /// kernel smoother (Nadaraya 1964, doi 10.1137/1109020) over what the survey says. As `at` of the nearest cell.
  double compass_deviation_rad(std::size_t level_index, double x_m, double y_m) const;
  double usual_deviation_rad() const { return usual_deviation_rad_; }  ///< root mean square of what the survey says
  bool knows_compass() const { return !deviation_rad_.empty(); }

  /// Log-likelihood of a second: `heard`, ascending by beacon, and the silence of all others, for a receiver that reads
  /// `offset_db` too high. `silence` weighs what was not heard; 0: not at all.
  double log_likelihood(std::span<const Expected> expected, std::span<const Heard> heard, double offset_db,
                        double silence) const;

 private:
  void lay_out(const BeaconMap& map, std::span<const Extent> more);
  void work_out(const BeaconMap& map, std::size_t beacon);
  void work_out_compass(const BeaconMap& map);
  std::size_t cell_at(const Level& level, double x_m, double y_m) const;
  float log_heard(double mean_dbm) const { return table(log_heard_, mean_dbm); }
  float log_unheard(double mean_dbm) const { return table(log_unheard_, mean_dbm); }
  float table(const std::vector<float>& values, double mean_dbm) const;

  BeaconMap::Radio radio_;
  std::vector<Level> levels_;
  double cell_m_ = 1.0;
  std::size_t cells_ = 0, beacons_ = 0;
  std::vector<Expected> expected_;  ///< cell by cell, beacon by beacon
  double usual_deviation_rad_ = 0.0;
  std::vector<float> deviation_rad_;  ///< of a compass, cell by cell; empty: no survey says
  std::unordered_map<std::string, std::uint32_t> by_id_;
  std::vector<float> log_heard_, log_unheard_;  ///< by expected dBm
};

}  // namespace fiona::beacons
