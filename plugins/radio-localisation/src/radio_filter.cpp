#include "radio_filter.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace fiona::radio {
namespace {

constexpr Time kSweepSettles{60};     // rows of one sweep are told within this time
constexpr Time kBeaconsGather{1000};  // beacons send all the time: a second of them is used at once
constexpr Time kSlice{1000};          // rows heard within it are judged at one place
constexpr double kRowMemory = 300.0;  // rows over which the share of known transmitters is taken
constexpr double kLeastRows = 20.0;
constexpr double kForeignShare = 0.08;
constexpr double kWidestSpread_m = 17.0;  // of the particles; beyond it an estimate guides nobody
constexpr double kOffsetNoise_db2 = 9.0;
constexpr double kOffsetDrift_db2 = 0.02;

std::size_t index_of_largest(const std::vector<double>& values) {
  return static_cast<std::size_t>(std::max_element(values.begin(), values.end()) - values.begin());
}

}  // namespace

RadioFilter::RadioFilter(std::shared_ptr<const RadioMap> map, const FilterOptions& options)
    : map_(std::move(map)),
      options_(options),
      likelihood_(*map_, options.likelihood),
      levels_(map_->levels.size()),
      random_(options.seed) {}

void RadioFilter::step(const StepInput& step) {
  past_steps_.push_back(
      {step.time, step.length_m * std::cos(step.heading_rad), step.length_m * std::sin(step.heading_rad)});
  const double keep = std::exp(-step.length_m / options_.map_error_reach_m);
  const double renew = options_.map_error_sd_m * std::sqrt(1.0 - keep * keep);
  for (Particle& p : particles_) {
    p.map_error_x_m = keep * p.map_error_x_m + renew * random_.normal();
    p.map_error_y_m = keep * p.map_error_y_m + renew * random_.normal();
    p.heading_bias_rad += options_.heading_drift_rad * random_.normal();
    p.step_gain += options_.step_gain_drift * random_.normal();
    const double length = p.step_gain * step.length_m + step.length_sd_m * random_.normal();
    const double heading = step.heading_rad + p.heading_bias_rad + 0.5 * step.heading_sd_rad * random_.normal();
    p.x_m += length * std::cos(heading);
    p.y_m += length * std::sin(heading);
  }
}

void RadioFilter::signal(Time time, const SignalInput& signal) {
  if (pending_since_ && time > last_told_ + kSweepSettles && signal.radio == Radio::WiFi) use_pending();
  if (time - signal.heard > kOldestRow || !std::isfinite(signal.rssi_dbm)) return;
  const Time heard = std::min(time, signal.heard + options_.stamp_lag);
  const auto number = map_->find(signal.id);
  const double keep = std::exp(-1.0 / kRowMemory);
  all_rows_ = keep * all_rows_ + 1.0;
  known_rows_ = keep * known_rows_ + (number ? 1.0 : 0.0);
  if (!number) return;
  const auto [last, is_new] = last_heard_.try_emplace(*number, heard);
  if (!is_new && last->second >= heard && map_->transmitters[*number].radio == Radio::WiFi) return;
  last->second = heard;
  if (!pending_since_) pending_since_ = time;
  if (signal.radio == Radio::WiFi) last_told_ = time;
  pending_.push_back({{*number, static_cast<float>(signal.rssi_dbm), 1.0f}, heard});
}

void RadioFilter::advance(Time now) {
  if (now_ && now <= *now_) return;
  const double dt_s = now_ ? std::chrono::duration<double>(now - *now_).count() : 0.0;
  now_ = now;
  diffuse(std::min(dt_s, 60.0));
  const bool sweep_done = last_told_ != Time{} && now > last_told_ + kSweepSettles;
  if (pending_since_ && (sweep_done || now - *pending_since_ >= kBeaconsGather)) use_pending();
  forget_old(now);
}

