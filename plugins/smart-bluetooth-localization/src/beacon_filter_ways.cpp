// Of BeaconFilter: stairs and lifts. On stairs steps lead along them, whatever the compass says; in a lift nobody
// walks, and its cabin holds signals off.
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "beacon_filter.hpp"

namespace fiona::beacons {
namespace {

constexpr double kBefore_m = 2.0;     // of stairs or a lift: who is there may take it
constexpr double kAlong_rad = 1.0;    // who walks in such a direction walks along stairs
constexpr double kTread_m = 0.1;      // of stairs, over which their direction is taken
constexpr double kHalfWidth_m = 0.5;  // of stairs: DIN 18065 asks for a metre in public buildings
constexpr double kFoot_m = 0.5;       // of stairs, over which one may walk as on the level
constexpr double kUnder = 0.6;        // of stairs, below which nobody stands upright
/// Of a second: how fast lifts go, in levels, and people on stairs, in metres.
constexpr double kSlowLift = 0.15, kFastLift = 0.5, kSlowOnStairs_mps = 0.3, kFastOnStairs_mps = 0.7;
constexpr double kEscalator_mps = 0.5;  // EN 115-1: the usual nominal speed
/// Steps on stairs are shorter than they seem by their swing.
constexpr double kLeastOfStep = 0.4, kMostOfStep = 1.0;
constexpr float kNearlyThere = 0.7f;
/// What a person feels of a lift errs by so much, and this share of the way; and no stop is further from where it went.
constexpr double kRiseSd_m = 0.5, kRiseSdPart = 0.1, kOtherStop_m = 2.0;
/// Who is on stairs looks where they lead, and is where they are taken to be, but for so much.
constexpr double kOnStairsSd_rad = 0.4, kOnStairsSd_m = 1.0;
constexpr int kTurnsTried = 4;  // ahead and behind
constexpr double kTurnTried_m = 0.6;
constexpr double kOtherWay = 0.3;  // what remains of a particle's weight that walks otherwise than its stairs lead
constexpr double kLeastFit = 0.03;

double between(double low, double high, double share) { return low + share * (high - low); }

/// By how much a heading differs from where the way leads there; nothing at its end.
std::optional<double> off_heading_rad(const FloorPlan::Way& way, double share, double heading_rad) {
  const FloorPlan::Way::Place from = way.at(share), to = way.at(std::min(1.0, share + kTread_m / way.length_m()));
  if (to.on_m <= from.on_m) return std::nullopt;
  return std::remainder(heading_rad - std::atan2(to.y_m - from.y_m, to.x_m - from.x_m), 2.0 * std::numbers::pi);
}

bool leads(const FloorPlan::Way& way, double share, double heading_rad) {
  const auto off_rad = off_heading_rad(way, share, heading_rad);
  return off_rad && std::abs(*off_rad) <= kAlong_rad;
}

}  // namespace

void BeaconFilter::find_ways() {
  ways_.clear();
  const auto levels = field_->levels();
  const auto index_of = [&](int level) {
    return static_cast<std::uint32_t>(
        std::find_if(levels.begin(), levels.end(), [&](const auto& one) { return one.level == level; }) -
        levels.begin());
  };
  for (const FloorPlan::Way& way : plan_->ways()) {
    Way one{&way, index_of(way.from_level), index_of(way.to_level), std::nullopt, 1e300, 1e300, -1e300, -1e300};
    if (one.from_index >= levels.size() || one.to_index >= levels.size()) continue;
    for (const FloorPlan::Way::Place& place : way.path) {
      one.low_x_m = std::min(one.low_x_m, place.x_m - kHalfWidth_m);
      one.low_y_m = std::min(one.low_y_m, place.y_m - kHalfWidth_m);
      one.high_x_m = std::max(one.high_x_m, place.x_m + kHalfWidth_m);
      one.high_y_m = std::max(one.high_y_m, place.y_m + kHalfWidth_m);
    }
    for (std::size_t i = 0; i < ways_.size(); ++i) {
      const FloorPlan::Way::Place &front = ways_[i].path->path.front(), &back = way.path.back();
      if (ways_[i].to_index != one.from_index || ways_[i].from_index != one.to_index) continue;
      if (std::hypot(front.x_m - back.x_m, front.y_m - back.y_m) > kTread_m) continue;
      one.back = i;
      ways_[i].back = ways_.size();
    }
    ways_.push_back(one);
  }
  for (Particle& p : particles_) p.way = -1, p.loss_db = 0.0f;
}

bool BeaconFilter::is_before(const Particle& p, std::size_t way) const {
  if (ways_[way].from_index != p.level_index) return false;
  const FloorPlan::Way::Place& from = ways_[way].path->path.front();
  return std::hypot(p.x_m - from.x_m, p.y_m - from.y_m) < kBefore_m;
}

/// As far as it is known.
bool BeaconFilter::is_in_lift() const {
  double share = 0.0;
  for (const Particle& p : particles_) share += p.way >= 0 && ways_[p.way].path->is_lift() ? p.weight : 0.0;
  return share > 0.5;
}

/// Who is in a lift is on the level that it has carried them to; who is not was carried nowhere.
void BeaconFilter::carry(Particle& p, double rise_m) {
  const auto levels = field_->levels();
  const auto off_m = [&](std::uint32_t index) {
    const auto risen_m = plan_->rise_m(levels[p.stood_index].level, levels[index].level);
    return risen_m ? std::optional(std::abs(*risen_m - rise_m)) : std::nullopt;
  };
  if (p.way >= 0 && ways_[p.way].path->is_lift()) {
    const FloorPlan::Way::Place cabin = ways_[p.way].path->path.front();
    double least_m = kOtherStop_m;
    for (std::size_t i = 0; i < ways_.size(); ++i) {
      const FloorPlan::Way::Place& stop = ways_[i].path->path.front();
      const auto stop_off_m = off_m(ways_[i].from_index);
      const bool same_lift =
          ways_[i].path->is_lift() && std::hypot(stop.x_m - cabin.x_m, stop.y_m - cabin.y_m) < kBefore_m;
      if (!same_lift || !stop_off_m || *stop_off_m >= least_m) continue;
      least_m = *stop_off_m;
      p.way = static_cast<std::int32_t>(i);
      p.share = p.pace = 0.0f;
      p.level_index = ways_[i].from_index;
    }
  }
  const auto rest_m = off_m(p.level_index);
  if (!rest_m) return;
  const double off = *rest_m / (kRiseSd_m + kRiseSdPart * std::abs(rise_m));
  p.weight *= std::max(options_.not_felt, std::exp(-0.5 * off * off));
}

/// Who stands takes a lift, or is carried on by an escalator; whose steps are not known takes stairs as well.
void BeaconFilter::take_ways(double dt_s) {
  const double enters = -std::expm1(-options_.way_rate_per_s * dt_s);
  const bool stands = !steps_ || walked_m_ == 0.0;
  for (Particle& p : particles_) {
    const bool rides = p.way >= 0 && (!steps_ || ways_[p.way].path->is_lift() || ways_[p.way].path->conveys);
    if (rides) ride(p, dt_s);
    for (std::size_t i = 0; stands && p.way < 0 && i < ways_.size(); ++i) {
      const bool may = (!steps_ || ways_[i].path->is_lift()) && is_before(p, i);
      if (may && random_.uniform() < enters) enter(p, i);
    }
  }
}

void BeaconFilter::enter(Particle& p, std::size_t number) {
  const FloorPlan::Way& way = *ways_[number].path;
  const double share = random_.uniform();
  p.way = static_cast<std::int32_t>(number);
  p.share = p.pace = p.loss_db = 0.0f;
  if (way.is_lift()) {
    p.loss_db = static_cast<float>(options_.most_cabin_loss_db * share);
  } else {
    const double metres =
        steps_ ? between(kLeastOfStep, kMostOfStep, share) : between(kSlowOnStairs_mps, kFastOnStairs_mps, share);
    p.pace = static_cast<float>(metres / way.length_m());
  }
  move_on_way(p, 0.0);
}

void BeaconFilter::ride(Particle& p, double dt_s) {
  if (ways_[p.way].path->is_lift() && p.pace == 0.0f) {
    if (random_.uniform() > -std::expm1(-options_.departure_rate_per_s * dt_s)) return;
    // Up or down: each of them as likely.
    std::size_t found = 0;
    std::int32_t taken = p.way;
    for (std::size_t i = 0; i < ways_.size(); ++i) {
      const bool from_here = ways_[i].path->is_lift() && is_before(p, i);
      if (from_here && random_.uniform() * static_cast<double>(++found) < 1.0) taken = static_cast<std::int32_t>(i);
    }
    p.way = taken;
    const double levels = std::abs(ways_[taken].path->to_level - ways_[taken].path->from_level);
    p.pace = static_cast<float>(between(kSlowLift, kFastLift, random_.uniform()) / levels);
  }
  const FloorPlan::Way& way = *ways_[p.way].path;
  const bool stands = steps_ && !way.is_lift();  // then the pace is that of steps
  move_on_way(p, dt_s * (stands ? kEscalator_mps / way.length_m() : p.pace));
}

/// At its end one is on the level; in a lift it may go on as it went, or wait.
void BeaconFilter::move_on_way(Particle& p, double share) {
  const Way& way = ways_[p.way];
  p.share = static_cast<float>(std::min(1.0, p.share + share));
  const FloorPlan::Way::Place place = way.path->at(p.share);
  p.x_m = place.x_m;
  p.y_m = place.y_m;
  p.level_index = p.share < 0.5f ? way.from_index : way.to_index;
  if (p.share < 1.0f) return;
  p.way = -1;
  const bool up = way.path->to_level > way.path->from_level;
  for (std::size_t i = 0; way.path->is_lift() && i < ways_.size(); ++i) {
    if (!ways_[i].path->is_lift() || !is_before(p, i)) continue;
    p.way = static_cast<std::int32_t>(i);
    p.share = 0.0f;
    if (up == ways_[i].path->to_level > ways_[i].path->from_level && random_.uniform() < 0.5) return;
    p.pace = 0.0f;
  }
  if (p.way < 0) p.loss_db = 0.0f;
}

void BeaconFilter::step_out_of_lift(Particle& p) {
  if (p.pace > 0.0f && p.share < kNearlyThere) {  // between two levels nobody walks
    p.weight *= options_.through_wall;
    return;
  }
  // Some of what is heard in this second was heard in the cabin, nobody knows how much.
  const auto loss_db = static_cast<float>(p.loss_db * random_.uniform());
  if (p.pace > 0.0f) move_on_way(p, 1.0);
  p.way = -1;
  p.loss_db = loss_db;
}

/// A turn tells where on the stairs one is, and so how long the steps are; their direction tells how much a compass
/// errs. Answers how well the step fits.
double BeaconFilter::step_on_stairs(Particle& p, double length_m, double heading_rad) {
  const FloorPlan::Way& way = *ways_[p.way].path;
  double best = 0.0, best_share = p.share;
  for (int i = -kTurnsTried; i <= kTurnsTried; ++i) {
    const double off_m = i * kTurnTried_m, share = p.share + off_m / way.length_m();
    const auto off_rad = share < 0.0 || share > 1.0 ? std::nullopt : off_heading_rad(way, share, heading_rad);
    if (!off_rad || std::abs(*off_rad) > kAlong_rad) continue;
    const double turned = *off_rad / kOnStairsSd_rad, moved = off_m / kOnStairsSd_m;
    const double fit = std::exp(-0.5 * (turned * turned + moved * moved));
    if (fit > best) best = fit, best_share = share;
  }
  if (best == 0.0) p.weight *= kOtherWay;
  if (p.share * way.length_m() > kTurnTried_m) {
    const double pace = p.pace * best_share / p.share * way.length_m();
    p.pace = static_cast<float>(std::clamp(pace, kLeastOfStep, kMostOfStep) / way.length_m());
  }
  p.share = static_cast<float>(best_share);
  move_on_way(p, p.pace * length_m);
  return std::max(best, kLeastFit);
}

/// How well a step fits says where on stairs one is, and not whether one is on any.
void BeaconFilter::step_on_ways(const StepInput& step) {
  double before = 0.0, after = 0.0;
  for (const auto& [number, heading_rad] : on_ways_) {
    Particle& p = particles_[number];
    if (ways_[p.way].path->is_lift()) {
      step_out_of_lift(p);
      continue;
    }
    const double fit = step_on_stairs(p, step.length_m, heading_rad);
    before += p.weight;
    after += p.weight *= fit;
    on_stairs_.push_back(number);
  }
  if (!(after > 0.0)) return;  // nothing was heard for thousands of steps
  for (const std::size_t number : on_stairs_) particles_[number].weight *= before / after;
}

/// On a step to (x, y).
bool BeaconFilter::take_stairs(Particle& p, double heading_rad, double x_m, double y_m) {
  const auto stairs = stairs_at(p.level_index, x_m, y_m);
  if (stairs && leads(*ways_[stairs->way].path, stairs->share, heading_rad)) {
    put_on(p, *stairs);
    return true;
  }
  for (std::size_t i = 0; i < ways_.size(); ++i) {
    const FloorPlan::Way& way = *ways_[i].path;
    if (way.is_lift() || !is_before(p, i) || !leads(way, 0.0, heading_rad)) continue;
    if (random_.uniform() > options_.way_rate_per_step) continue;
    const FloorPlan::Way::Place &from = way.path[0], &to = way.path[1];
    const double on_m = ((p.x_m - from.x_m) * (to.x_m - from.x_m) + (p.y_m - from.y_m) * (to.y_m - from.y_m)) /
                        std::max(kTread_m, to.on_m);
    enter(p, i);
    move_on_way(p, std::clamp(on_m / way.length_m(), 0.0, 0.9));
    return true;
  }
  return false;
}

/// Where stairs rise from a level, or go down from it, and nobody is on the level itself.
std::optional<BeaconFilter::OnStairs> BeaconFilter::stairs_at(std::uint32_t level_index, double x_m, double y_m) const {
  for (std::size_t i = 0; i < ways_.size(); ++i) {
    const Way& way = ways_[i];
    if (way.from_index != level_index || x_m < way.low_x_m || x_m > way.high_x_m || y_m < way.low_y_m ||
        y_m > way.high_y_m || way.path->is_lift()) {
      continue;
    }
    for (std::size_t j = 1; j < way.path->path.size(); ++j) {
      const FloorPlan::Way::Place &from = way.path->path[j - 1], &to = way.path->path[j];
      const double length = std::max(kTread_m, to.on_m - from.on_m);
      const double east = (to.x_m - from.x_m) / length, north = (to.y_m - from.y_m) / length;
      const double along = (x_m - from.x_m) * east + (y_m - from.y_m) * north;
      const double beside = (y_m - from.y_m) * east - (x_m - from.x_m) * north;
      if (along < 0.0 || along > length || std::abs(beside) > kHalfWidth_m) continue;
      const double on_m = from.on_m + along;
      if (on_m >= kFoot_m && on_m <= kUnder * way.path->length_m()) return OnStairs{i, on_m / way.path->length_m()};
    }
  }
  return std::nullopt;
}

void BeaconFilter::put_on(Particle& p, OnStairs stairs) {
  enter(p, stairs.way);
  move_on_way(p, stairs.share);
}

/// Of the length that steps seem to have, what they lead on by where the particle is.
double BeaconFilter::share_of_steps(const Particle& p) const {
  const bool on_stairs = steps_ && p.way >= 0 && !ways_[p.way].path->is_lift();
  return on_stairs ? p.pace * ways_[p.way].path->length_m() : 1.0;
}

/// Between two levels it is heard what is on the one or what is on the other: where the slab is, no plan tells.
double BeaconFilter::log_likelihood_on_way(const Particle& p, double x_m, double y_m, const Second& second,
                                           double weight) const {
  const double offset_db = p.offset_db - p.loss_db;
  const auto as_on = [&](std::uint32_t level_index) {
    return weight * field_->log_likelihood(field_->at(level_index, x_m, y_m), second, offset_db, options_.silence);
  };
  const double from = as_on(ways_[p.way].from_index);
  if (p.share == 0.0f) return from;
  const double to = as_on(ways_[p.way].to_index), more = std::max(from, to);
  return more + std::log((1.0 - p.share) * std::exp(from - more) + p.share * std::exp(to - more));
}

}  // namespace fiona::beacons
