#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "beacon_field.hpp"
#include "floor_plan.hpp"
#include "random.hpp"

namespace fiona::beacons {

using Time = std::chrono::milliseconds;  ///< since any fixed epoch

struct FilterOptions {
  std::size_t particles = 2000;
  std::uint64_t seed = 1;
  bool walls = true;         ///< nobody walks through them
  bool heading_bias = true;  ///< as a state; false: headings of steps are taken as they are
  bool compass = true;       ///< what the building does to one is taken off; false: part of the heading bias
  bool rssi_offset = true;   ///< as a state; false: the receiver reads as the survey's did
  double temper = 0.8;       ///< weight of a second's log-likelihood: seconds are not independent
  double still_temper =
      0.1;               ///< least share of that for who stands: what a place does to a signal stays the same there
  double silence = 0.5;  ///< weight of what a second did not hear, beside what it did
  double heading_bias_sd_rad = 0.15;
  double heading_drift_rad = 0.02;                   ///< per step
  double held_sd_rad = 0.12, held_drift_rad = 0.01;  ///< the same where it is known how the building turns a compass
  double compass_gain_per_s = 0.15, drift_gain_per_s2 = 0.01;  ///< by which headings of steps follow the compass
  double step_gain_sd = 0.08, step_gain_drift = 0.006;
  double offset_drift_db = 0.1;       ///< per square root of a second
  double still_diffusion_m = 0.4;     ///< per square root of a second, with steps
  double free_diffusion_m = 2.0;      ///< the same without a source of steps
  double through_wall = 0.01;         ///< what remains of a particle's weight that walks through a wall
  double way_rate_per_s = 0.1;        ///< at which who stands before a lift gets into it
  double departure_rate_per_s = 0.1;  ///< at which a lift goes to another level
  double not_felt = 0.02;  ///< what remains of a particle's weight that was carried otherwise than the person felt
  double most_cabin_loss_db = 15.0;    ///< what a lift's cabin holds off, at most
  double way_rate_per_step = 0.3;      ///< at which who walks towards stairs takes them
  double jump_rate_per_s = 1e-3;       ///< carried off unseen, while walking
  double free_jump_rate_per_s = 3e-3;  ///< the same without a source of steps
};

struct StepInput {
  double length_m, length_sd_m;
  double heading_rad;  ///< counter-clockwise from east
  double heading_sd_rad;
  std::optional<double> rise_m{};  ///< by which a lift has carried the person since the step before
};

enum class Validity : std::uint8_t {
  Valid,
  NoEvidence,  ///< too little was heard yet
  Ambiguous,   ///< the evidence fits too many places
  Unheard,     ///< nothing was heard for two minutes
};

struct Estimate {
  Validity validity = Validity::NoEvidence;
  double x_m = 0.0, y_m = 0.0;  ///< east, north
  int level = 0;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of (x, y), m^2
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();      ///< of the particles alone
  double level_variance = 0.0;
  double rssi_offset_db = 0.0;  ///< receiver's reading above the survey's
  double heading_bias_rad = 0.0, heading_bias_variance = 0.0;

  bool is_valid() const { return validity == Validity::Valid; }
};

/// Position from beacons and steps within walls: a particle filter over position, level, heading bias, step gain and
/// RSSI offset of the receiver. Causal and deterministic. States and likelihood after Murata et al. (doi
/// 10.1016/j.pmcj.2019.04.003), walls after Woodman and Harle (doi 10.1145/1409635.1409651), first fix and recovery by
/// the mixture proposal of Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), chapter 8. Between levels a particle
/// is on stairs or in a lift of the plan, and nowhere else.
class BeaconFilter {
 public:
  BeaconFilter(std::shared_ptr<const BeaconField> field, std::shared_ptr<const FloorPlan> plan,
               const BeaconMap::Accuracy& accuracy, double offset_sd_db, const FilterOptions& options = {});

  /// From now on with this plan; what the particles know stays.
  void use(std::shared_ptr<const FloorPlan> plan);

  /// Whether steps are told from now on: then who takes none stands; else they may be anywhere that one can walk to.
  void expect_steps(bool expected) { steps_ = expected; }
  void step(const StepInput& step);
  /// One reading. Those of a second are used as one.
  void heard(std::uint32_t beacon, double rssi_dbm);
  /// Moves time on; to be called at least once a second, and before each estimate.
  void advance(Time now);
  Estimate estimate() const;