void RadioFilter::diffuse(double dt_s) {
  const double sd = (steps_expected_ ? options_.still_diffusion_m : options_.free_diffusion_m) * std::sqrt(dt_s);
  if (sd == 0.0) return;
  for (Particle& p : particles_) {
    p.x_m += sd * random_.normal();
    p.y_m += sd * random_.normal();
  }
}

void RadioFilter::forget_old(Time now) {
  while (!past_steps_.empty() && now - past_steps_.front().time > kOldestRow) past_steps_.pop_front();
  std::erase_if(last_heard_, [&](const auto& entry) { return now - entry.second > 6 * kOldestRow; });
}

Eigen::Vector2d RadioFilter::moved_since(Time since) const {
  Eigen::Vector2d moved = Eigen::Vector2d::Zero();
  for (auto past = past_steps_.rbegin(); past != past_steps_.rend() && past->time > since; ++past) {
    moved += Eigen::Vector2d(past->east_m, past->north_m);
  }
  return moved;
}

std::vector<RadioFilter::Slice> RadioFilter::slices() {
  std::map<std::int64_t, Slice> by_time;
  std::map<std::pair<std::int64_t, std::uint32_t>, std::pair<double, int>> rows;
  for (const Pending& pending : pending_) {
    auto& [sum, count] = rows[{pending.heard / kSlice, pending.row.transmitter}];
    sum += pending.row.rssi_dbm;
    ++count;
  }
  for (const auto& [key, rssi] : rows) {
    Slice& slice = by_time[key.first];
    slice.heard = kSlice * key.first + kSlice / 2;
    slice.rows.push_back({key.second, static_cast<float>(rssi.first / rssi.second), 1.0f});
  }
  std::vector<Slice> result;
  for (auto& [time, slice] : by_time) {
    slice.field.assign(map_->cells.size(), 0.0f);
    likelihood_.add_rows(slice.rows, offset_db_, slice.field);
    result.push_back(std::move(slice));
  }
  return result;
}

void RadioFilter::use_pending() {
  std::vector<Slice> slices = this->slices();
  const bool wifi = std::any_of(pending_.begin(), pending_.end(), [&](const Pending& pending) {
    return map_->transmitters[pending.row.transmitter].radio == Radio::WiFi;
  });
  pending_.clear();
  pending_since_.reset();
  last_told_ = Time{};
  if (slices.empty()) return;
  if (wifi) likelihood_.add_silence(slices.back().field);

  const Time now = now_.value_or(slices.back().heard);
  const double dt_s = std::clamp(last_use_ ? std::chrono::duration<double>(now - *last_use_).count() : 2.0, 0.0, 10.0);
  last_use_ = now;
  std::size_t rows = 0;
  for (const Slice& slice : slices) rows += slice.rows.size();
  const auto temper = static_cast<float>(options_.temper / std::sqrt(static_cast<double>(rows)));
  std::vector<float> total(map_->cells.size(), 0.0f);
  for (Slice& slice : slices) {
    for (std::size_t cell = 0; cell < total.size(); ++cell) {
      slice.field[cell] *= temper;
      total[cell] += slice.field[cell];
    }
    double log_mean = 0.0;
    cumulated(slice.field, log_mean);
    slice.outside = static_cast<float>(log_mean);
  }
  follow_level(slices, total, temper, dt_s);
  if (particles_.empty()) {
    start(total);
  } else {
    weigh(slices, dt_s);
    double largest = particles_.front().weight;
    for (const Particle& p : particles_) largest = std::max(largest, p.weight);
    double sum = 0.0;
    for (Particle& p : particles_) sum += p.weight = std::exp(p.weight - largest);
    for (Particle& p : particles_) p.weight /= sum;
    jump_or_resample(total, largest + std::log(sum), dt_s);
  }
  learn_offset(slices);
}

