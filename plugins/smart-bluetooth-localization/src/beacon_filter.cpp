#include "beacon_filter.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

namespace fiona::beacons {
namespace {

constexpr Time kSecond{1000};
constexpr Time kFirst{800};              // of the first second, are enough for a place
constexpr std::size_t kFirstDraws = 10;  // for each particle of the first fix
constexpr std::size_t kPastSeconds = 20;
constexpr double kNewPlace_m = 1.0;      // walked in a second, after which what is heard is news
constexpr double kDensityCell_m = 6.0;   // of particles: modes nearer than that are one
constexpr double kMode_m = 9.0;          // around the densest place: particles that are of its mode
constexpr double kLeastOfMode = 0.3;     // of the weight; with less, and a wide spread, an estimate guides nobody
constexpr std::size_t kJumpDraws = 500;  // each second, to see whether elsewhere fits better
constexpr double kWidestSpread_m = 25.0;
constexpr double kLongestGap_s = 10.0;
/// Nothing heard: steps and walls tell where one is for so long, and then less and less than the particles believe (a
/// lift, a door that is none); in the end they guide nobody. A building with few beacons is silent for a minute at
/// times.
constexpr Time kTrustsSteps{15'000}, kLongestUnheard{120'000};
constexpr double kLost_mps = 0.1;
constexpr double kNewFor_s = 5.0;  // of standing
constexpr int kFirstSeconds = 16;  // of standing

/// How far from the particles one may be by then.
double lost_m(Time unheard) {
  return kLost_mps * std::chrono::duration<double>(std::max(Time{}, unheard - kTrustsSteps)).count();
}

}  // namespace

BeaconFilter::BeaconFilter(std::shared_ptr<const BeaconField> field, std::shared_ptr<const FloorPlan> plan,
                           const BeaconMap::Accuracy& accuracy, double offset_sd_db, const FilterOptions& options)
    : field_(std::move(field)),
      accuracy_(accuracy),
      options_(options),
      offset_sd_db_(options.rssi_offset ? offset_sd_db : 0.0),
      random_(options.seed) {
  use(std::move(plan));
}

void BeaconFilter::use(std::shared_ptr<const FloorPlan> plan) {
  plan_ = std::move(plan);
  find_ways();
  places_.clear();
  for (std::uint32_t l = 0; l < field_->levels().size(); ++l) {
    const auto& level = field_->levels()[l];
    for (std::size_t cell = 0; cell < std::size_t{level.columns} * level.rows; ++cell) {
      const auto at = field_->centre(l, cell);
      if (!options_.walls || plan_->may_be_at(level.level, at.x_m, at.y_m)) places_.push_back({at.x_m, at.y_m, l});
    }
  }
}

bool BeaconFilter::is_blocked(const Particle& p, double x_m, double y_m) const {
  const int level = field_->levels()[p.level_index].level;
  return options_.walls && (plan_->wall_between(level, p.x_m, p.y_m, x_m, y_m) || plan_->is_closed(level, x_m, y_m) ||
                            stairs_at(p.level_index, x_m, y_m));
}

void BeaconFilter::step(const StepInput& step) {
  steps_ = has_stepped_ = true;
  walked_m_ += step.length_m;
  const auto walk = [east_m = step.length_m * std::cos(step.heading_rad),
                     north_m = step.length_m * std::sin(step.heading_rad)](Walked& walked) {
    walked.east_m += east_m;
    walked.north_m += north_m;
  };
  const double drift_rad = knows_compass() ? options_.held_drift_rad : options_.heading_drift_rad;
  for (Past& past : past_) walk(past.since);
  walk(walked_);
  on_ways_.clear();
  on_stairs_.clear();
  for (std::size_t i = 0; i < particles_.size(); ++i) {
    Particle& p = particles_[i];
    if (step.rise_m) carry(p, *step.rise_m);
    p.stood_index = p.level_index;
    if (options_.heading_bias) p.heading_bias_rad += drift_rad * random_.normal();
    p.step_gain += options_.step_gain_drift * random_.normal();
    const double length = p.step_gain * step.length_m + step.length_sd_m * random_.normal();
    const double heading = step.heading_rad + p.turned_rad() + 0.5 * step.heading_sd_rad * random_.normal();
    if (p.way >= 0) {
      on_ways_.emplace_back(i, heading);
      continue;
    }
    const double x = p.x_m + length * std::cos(heading), y = p.y_m + length * std::sin(heading);
    if (take_stairs(p, heading, x, y)) continue;
    if (is_blocked(p, x, y)) {
      p.weight *= options_.through_wall;
      continue;
    }
    p.x_m = x;
    p.y_m = y;
  }
  step_on_ways(step);
}

void BeaconFilter::heard(std::uint32_t beacon, double rssi_dbm) {
  auto& [sum, count] = readings_[beacon];
  sum += rssi_dbm;
  ++count;
  heard_at_.east_m += walked_.east_m;
  heard_at_.north_m += walked_.north_m;
}

void BeaconFilter::advance(Time now) {
  if (now_ && now <= *now_) return;
  const double dt_s = now_ ? std::min(kLongestGap_s, std::chrono::duration<double>(now - *now_).count()) : 0.0;
  now_ = now;
  const bool first = particles_.empty();
  if (!used_ || (first && readings_.empty())) used_ = now;
  diffuse(dt_s);
  if (now - *used_ < (first ? kFirst : kSecond)) return;
  const double since_s = std::min(kLongestGap_s, std::chrono::duration<double>(now - *used_).count());
  used_ = first ? std::max(now, *used_ + kSecond) : now;
  take_ways(since_s);
  use_second(since_s);
}

void BeaconFilter::diffuse(double dt_s) {
  const double sd = (steps_ ? options_.still_diffusion_m : options_.free_diffusion_m) * std::sqrt(dt_s);
  const double offset_sd = options_.rssi_offset ? options_.offset_drift_db * std::sqrt(dt_s) : 0.0;
  for (Particle& p : particles_) {
    p.offset_db += offset_sd * random_.normal();
    follow_compass(p, dt_s);
    if (p.way >= 0) continue;
    const double x = p.x_m + sd * random_.normal(), y = p.y_m + sd * random_.normal();
    if (is_blocked(p, x, y)) continue;
    p.x_m = x;
    p.y_m = y;
  }
}

/// Headings of steps are a gyroscope's, pulled to the compass: what turns that, turns them some seconds later. In a
/// lift and on stairs nobody surveyed: there it is as much as elsewhere, to any side.
void BeaconFilter::follow_compass(Particle& p, double dt_s) {
  if (!knows_compass()) return;
  const double follows = -std::expm1(-options_.compass_gain_per_s * dt_s);
  if (p.way >= 0) {
    const double sd_rad = field_->usual_deviation_rad() * std::sqrt(follows * (2.0 - follows));
    p.deviation_rad += static_cast<float>(sd_rad * random_.normal() - follows * p.deviation_rad);
    p.deviation_rad_s = 0.0f;
    return;
  }
  const double there_rad = field_->compass_deviation_rad(p.level_index, p.x_m, p.y_m);
  const double off_rad = std::remainder(there_rad - p.deviation_rad, 2.0 * std::numbers::pi);
  p.deviation_rad_s += static_cast<float>(options_.drift_gain_per_s2 * dt_s * off_rad);
  p.deviation_rad += static_cast<float>(follows * off_rad + dt_s * p.deviation_rad_s);
}

/// The mean of n seconds in one place errs less than one of them, by what differs from second to second: the n-th one
/// adds less and less.
double BeaconFilter::weight_of_second(double moved) {
  still_s_ = moved >= 0.5 ? 0.0 : still_s_ + 1.0;
  const double still = std::max(options_.still_temper, 1.0 / (1.0 + still_s_));
  return options_.temper * (still + (1.0 - still) * moved);
}

/// Of one who is there now and since then went as the steps say.
double BeaconFilter::log_likelihood(const Particle& p, const Second& second, const Walked& since, double weight) const {
  const double gain = p.step_gain * share_of_steps(p);
  const double c = gain * std::cos(p.turned_rad()), s = gain * std::sin(p.turned_rad());
  const double x = p.x_m - (c * since.east_m - s * since.north_m), y = p.y_m - (s * since.east_m + c * since.north_m);
  if (p.way >= 0) return log_likelihood_on_way(p, x, y, second, weight);
  const double offset_db = p.offset_db - p.loss_db;
  return weight * field_->log_likelihood(field_->at(p.level_index, x, y), second, offset_db, options_.silence);
}

/// Readings of a second come while one walks on: they are those of the place where one was on the average.
BeaconFilter::Walked BeaconFilter::walked_since_heard() {
  double count = 0.0;
  for (const auto& [beacon, reading] : readings_) count += reading.second;
  const Walked all = std::exchange(walked_, {}), sum = std::exchange(heard_at_, {});
  return count == 0.0 ? all : Walked{all.east_m - sum.east_m / count, all.north_m - sum.north_m / count};
}

BeaconFilter::Particle BeaconFilter::anywhere() {
  const Place& place = places_[std::min(
      places_.size() - 1, static_cast<std::size_t>(random_.uniform() * static_cast<double>(places_.size())))];
  // Not through a wall: nobody comes back from there.
  const double x = place.x_m + field_->cell_m() * (random_.uniform() - 0.5),
               y = place.y_m + field_->cell_m() * (random_.uniform() - 0.5);
  const int level = field_->levels()[place.level_index].level;
  const bool blocked = options_.walls && plan_->wall_between(level, place.x_m, place.y_m, x, y);
  const double bias_sd_rad = knows_compass() ? options_.held_sd_rad : options_.heading_bias_sd_rad;
  Particle p{blocked ? place.x_m : x,
             blocked ? place.y_m : y,
             options_.heading_bias ? bias_sd_rad * random_.normal() : 0.0,
             1.0 + options_.step_gain_sd * random_.normal(),
             offset_sd_db_ * random_.normal(),
             place.level_index,
             1.0};
  if (knows_compass()) p.deviation_rad = static_cast<float>(field_->compass_deviation_rad(p.level_index, p.x_m, p.y_m));
  if (!options_.walls) return p;
  if (auto stairs = stairs_at(p.level_index, p.x_m, p.y_m)) {
    const auto back = ways_[stairs->way].back;
    if (back && random_.uniform() < 0.5) *stairs = {*back, 1.0 - stairs->share};
    put_on(p, *stairs);
  }
  return p;
}

void BeaconFilter::use_second(double dt_s) {
  Second second;
  const Walked since = walked_since_heard();
  for (const auto& [beacon, reading] : readings_) {
    second.push_back({beacon, static_cast<float>(reading.first / reading.second)});
  }
  readings_.clear();
  if (places_.empty()) return;
  // A second in which nothing was heard may be one in which nobody listened; but walls tell particles apart all the
  // time.
  if (second.empty()) return keep_all_alike();
  const Time unheard = *now_ - heard_.value_or(*now_);
  heard_ = now_;
  if (unheard > kLongestUnheard) {
    forget();
  } else if (unheard > kTrustsSteps) {
    widen(lost_m(unheard));
  }
  if (steps_ && !has_stepped_ && first_seconds_ < kFirstSeconds) return start_again(second);
  if (particles_.empty()) return start(second);
  const double moved = steps_ ? std::min(1.0, std::exchange(walked_m_, 0.0) / kNewPlace_m) : 1.0;
  const double weight = weight_of_second(moved);
  for (Particle& p : particles_) {
    p.weight = std::log(std::max(p.weight, 1e-300)) + log_likelihood(p, second, since, weight);
    if (p.way < 0) p.loss_db = 0.0f;
  }
  const double log_evidence = normalise();
  // Who stands hears the same again; and a lift's cabin is like nothing on any level.
  if (still_s_ <= kNewFor_s && !is_in_lift()) past_.push_back({std::move(second), weight, log_evidence, since});
  if (past_.size() > kPastSeconds) past_.pop_front();
  jump_or_resample(dt_s * moved);
}

/// As if nothing had ever been heard.
void BeaconFilter::forget() {
  particles_.clear();
  past_.clear();
  first_.clear();
  first_seconds_ = 0;
  has_stepped_ = false;
  still_s_ = walked_m_ = 0.0;
}

/// Where nothing was heard for a while one may be as far from where steps and walls led as was told meanwhile: what is
/// heard now is to find particles there, and what was heard before no longer speaks against them.
void BeaconFilter::widen(double sd_m) {
  past_.clear();
  for (Particle& p : particles_) {
    const double x = p.x_m + sd_m * random_.normal(), y = p.y_m + sd_m * random_.normal();
    const int level = field_->levels()[p.level_index].level;
    const bool is_out = options_.walls && (!plan_->may_be_at(level, x, y) || plan_->is_closed(level, x, y) ||
                                           stairs_at(p.level_index, x, y));
    if (p.way >= 0 || is_out) continue;
    p.x_m = x;
    p.y_m = y;
  }
}

/// With weights that differ too much few particles stand for the doubt, and in the end one.
void BeaconFilter::keep_all_alike() {
  double sum = 0.0, squares = 0.0;
  for (const Particle& p : particles_) sum += p.weight, squares += p.weight * p.weight;
  if (sum * sum > 0.5 * static_cast<double>(options_.particles) * squares) return;
  scratch_.clear();
  resample(options_.particles, scratch_);
  particles_.swap(scratch_);
}

double BeaconFilter::log_likelihood_of_past(const Particle& p) const {
  double sum = 0.0;
  for (const Past& past : past_) sum += log_likelihood(p, past.second, past.since, past.weight);
  return sum;
}

/// Turns weights from logarithms into shares; answers the logarithm of their sum.
double BeaconFilter::normalise() {
  double largest = particles_.front().weight, sum = 0.0;
  for (const Particle& p : particles_) largest = std::max(largest, p.weight);
  for (Particle& p : particles_) sum += p.weight = std::exp(p.weight - largest);
  for (Particle& p : particles_) p.weight /= sum;
  return largest + std::log(sum);
}

/// All that is heard before the first step is one measurement, of one place, and gets better with each second: places
/// that fit the mean are drawn anew, so that none dies out by chance.
void BeaconFilter::start_again(const Second& second) {
  ++first_seconds_;
  for (const Heard& heard : second) {
    auto& [sum, seconds] = first_[heard.beacon];
    sum += heard.rssi_dbm;
    ++seconds;
  }
  const bool tells_more = (first_seconds_ & (first_seconds_ - 1)) == 0;
  if (!tells_more) return;
  Second mean;
  for (const auto& [beacon, heard] : first_) {
    if (2 * heard.second >= first_seconds_) mean.push_back({beacon, static_cast<float>(heard.first / heard.second)});
  }
  if (!mean.empty()) start(mean);
}

void BeaconFilter::start(const Second& second) {
  particles_.clear();
  for (std::size_t i = 0; i < kFirstDraws * options_.particles; ++i) {
    Particle p = anywhere();
    p.weight = log_likelihood(p, second, {}, options_.temper);
    particles_.push_back(p);
  }
  normalise();
  scratch_.clear();
  resample(options_.particles, scratch_);
  particles_.swap(scratch_);
}

/// One second says little: whether the walker is elsewhere is judged by the last ones together. Nobody is carried off
/// unseen while they stand: what is heard in a lift is like nothing on any level, and they are still there.
void BeaconFilter::jump_or_resample(double moved_s) {
  std::vector<Particle> elsewhere;
  double largest = -1e300, log_evidence = 0.0;
  for (const Past& past : past_) log_evidence += past.log_evidence;
  for (std::size_t i = 0; i < kJumpDraws; ++i) {
    elsewhere.push_back(anywhere());
    largest = std::max(largest, elsewhere.back().weight = log_likelihood_of_past(elsewhere.back()));
  }
  double sum = 0.0;
  for (Particle& p : elsewhere) sum += p.weight = std::exp(p.weight - largest);
  const double believed = (steps_ ? options_.jump_rate_per_s : options_.free_jump_rate_per_s) * moved_s;
  const double log_odds = std::log(believed) + largest + std::log(sum / static_cast<double>(kJumpDraws)) -
                          std::log1p(-believed) - log_evidence;
  const double odds = std::exp(std::min(50.0, log_odds));
  const double expected = static_cast<double>(options_.particles) * odds / (1.0 + odds);
  const auto jumps = std::min(options_.particles, static_cast<std::size_t>(expected + random_.uniform()));

  double squares = 0.0;
  for (const Particle& p : particles_) squares += p.weight * p.weight;
  if (jumps == 0 && 1.0 / squares > 0.5 * static_cast<double>(options_.particles)) return;
  scratch_.clear();
  resample(options_.particles - jumps, scratch_);
  for (std::size_t i = 0; i < jumps; ++i) {
    double wanted = random_.uniform() * sum;
    std::size_t chosen = 0;
    while (chosen + 1 < elsewhere.size() && (wanted -= elsewhere[chosen].weight) > 0.0) ++chosen;
    scratch_.push_back(elsewhere[chosen]);
    scratch_.back().weight = 1.0 / static_cast<double>(options_.particles);
  }
  particles_.swap(scratch_);
  if (2 * jumps > options_.particles) past_.clear();  // they were judged by it already
}

void BeaconFilter::resample(std::size_t count, std::vector<Particle>& into) {
  if (count == 0) return;
  double total = 0.0;
  for (const Particle& p : particles_) total += p.weight;
  const double stride = total / static_cast<double>(count);
  double wanted = random_.uniform() * stride, reached = 0.0;
  for (const Particle& p : particles_) {
    reached += p.weight;
    for (; wanted < reached && into.size() < count; wanted += stride) into.push_back(p);
  }
  while (into.size() < count) into.push_back(particles_.back());
  for (Particle& p : into) p.weight = 1.0 / static_cast<double>(options_.particles);
}

std::size_t BeaconFilter::best_level(double& weight) const {
  std::vector<double> weights(field_->levels().size(), 0.0);
  for (const Particle& p : particles_) weights[p.level_index] += p.weight;
  const auto best = std::max_element(weights.begin(), weights.end());
  weight = *best;
  return static_cast<std::size_t>(best - weights.begin());
}

/// The mean of particles on several ways lies on none of them.
Eigen::Vector2d BeaconFilter::densest_place(std::size_t level_index) const {
  const auto cell = [](double m) { return static_cast<std::int64_t>(std::floor(m / kDensityCell_m)); };
  std::map<std::pair<std::int64_t, std::int64_t>, double> density;
  for (const Particle& p : particles_) {
    if (p.level_index != level_index) continue;
    for (std::int64_t dx = -1; dx <= 1; ++dx) {
      for (std::int64_t dy = -1; dy <= 1; ++dy)
        density[{cell(p.x_m) + dx, cell(p.y_m) + dy}] += (dx == 0 && dy == 0 ? 2.0 : 1.0) * p.weight;
    }
  }
  const auto densest = std::max_element(density.begin(), density.end(),
                                        [](const auto& a, const auto& b) { return a.second < b.second; });
  return kDensityCell_m * Eigen::Vector2d(static_cast<double>(densest->first.first) + 0.5,
                                          static_cast<double>(densest->first.second) + 0.5);
}

Estimate BeaconFilter::estimate() const {
  Estimate result;
  if (particles_.empty()) return result;
  double on_level = 0.0;
  const std::size_t best = best_level(on_level);
  if (!(on_level > 0.0)) return result;
  result.level = field_->levels()[best].level;
  const Eigen::Vector2d densest = densest_place(best);
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  double all = 0.0, of_mode = 0.0, bias_squares = 0.0;
  for (const Particle& p : particles_) {
    all += p.weight;
    result.rssi_offset_db += p.weight * p.offset_db;
    result.heading_bias_rad += p.weight * p.turned_rad();
    bias_squares += p.weight * p.turned_rad() * p.turned_rad();
    const double levels_off = field_->levels()[p.level_index].level - result.level;
    result.level_variance += p.weight * levels_off * levels_off;
    const Eigen::Vector2d at(p.x_m, p.y_m);
    if (p.level_index != best || (at - densest).norm() > kMode_m) continue;
    of_mode += p.weight;
    mean += p.weight * at;
  }
  if (!(of_mode > 0.0)) return result;
  mean /= of_mode;
  result.rssi_offset_db /= all;
  result.heading_bias_rad /= all;
  result.level_variance /= all;
  result.heading_bias_variance = std::max(0.0, bias_squares / all - result.heading_bias_rad * result.heading_bias_rad);
  for (const Particle& p : particles_) {
    if (p.level_index != best) continue;
    const Eigen::Vector2d d = Eigen::Vector2d(p.x_m, p.y_m) - mean;
    result.spread += p.weight / on_level * d * d.transpose();
  }
  result.covariance =
      accuracy_.factor() * result.spread + accuracy_.floor() * accuracy_.floor() * Eigen::Matrix2d::Identity();
  const Time unheard = *now_ - *heard_;
  result.covariance += std::pow(lost_m(unheard), 2) * Eigen::Matrix2d::Identity();
  result.x_m = mean.x();
  result.y_m = mean.y();
  const bool wide = result.spread.trace() > kWidestSpread_m * kWidestSpread_m && of_mode < kLeastOfMode * all;
  result.validity = wide ? Validity::Ambiguous : Validity::Valid;
  if (unheard > kLongestUnheard) result.validity = Validity::Unheard;
  return result;
}

}  // namespace fiona::beacons
