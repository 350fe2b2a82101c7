#include "survey_walks.hpp"

#include <cmath>

#include "accuracy.hpp"

namespace fiona::beacons {
namespace {

constexpr Time kOutput{200};
constexpr Time kJudged{1000};
constexpr double kInside = 0.92;  // of halves of the survey; the whole of it errs less
constexpr std::size_t kFolds = 2;

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
                                const FilterOptions& options) {
  std::vector<radio::LeftOutFix> fixes;
  const auto shared_plan = std::make_shared<const FloorPlan>(plan);
  for (std::size_t fold = 0; fold < kFolds; ++fold) {
    std::vector<SurveySecond> learnt;
    for (std::size_t i = 0; i < walks.size(); ++i) {
      const auto seconds = seconds_of(walks[i], static_cast<std::uint32_t>(i));
      if (i % kFolds != fold) learnt.insert(learnt.end(), seconds.begin(), seconds.end());
    }
    if (learnt.empty()) return careful_accuracy();
    const BeaconMap map = learn(learnt, "fold");
    const auto field = std::make_shared<const BeaconField>(map, shared_plan->extents());
    for (std::size_t i = fold; i < walks.size(); i += kFolds) {
      const auto& points = walks[i].way_points;
      BeaconFilter filter(field, shared_plan, careful_accuracy(), map.radio().offset(), options);
      replay(walks[i], *field, filter, [&](Time time) {
        if (points.empty() || time % kJudged != Time(0)) return;
        if (time.count() < points.front().first || time.count() > points.back().first) return;
        const auto truth = walk::position_at(points, time.count());
        const Estimate at = filter.estimate();
        if (!truth || !at.is_valid()) return;
        fixes.push_back({{at.x_m - truth->x_m, at.y_m - truth->y_m}, at.spread, 1});
      });
    }
  }
  BeaconMap::Accuracy accuracy = careful_accuracy();
  if (fixes.empty()) return accuracy;
  const radio::Accuracy fitted = radio::fit_accuracy(fixes, kInside);
  accuracy.set_factor(fitted.covariance_factor);
  accuracy.set_floor(std::max(0.1, fitted.covariance_floor_m));
  return accuracy;
}

}  // namespace fiona::beacons