void RadioFilter::weigh(const std::vector<Slice>& slices, double dt_s) {
  std::vector<Eigen::Vector2d> moved;
  for (const Slice& slice : slices) moved.push_back(moved_since(slice.heard));
  for (Particle& p : particles_) {
    double log_weight = std::log(std::max(p.weight, 1e-300));
    const double c = p.step_gain * std::cos(p.heading_bias_rad), s = p.step_gain * std::sin(p.heading_bias_rad);
    for (std::size_t i = 0; i < slices.size(); ++i) {
      const double x = p.x_m + p.map_error_x_m - (c * moved[i].x() - s * moved[i].y());
      const double y = p.y_m + p.map_error_y_m - (s * moved[i].x() + c * moved[i].y());
      log_weight += likelihood_.at(slices[i].field, p.level_index, x, y, slices[i].outside);
    }
    const std::int32_t cell = map_->cell_at(p.level_index, p.x_m, p.y_m);
    const double off_path = cell < 0 ? 5.0 : std::max(0.0, map_->cells[cell].path_distance_m - 0.5 * map_->cell_m);
    p.weight = log_weight - options_.path_prior * dt_s * off_path * off_path;
  }
}

std::vector<double> RadioFilter::cumulated(const std::vector<float>& total, double& log_mean) const {
  const float largest = *std::max_element(total.begin(), total.end());
  std::vector<double> result(total.size());
  double sum = 0.0;
  for (std::size_t cell = 0; cell < total.size(); ++cell) {
    result[cell] = sum += std::exp(static_cast<double>(total[cell] - largest));
  }
  log_mean = largest + std::log(sum / static_cast<double>(total.size()));
  return result;
}

RadioFilter::Particle RadioFilter::sample_from(const std::vector<double>& cumulated) {
  const double u = random_.uniform() * cumulated.back();
  const auto cell = static_cast<std::size_t>(
      std::min<std::ptrdiff_t>(std::upper_bound(cumulated.begin(), cumulated.end(), u) - cumulated.begin(),
                               static_cast<std::ptrdiff_t>(cumulated.size()) - 1));
  std::uint32_t level_index = 0;
  while (level_index + 1 < map_->levels.size() && map_->levels[level_index + 1].first_cell <= cell) ++level_index;
  const Cell& at = map_->cells[cell];
  const double error_x_m = options_.map_error_sd_m * random_.normal();
  const double error_y_m = options_.map_error_sd_m * random_.normal();
  return {at.x_m + map_->cell_m * (random_.uniform() - 0.5) - error_x_m,
          at.y_m + map_->cell_m * (random_.uniform() - 0.5) - error_y_m,
          options_.heading_bias_sd_rad * random_.normal(),
          1.0 + options_.step_gain_sd * random_.normal(),
          error_x_m,
          error_y_m,
          level_index,
          1.0 / static_cast<double>(options_.particles)};
}

void RadioFilter::start(const std::vector<float>& total) {
  double log_mean = 0.0;
  const auto sums = cumulated(total, log_mean);
  for (std::size_t i = 0; i < options_.particles; ++i) particles_.push_back(sample_from(sums));
}

void RadioFilter::jump_or_resample(const std::vector<float>& total, double log_weight_mean, double dt_s) {
  double log_mean = 0.0;
  const auto sums = cumulated(total, log_mean);
  const double believed = options_.jump_rate_per_s * dt_s;
  const double odds = std::exp(std::min(50.0, std::log(believed) + log_mean - std::log1p(-believed) - log_weight_mean));
  const double expected = static_cast<double>(options_.particles) * odds / (1.0 + odds);
  const auto jumps = std::min(options_.particles, static_cast<std::size_t>(expected + random_.uniform()));

  double squares = 0.0;
  for (const Particle& p : particles_) squares += p.weight * p.weight;
  if (jumps == 0 && 1.0 / squares > 0.5 * static_cast<double>(options_.particles)) return;
  scratch_.clear();
  resample(options_.particles - jumps, scratch_);
  for (std::size_t i = 0; i < jumps; ++i) scratch_.push_back(sample_from(sums));
  particles_.swap(scratch_);
}

