#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <Eigen/Core>

#include "level_tracker.hpp"
#include "radio_likelihood.hpp"
#include "radio_map.hpp"
#include "random.hpp"

namespace fiona::radio {

using Time = std::chrono::milliseconds;  ///< since any fixed epoch

struct FilterOptions {
  std::size_t particles = 1500;
  std::uint64_t seed = 1;
  double temper = 0.5;  ///< log-likelihood of a sweep of n rows counts temper / sqrt(n): rows are not independent
  LikelihoodOptions likelihood = {};
  double heading_bias_sd_rad = 0.12;  ///< of a walk, at its start
  double heading_drift_rad = 0.02;    ///< per step
  double step_gain_sd = 0.06;         ///< of a walker, at the start
  double step_gain_drift = 0.006;     ///< per step
  double still_diffusion_m = 0.6;     ///< per square root of a second, whatever the steps say
  double free_diffusion_m = 1.2;      ///< the same without a step source
  double map_error_sd_m = 1.5;        ///< by which radio points beside the truth, alike over a few metres of walking
  double map_error_reach_m = 8.0;     ///< walk over which that error is forgotten
  Time stamp_lag{600};                ///< by which receivers stamp rows too early; measured on survey walks
  double jump_rate_per_s = 5e-4;      ///< carried off unseen: how often the filter believes that it was kidnapped
  double path_prior = 0.3;            ///< weight per second of the squared distance from where the survey walked
};

/// A step of the walker in the map's frame.
struct StepInput {
  Time time;
  double length_m;
  double length_sd_m;
  double heading_rad;  ///< counter-clockwise from east
  double heading_sd_rad;
  double compass_rad = 0.0;  ///< the same by the magnetometer alone; only a survey is learnt from it
};

/// One transmitter heard.
struct SignalInput {
  std::string_view id;  ///< MAC address or other identifier; case and separators do not matter
  Radio radio;
  double rssi_dbm;
  Time heard;  ///< when it was really heard; a row told twice counts once
};

enum class Validity : std::uint8_t {
  Valid,
  NoEvidence,       ///< nothing was heard yet
  ForeignBuilding,  ///< hardly any transmitter that is heard is in the map
  Ambiguous,        ///< the evidence fits too many places
};

/// Where the receiver is.
struct Estimate {
  Validity validity = Validity::NoEvidence;
  Time time{};
  double x_m = 0.0, y_m = 0.0;  ///< east, north
  int level = 0;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of (x, y), m^2
  double level_variance = 0.0;
  double level_probability = 0.0;
  double known_share = 0.0;  ///< of the rows heard lately, those that the map knows

  bool is_valid() const { return validity == Validity::Valid; }
};

/// Position from radio and steps: a particle filter over position, level, heading bias and step gain, with a receiver
/// offset beside it. Causal and deterministic: same inputs and seed, same answers. Inputs must come in the order of
/// time; rows may have been heard up to `kOldestRow` before they are told, and are judged where the particles were
/// then. After Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), chapter 8 (mixture proposal from the radio map for
/// the first fix and for kidnapping), and Murata et al., "Smartphone-based localization for blind navigation in
/// building-scale indoor environments" (doi 10.1016/j.pmcj.2019.04.003).
class RadioFilter {
 public:
  RadioFilter(std::shared_ptr<const RadioMap> map, const FilterOptions& options = {});

  /// A row that is told later than that after it was heard is no evidence.
  static constexpr Time kOldestRow{10'000};

  /// Whether steps are told from now on, which they are at first; else walking is a random walk.
  void expect_steps(bool expected) { steps_expected_ = expected; }
  void step(const StepInput& step);
  /// Tells one row now, at `time`. Rows of one sweep come at one time, or nearly so.
  void signal(Time time, const SignalInput& signal);
  /// Moves time on; what was told before is used. To be called before each estimate.
  void advance(Time now);
  Estimate estimate() const;

  /// Receiver's reading above the survey's, dB.
  double receiver_offset_db() const { return offset_db_; }

 private:
  struct Particle {
    double x_m, y_m, heading_bias_rad, step_gain;
    double map_error_x_m, map_error_y_m;
    std::uint32_t level_index;
    double weight;
  };
  struct Pending {
    HeardRow row;
    Time heard;
  };
  struct PastStep {
    Time time;
    double east_m, north_m;
  };
  struct Slice {
    Time heard;
    std::vector<HeardRow> rows;
    std::vector<float> field;
    float outside = 0.0f;
  };

  void diffuse(double dt_s);
  void use_pending();
  std::vector<Slice> slices();
  void weigh(const std::vector<Slice>& slices, double dt_s);
  void jump_or_resample(const std::vector<float>& total, double log_weight_mean, double dt_s);
  void start(const std::vector<float>& total);
  void resample(std::size_t count, std::vector<Particle>& into);
  Particle sample_from(const std::vector<double>& cumulated);
  std::vector<double> cumulated(const std::vector<float>& total, double& log_mean) const;
  void follow_level(const std::vector<Slice>& slices, const std::vector<float>& total, float temper, double dt_s);
  void learn_offset(const std::vector<Slice>& slices);
  std::vector<double> particles_by_level() const;
  Eigen::Vector2d moved_since(Time since) const;
  void forget_old(Time now);

  std::shared_ptr<const RadioMap> map_;
  FilterOptions options_;
  RadioLikelihood likelihood_;
  bool steps_expected_ = true;
  LevelTracker levels_;
  Random random_;
  std::vector<Particle> particles_;
  std::vector<Particle> scratch_;
  std::vector<Pending> pending_;
  std::unordered_map<std::uint32_t, Time> last_heard_;
  std::deque<PastStep> past_steps_;
  std::optional<Time> now_;
  std::optional<Time> pending_since_;
  Time last_told_{};
  std::optional<Time> last_use_;
  double known_rows_ = 0.0;
  double all_rows_ = 0.0;
  double offset_db_ = 0.0;
  double offset_variance_ = 16.0;
};

}  // namespace fiona::radio
