#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "radio_map.hpp"

namespace fiona::radio {

struct LearnerOptions {
  double cell_m = 2.0;
  double reach_m = 5.0;      ///< cells are made this far from survey walks
  double kernel_m = 2.5;     ///< standard deviation of the kernel's core
  double wide_factor = 3.0;  ///< of the kernel's tail, which fills in where the survey is thin
  double wide_weight = 0.05;
  double doubt_sweeps = 0.15;  ///< sweeps without the transmitter that are assumed everywhere
  double least_heard = 0.02;   ///< probability below which a cell forgets a transmitter
  int offset_rounds = 1;       ///< of learning what each walk's phone reads above the others
  std::size_t most_samples = 50'000'000;
};

/// Learns a radio map by kernel regression (Nadaraya-Watson) per transmitter and level: the mean RSSI where it was
/// heard, and the share of sweeps that heard it. Two Gaussians of different width make the kernel adaptive: where
/// samples are dense the core decides, where they are thin the tail. Phones differ by up to ten decibels: what each
/// walk reads above the others is learnt along with the map, in turns, and taken off.
class RadioMapLearner {
 public:
  explicit RadioMapLearner(const LearnerOptions& options = {});

  /// What follows was recorded on another walk, perhaps with another phone. Gives the walk's number.
  std::uint32_t begin_walk();

  /// A receiver listened here once over all channels, whatever it heard.
  void sweep(Radio radio, int level, double x_m, double y_m);

  /// That transmitter was heard here.
  void heard(std::string_view id, Radio radio, int level, double x_m, double y_m, double rssi_dbm);

  /// A survey walk went through here. Points should lie at most half a cell apart.
  void path(int level, double x_m, double y_m);

  std::uint32_t walks() const { return walk_; }

  /// Number of walks but `walk` that went through the place.
  std::size_t other_walks_near(std::uint32_t walk, int level, double x_m, double y_m, double radius_m) const;

  /// Learns from all walks but those of the numbers in `left_out`. Throws fiona::Error when nothing was learnt, or a
  /// level is larger than a map can hold.
  RadioMap learn(std::string name, const std::set<std::uint32_t>& left_out = {}) const;

 private:
  struct Point {
    std::int32_t level;
    float x_m, y_m;
    std::uint32_t walk;
  };
  struct Sample {
    Point at;
    float rssi_dbm;
  };
  struct Heard {
    std::string id;
    Radio radio;
    std::vector<Sample> samples;
  };
  struct Kernel;
  struct WalkUse {
    bool counts = true;
    double offset_db = 0.0;  ///< what its phone reads above the others
  };

  void make_levels(RadioMap& map, const std::vector<Point>& path) const;
  void make_cells(RadioMap& map, const std::vector<Point>& path, std::size_t level_index) const;
  std::vector<float> count_sweeps(const RadioMap& map, Radio radio, const std::vector<WalkUse>& walks,
                                  const Kernel& kernel) const;
  void learn_transmitters(RadioMap& map, const std::vector<WalkUse>& walks, const Kernel& kernel) const;
  void learn_transmitter(RadioMap& map, const Heard& heard, const std::vector<float>& sweeps,
                         const std::vector<WalkUse>& walks, const Kernel& kernel) const;
  void refine_offsets(const RadioMap& map, std::vector<WalkUse>& walks) const;

  LearnerOptions options_;
  std::vector<Point> path_;
  std::vector<Point> sweeps_[2];
  std::vector<Heard> heard_;
  std::unordered_map<std::string, std::size_t> by_id_;
  std::size_t samples_ = 0;
  std::uint32_t walk_ = 0;
};

}  // namespace fiona::radio