 private:
  struct Particle {
    double x_m, y_m, heading_bias_rad, step_gain, offset_db;
    std::uint32_t level_index;
    double weight;
    std::uint32_t stood_index = level_index;  ///< the level of the last step
    std::int32_t way = -1;                    ///< of ways_, while it is on one
    float share = 0.0f;                       ///< of that way
    float deviation_rad = 0.0f;               ///< of headings, from what the building does to a compass where it was
    float deviation_rad_s = 0.0f;             ///< of that, as the gyroscope's bias has taken it on
    float pace = 0.0f;     ///< share of it a second or, with steps, a metre of them; a lift that waits: 0
    float loss_db = 0.0f;  ///< in a lift, and of the second in which it was left

    double turned_rad() const { return heading_bias_rad - deviation_rad; }  ///< what is added to headings of steps
  };
  /// By the steps alone.
  struct Walked {
    double east_m = 0.0, north_m = 0.0;
  };
  using Second = std::vector<Heard>;
  struct Past {
    Second second;
    double weight;        ///< of its log-likelihood
    double log_evidence;  ///< of the particles when it came
    Walked since;         ///< it was heard
  };

  bool is_blocked(const Particle& p, double x_m, double y_m) const;
  void diffuse(double dt_s);
  bool knows_compass() const { return options_.compass && options_.heading_bias && field_->knows_compass(); }
  void follow_compass(Particle& p, double dt_s);
  void find_ways();
  void take_ways(double dt_s);
  bool is_before(const Particle& p, std::size_t way) const;
  bool is_in_lift() const;
  void carry(Particle& p, double rise_m);
  void enter(Particle& p, std::size_t way);
  void ride(Particle& p, double dt_s);
  void move_on_way(Particle& p, double share);
  void step_on_ways(const StepInput& step);
  void step_out_of_lift(Particle& p);
  double step_on_stairs(Particle& p, double length_m, double heading_rad);
  bool take_stairs(Particle& p, double heading_rad, double x_m, double y_m);
  struct OnStairs {
    std::size_t way;  ///< of ways_
    double share;
  };
  std::optional<OnStairs> stairs_at(std::uint32_t level_index, double x_m, double y_m) const;
  void put_on(Particle& p, OnStairs stairs);
  double share_of_steps(const Particle& p) const;
  double log_likelihood_on_way(const Particle& p, double x_m, double y_m, const Second& second, double weight) const;
  void use_second(double dt_s);
  void forget();
  void widen(double sd_m);
  void start_again(const Second& second);
  void start(const Second& second);
  double log_likelihood(const Particle& p, const Second& second, const Walked& since, double weight) const;
  Walked walked_since_heard();
  double weight_of_second(double moved);
  Eigen::Vector2d densest_place(std::size_t level_index) const;
  Particle anywhere();
  double normalise();
  void resample(std::size_t count, std::vector<Particle>& into);
  void keep_all_alike();
  double log_likelihood_of_past(const Particle& p) const;
  void jump_or_resample(double moved_s);
  std::size_t best_level(double& weight) const;

  std::shared_ptr<const BeaconField> field_;
  std::shared_ptr<const FloorPlan> plan_;
  BeaconMap::Accuracy accuracy_;
  FilterOptions options_;
  double offset_sd_db_;
  radio::Random random_;
  struct Place {
    double x_m, y_m;
    std::uint32_t level_index;
  };
  struct Way {
    const FloorPlan::Way* path;  ///< of plan_
    std::uint32_t from_index, to_index;
    std::optional<std::size_t> back;              ///< the way down where this one leads up, if there is one
    double low_x_m, low_y_m, high_x_m, high_y_m;  ///< around it, as wide as it is
  };
  std::vector<Way> ways_;      ///< those between levels of the field
  std::vector<Place> places_;  ///< where a person may be, one for each cell of the field
  std::vector<Particle> particles_, scratch_;
  std::vector<std::pair<std::size_t, double>> on_ways_;       ///< in a step: particle and heading
  std::vector<std::size_t> on_stairs_;                        ///< those of them
  std::map<std::uint32_t, std::pair<double, int>> readings_;  ///< of this second: sum and count, by beacon
  Walked walked_;                                             ///< since the last second was used
  Walked heard_at_;                                           ///< the sum of that at the readings
  std::deque<Past> past_;
  std::optional<Time> now_, used_;
  std::optional<Time> heard_;  ///< the end of the last second in which anything was
  bool steps_ = false;
  double walked_m_ = 0.0;  ///< since the last second was used
  double still_s_ = 0.0;   ///< seconds used since the walker last moved on
  /// Of the seconds before the first step: sum of the readings, and in how many there was one, by beacon.
  std::map<std::uint32_t, std::pair<double, int>> first_;
  int first_seconds_ = 0;
  bool has_stepped_ = false;
};

}  // namespace fiona::beacons
