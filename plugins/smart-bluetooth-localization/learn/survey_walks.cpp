#include "survey_walks.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <map>
#include <optional>
#include <set>
#include <tuple>

#include "accuracy.hpp"

namespace fiona::beacons {
namespace {

constexpr Time kOutput{200};
constexpr Time kJudged{1000};
constexpr std::size_t kPlaceFolds = 5, kMostFixes = 500;
constexpr std::size_t kLeastFixes = 200;
constexpr double kSamePlace_m = 3.0;
constexpr Time kStepToldAfter{400};  // its middle
constexpr Time kBeside{600};         // of a step: how long before and behind it nobody may turn
constexpr double kLeastWay_m = 0.3, kStraight_rad = 0.15;

/// How many walks of a survey went by a place.
std::size_t walks_near(const std::vector<SurveySecond>& survey, const walk::WayPoint& at) {
  std::set<std::uint32_t> walks;
  for (const SurveySecond& second : survey) {
    const bool near = second.level == at.level && std::hypot(second.x_m - at.x_m, second.y_m - at.y_m) <= kSamePlace_m;
    if (near) walks.insert(second.walk);
  }
  return walks.size();
}

BeaconMap::Accuracy fitted(const std::vector<radio::LeftOutFix>& fixes) {
  BeaconMap::Accuracy accuracy = careful_accuracy();
  if (fixes.size() < kLeastFixes) return accuracy;
  const radio::Accuracy fit = radio::fit_accuracy(fixes);
  accuracy.set_factor(fit.covariance_factor);
  accuracy.set_floor(std::max(0.1, fit.covariance_floor_m));
  return accuracy;
}

/// Where a surveyor was then, and in which direction they walked; nothing while they stood or turned.
std::optional<std::pair<walk::WayPoint, double>> way_at(const radio::Journey& walk, Time time) {
  const auto position = [&](Time then) { return walk::position_at(walk.way_points, then.count()); };
  const auto before = position(time - kBeside), at = position(time), after = position(time + kBeside);
  if (!before || !at || !after || before->level != after->level) return std::nullopt;
  const std::complex<double> to(at->x_m - before->x_m, at->y_m - before->y_m),
      on(after->x_m - at->x_m, after->y_m - at->y_m);
  const bool turns = std::abs(std::arg(on * std::conj(to))) > kStraight_rad;
  if (std::abs(to) < kLeastWay_m || std::abs(on) < kLeastWay_m || turns) return std::nullopt;
  return std::pair(*at, std::arg(to + on));
}

}  // namespace

std::vector<SurveySecond> seconds_of(const radio::Journey& journey, std::uint32_t walk) {
  std::map<std::int64_t, std::map<std::string, std::pair<double, int>>> heard;
  for (const auto& told : journey.told) {
    const auto* row = std::get_if<radio::Journey::Row>(&told.what);
    if (row == nullptr || row->radio != radio::Radio::Bluetooth) continue;
    auto& [sum, count] = heard[told.time / Time(1000)][normalised_id(journey.transmitters[row->transmitter])];
    sum += row->rssi_dbm;
    ++count;
  }
  std::vector<SurveySecond> result;
  if (journey.way_points.empty()) return result;
  for (std::int64_t s = journey.way_points.front().first / 1000; s <= journey.way_points.back().first / 1000; ++s) {
    const auto at = walk::position_at(journey.way_points, s * 1000 + 500);
    if (!at) continue;
    SurveySecond second{walk, at->x_m, at->y_m, at->level, {}};
    for (const auto& [id, rssi] : heard[s]) second.rssi_dbm[id] = static_cast<float>(rssi.first / rssi.second);
    result.push_back(std::move(second));
  }
  return result;
}

void replay(const radio::Journey& journey, const BeaconField& field, BeaconFilter& filter,
            const std::function<void(Time)>& show) {
  const auto is_step = [](const auto& told) { return std::holds_alternative<radio::StepInput>(told.what); };
  if (std::any_of(journey.told.begin(), journey.told.end(), is_step)) filter.expect_steps(true);
  Time next = kOutput * (journey.begin / kOutput + 1);
  const auto show_until = [&](Time time) {
    for (; next < time; next += kOutput) {
      filter.advance(next);
      show(next);
    }
  };
  for (const auto& told : journey.told) {
    show_until(told.time);
    if (const auto* step = std::get_if<radio::StepInput>(&told.what)) {
      filter.step({step->length_m, step->length_sd_m, step->heading_rad, step->heading_sd_rad});
      continue;
    }
    const auto& row = std::get<radio::Journey::Row>(told.what);
    if (row.radio != radio::Radio::Bluetooth) continue;
    if (const auto beacon = field.find(journey.transmitters[row.transmitter])) filter.heard(*beacon, row.rssi_dbm);
  }
  show_until(journey.end + kOutput);
}

BeaconMap::Accuracy accuracy_of(const std::vector<radio::Journey>& walks, const FloorPlan& plan,
                                const FilterOptions& options, std::size_t most_folds) {
  std::vector<radio::LeftOutFix> fixes;
  const auto shared_plan = std::make_shared<const FloorPlan>(plan);
  const std::size_t folds = std::min(kFolds, walks.size());
  for (std::size_t fold = 0; fold < std::min(folds, most_folds); ++fold) {
    std::vector<SurveySecond> learnt;
    for (std::size_t i = 0; i < walks.size(); ++i) {
      const auto seconds = seconds_of(walks[i], static_cast<std::uint32_t>(i));
      if (i % folds != fold) learnt.insert(learnt.end(), seconds.begin(), seconds.end());
    }
    if (learnt.empty()) return careful_accuracy();
    const BeaconMap map = learn(learnt, "fold");
    const auto field = std::make_shared<const BeaconField>(map, shared_plan->extents());
    for (std::size_t i = fold; i < walks.size(); i += folds) {
      const auto& points = walks[i].way_points;
      BeaconFilter filter(field, shared_plan, careful_accuracy(), map.radio().offset(), options);
      replay(walks[i], *field, filter, [&](Time time) {
        if (points.empty() || time % kJudged != Time(0)) return;
        if (time.count() < points.front().first || time.count() > points.back().first) return;
        const auto truth = walk::position_at(points, time.count());
        const Estimate at = filter.estimate();
        if (!truth || !at.is_valid()) return;
        // Where only the walk itself went, the map without it says nothing of how good the map with it is.
        const std::size_t others = walks_near(learnt, *truth);
        if (others == 0) return;
        // A mean over n walks errs by 1 / n of a single walk's variance; the whole map has one walk more here.
        const auto n = static_cast<double>(others);
        const double gain = std::sqrt((1.0 + 1.0 / (n + 1.0)) / (1.0 + 1.0 / n));
        fixes.push_back({gain * Eigen::Vector2d(at.x_m - truth->x_m, at.y_m - truth->y_m), at.spread, others});
      });
    }
  }
  return fitted(fixes);
}

BeaconMap::Accuracy accuracy_of(const std::vector<SurveySecond>& survey, const FilterOptions& options) {
  using Place = std::tuple<int, std::int64_t, std::int64_t>;
  const auto place_of = [](const SurveySecond& s) { return Place(s.level, std::lround(s.x_m), std::lround(s.y_m)); };
  std::map<Place, std::size_t> places;
  for (const SurveySecond& second : survey) places.try_emplace(place_of(second), 0);
  std::size_t number = 0;
  for (auto& [place, fold] : places) fold = number++ % kPlaceFolds;
  std::vector<radio::LeftOutFix> fixes;
  const auto plan = std::make_shared<const FloorPlan>();
  for (std::size_t fold = 0; fold < kPlaceFolds; ++fold) {
    std::vector<SurveySecond> learnt, left_out;
    for (const auto& second : survey) {
      (places.at(place_of(second)) == fold ? left_out : learnt).push_back(second);
    }
    std::erase_if(left_out, [](const SurveySecond& second) { return second.rssi_dbm.empty(); });
    if (learnt.empty() || left_out.empty()) continue;
    const BeaconMap map = learn(learnt, "fold");
    const auto field = std::make_shared<const BeaconField>(map);
    const std::size_t count = std::min(kMostFixes / kPlaceFolds, left_out.size());
    for (std::size_t i = 0; i < count; ++i) {
      const SurveySecond& second = left_out[i * left_out.size() / count];
      BeaconFilter filter(field, plan, careful_accuracy(), map.radio().offset(), options);
      filter.advance(Time(0));
      for (const auto& [id, rssi] : second.rssi_dbm) {
        if (const auto beacon = field->find(id)) filter.heard(*beacon, rssi);
      }
      filter.advance(kJudged);
      const Estimate at = filter.estimate();
      if (at.is_valid()) fixes.push_back({{at.x_m - second.x_m, at.y_m - second.y_m}, at.spread, 1});
    }
  }
  return fitted(fixes);
}

void learn_compass(const std::vector<radio::Journey>& walks, BeaconMap& map) {
  struct Sum {
    double x_m = 0.0, y_m = 0.0;
    std::complex<double> off;
    std::uint32_t steps = 0;
  };
  std::map<std::tuple<int, std::int64_t, std::int64_t>, Sum> cells;
  std::complex<double> all;
  for (const radio::Journey& walk : walks) {
    for (const auto& told : walk.told) {
      const auto* step = std::get_if<radio::StepInput>(&told.what);
      const auto way = step != nullptr ? way_at(walk, told.time - kStepToldAfter) : std::nullopt;
      if (!way) continue;
      const auto& [at, direction_rad] = *way;
      Sum& sum = cells[{at.level, std::llround(at.x_m), std::llround(at.y_m)}];
      const auto off = std::polar(1.0, step->compass_rad - direction_rad);
      sum.x_m += at.x_m;
      sum.y_m += at.y_m;
      sum.off += off;
      ++sum.steps;
      all += off;
    }
  }
  map.clear_compass();
  for (const auto& [cell, sum] : cells) {
    auto& deviation = *map.add_compass();
    deviation.set_level(std::get<0>(cell));
    deviation.set_x(sum.x_m / sum.steps);
    deviation.set_y(sum.y_m / sum.steps);
    deviation.set_angle(std::arg(sum.off * std::conj(all)));  // declination and how a phone is held are no place's
    deviation.set_steps(sum.steps);
  }
}

}  // namespace fiona::beacons