void RadioFilter::resample(std::size_t count, std::vector<Particle>& into) {
  if (count == 0) return;
  const double stride = 1.0 / static_cast<double>(count);
  double wanted = random_.uniform() * stride;
  double reached = 0.0;
  for (const Particle& p : particles_) {
    reached += p.weight;
    while (wanted < reached && into.size() < count) {
      into.push_back(p);
      into.back().weight = 1.0 / static_cast<double>(options_.particles);
      wanted += stride;
    }
  }
  while (into.size() < count) into.push_back(into.empty() ? particles_.back() : into.back());
}

void RadioFilter::follow_level(const std::vector<Slice>& slices, const std::vector<float>& total, float temper,
                               double dt_s) {
  std::vector<double> excess(map_->levels.size(), 0.0);
  for (const Slice& slice : slices) likelihood_.add_excess(slice.rows, offset_db_, excess);
  std::vector<double> evidence = likelihood_.log_mean_by_level(total);
  for (std::size_t i = 0; i < evidence.size(); ++i) evidence[i] += temper * excess[i];
  levels_.observe(-std::expm1(-options_.jump_rate_per_s * dt_s), evidence);
}

void RadioFilter::learn_offset(const std::vector<Slice>& slices) {
  const Estimate at = estimate();
  if (!at.is_valid()) return;
  const auto level_index = index_of_largest(particles_by_level());
  double sum = 0.0, weights = 0.0;
  for (const Slice& slice : slices) {
    const Eigen::Vector2d moved = moved_since(slice.heard);
    const auto [mean, weight] =
        likelihood_.deviation_db(slice.rows, level_index, at.x_m - moved.x(), at.y_m - moved.y());
    sum += weight * mean;
    weights += weight;
  }
  if (weights < 5.0) return;
  offset_variance_ += kOffsetDrift_db2;
  const double gain = offset_variance_ / (offset_variance_ + kOffsetNoise_db2);
  offset_db_ += gain * (sum / weights - offset_db_);
  offset_variance_ *= 1.0 - gain;
}

std::vector<double> RadioFilter::particles_by_level() const {
  std::vector<double> result(map_->levels.size(), 0.0);
  for (const Particle& p : particles_) result[p.level_index] += p.weight;
  return result;
}

Estimate RadioFilter::estimate() const {
  Estimate result;
  result.time = now_.value_or(Time{});
  result.known_share = all_rows_ > 0.0 ? known_rows_ / all_rows_ : 0.0;
  if (all_rows_ >= kLeastRows && result.known_share < kForeignShare) {
    result.validity = Validity::ForeignBuilding;
    return result;
  }
  if (particles_.empty()) return result;

  result.level = map_->levels[levels_.best()].level;
  result.level_probability = levels_.probability()[levels_.best()];
  for (std::size_t i = 0; i < map_->levels.size(); ++i) {
    const double difference = map_->levels[i].level - result.level;
    result.level_variance += levels_.probability()[i] * difference * difference;
  }
  // Levels lie above each other: the position holds where the particles are on another level than the receiver.
  const auto on_level = particles_by_level();
  const std::size_t best = index_of_largest(on_level);
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Particle& p : particles_) {
    if (p.level_index == best) mean += p.weight / on_level[best] * Eigen::Vector2d(p.x_m, p.y_m);
  }
  for (const Particle& p : particles_) {
    if (p.level_index != best) continue;
    const Eigen::Vector2d d = Eigen::Vector2d(p.x_m, p.y_m) - mean;
    result.covariance += p.weight / on_level[best] * d * d.transpose();
  }
  const bool wide = result.covariance.trace() > kWidestSpread_m * kWidestSpread_m;
  const double floor_m2 = map_->accuracy.covariance_floor_m * map_->accuracy.covariance_floor_m;
  result.covariance = map_->accuracy.covariance_factor * result.covariance + floor_m2 * Eigen::Matrix2d::Identity();
  result.x_m = mean.x();
  result.y_m = mean.y();
  result.validity = wide ? Validity::Ambiguous : Validity::Valid;
  return result;
}

}  // namespace fiona::radio
