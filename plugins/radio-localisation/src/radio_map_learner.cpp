#include "radio_map_learner.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include <fiona/error.hpp>

namespace fiona::radio {
namespace {

constexpr std::size_t kMostCellsOfALevel = std::numeric_limits<std::uint16_t>::max();
constexpr double kOffsetDoubtRows = 20.0;  // rows that say "no offset" beside a walk's own

std::uint8_t quantised(double value) { return static_cast<std::uint8_t>(std::clamp(std::lround(value), 0l, 255l)); }

}  // namespace

/// The kernel by squared distance, tabulated: it is evaluated a few hundred million times.
struct RadioMapLearner::Kernel {
  static constexpr double kBin_m2 = 0.25;
  double reach_m;
  std::vector<float> weight;

  explicit Kernel(const LearnerOptions& options) : reach_m(2.5 * options.kernel_m * options.wide_factor) {
    const double core = 2.0 * options.kernel_m * options.kernel_m;
    const double wide = core * options.wide_factor * options.wide_factor;
    for (double d2 = 0.0; d2 <= reach_m * reach_m; d2 += kBin_m2) {
      weight.push_back(static_cast<float>(std::exp(-d2 / core) + options.wide_weight * std::exp(-d2 / wide)));
    }
  }

  /// Calls use(cell, weight) for every cell of the level within reach of the point.
  template <typename Use>
  void scatter(const RadioMap& map, const Level& level, double x_m, double y_m, Use&& use) const {
    const auto column_of = [&](double x) { return static_cast<int>(std::floor((x - level.west_m) / map.cell_m)); };
    const auto row_of = [&](double y) { return static_cast<int>(std::floor((y - level.south_m) / map.cell_m)); };
    const int last_column = std::min(level.columns - 1, column_of(x_m + reach_m));
    const int last_row = std::min(level.rows - 1, row_of(y_m + reach_m));
    for (int row = std::max(0, row_of(y_m - reach_m)); row <= last_row; ++row) {
      for (int column = std::max(0, column_of(x_m - reach_m)); column <= last_column; ++column) {
        const std::int32_t cell = level.cell_at[static_cast<std::size_t>(row) * level.columns + column];
        if (cell < 0) continue;
        const double dx = map.cells[cell].x_m - x_m, dy = map.cells[cell].y_m - y_m;
        const auto bin = static_cast<std::size_t>((dx * dx + dy * dy) / kBin_m2);
        if (bin < weight.size()) use(static_cast<std::uint32_t>(cell), weight[bin]);
      }
    }
  }
};

RadioMapLearner::RadioMapLearner(const LearnerOptions& options) : options_(options) {}

void RadioMapLearner::sweep(Radio radio, int level, double x_m, double y_m) {
  sweeps_[static_cast<int>(radio)].push_back({level, static_cast<float>(x_m), static_cast<float>(y_m), walk_});
}

void RadioMapLearner::heard(std::string_view id, Radio radio, int level, double x_m, double y_m, double rssi_dbm) {
  if (++samples_ > options_.most_samples) {
    throw Error(ErrorCode::Failed, {.what = "the survey is larger than a radio map can be learnt from",
                                    .where = std::string(id),
                                    .expected = "at most " + std::to_string(options_.most_samples) + " rows",
                                    .found = "more",
                                    .next = "learn one map per building"});
  }
  const auto [entry, added] = by_id_.try_emplace(normalised_id(id), heard_.size());
  if (added) heard_.push_back({entry->first, radio, {}});
  heard_[entry->second].samples.push_back(
      {{level, static_cast<float>(x_m), static_cast<float>(y_m), walk_}, static_cast<float>(rssi_dbm)});
}

std::uint32_t RadioMapLearner::begin_walk() { return ++walk_; }

void RadioMapLearner::path(int level, double x_m, double y_m) {
  path_.push_back({level, static_cast<float>(x_m), static_cast<float>(y_m), walk_});
}

std::size_t RadioMapLearner::other_walks_near(std::uint32_t walk, int level, double x_m, double y_m,
                                              double radius_m) const {
  std::set<std::uint32_t> found;
  for (const Point& point : path_) {
    if (point.walk == walk || point.level != level) continue;
    const double dx = point.x_m - x_m, dy = point.y_m - y_m;
    if (dx * dx + dy * dy <= radius_m * radius_m) found.insert(point.walk);
  }
  return found.size();
}

RadioMap RadioMapLearner::learn(std::string name, const std::set<std::uint32_t>& left_out) const {
  std::vector<WalkUse> walks(walk_ + 1);
  for (const std::uint32_t walk : left_out) walks.at(walk).counts = false;
  std::vector<Point> path;
  std::copy_if(path_.begin(), path_.end(), std::back_inserter(path),
               [&](const Point& point) { return walks[point.walk].counts; });
  if (path.empty() || heard_.empty()) {
    throw Error(ErrorCode::Failed, {.what = "no radio map can be learnt: the walks hold no radio row with a position",
                                    .where = name,
                                    .expected = "survey walks with way-points and Wi-Fi or beacon rows",
                                    .found = std::to_string(path.size()) + " positions, " +
                                             std::to_string(heard_.size()) + " transmitters",
                                    .next = "record the survey with way-points"});
  }
  RadioMap map;
  map.name = std::move(name);
  map.cell_m = options_.cell_m;
  make_levels(map, path);
  const Kernel kernel(options_);
  learn_transmitters(map, walks, kernel);
  for (int round = 0; round < options_.offset_rounds; ++round) {
    refine_offsets(map, walks);
    learn_transmitters(map, walks, kernel);
  }
  map.index();
  return map;
}

void RadioMapLearner::make_levels(RadioMap& map, const std::vector<Point>& path) const {
  std::set<int> numbers;
  double squares = 0.0;
  for (const Point& point : path) numbers.insert(point.level);
  for (const int number : numbers) {
    double west = 1e9, south = 1e9, east = -1e9, north = -1e9;
    for (const Point& point : path) {
      if (point.level != number) continue;
      west = std::min(west, double(point.x_m)), east = std::max(east, double(point.x_m));
      south = std::min(south, double(point.y_m)), north = std::max(north, double(point.y_m));
    }
    const double columns = std::ceil((east - west + 2.0 * options_.reach_m) / options_.cell_m);
    const double rows = std::ceil((north - south + 2.0 * options_.reach_m) / options_.cell_m);
    squares += columns * rows;
    if (!(squares <= kMostSquares)) {
      throw Error(ErrorCode::Failed,
                  {.what = "a level of the survey is too wide for one radio map",
                   .where = "level " + std::to_string(number),
                   .expected = "at most " + std::to_string(kMostSquares) + " squares on all levels",
                   .found = std::to_string(std::lround(std::max(east - west, north - south))) + " m",
                   .next = "check the way-points' unit and origin, or learn with larger cells (--cell)"});
    }
    Level level;
    level.level = number;
    level.west_m = west - options_.reach_m;
    level.south_m = south - options_.reach_m;
    level.columns = static_cast<int>(columns);
    level.rows = static_cast<int>(rows);
    map.levels.push_back(std::move(level));
    make_cells(map, path, map.levels.size() - 1);
  }
}

void RadioMapLearner::make_cells(RadioMap& map, const std::vector<Point>& path, std::size_t level_index) const {
  Level& level = map.levels[level_index];
  const double reach = options_.reach_m;
  std::vector<float> distance(static_cast<std::size_t>(level.columns) * level.rows, std::numeric_limits<float>::max());
  for (const Point& point : path) {
    if (point.level != level.level) continue;
    const int last_row = std::min<int>(level.rows - 1, (point.y_m + reach - level.south_m) / options_.cell_m);
    const int last_column = std::min<int>(level.columns - 1, (point.x_m + reach - level.west_m) / options_.cell_m);
    for (int row = std::max<int>(0, (point.y_m - reach - level.south_m) / options_.cell_m); row <= last_row; ++row) {
      for (int column = std::max<int>(0, (point.x_m - reach - level.west_m) / options_.cell_m); column <= last_column;
           ++column) {
        const double dx = level.west_m + (column + 0.5) * options_.cell_m - point.x_m;
        const double dy = level.south_m + (row + 0.5) * options_.cell_m - point.y_m;
        float& nearest = distance[static_cast<std::size_t>(row) * level.columns + column];
        nearest = std::min(nearest, static_cast<float>(std::hypot(dx, dy)));
      }
    }
  }
  level.first_cell = static_cast<std::uint32_t>(map.cells.size());
  level.cell_at.assign(distance.size(), -1);
  for (std::size_t i = 0; i < distance.size(); ++i) {
    if (distance[i] > reach) continue;
    level.cell_at[i] = static_cast<std::int32_t>(map.cells.size());
    map.cells.push_back({static_cast<float>(level.west_m + (i % level.columns + 0.5) * options_.cell_m),
                         static_cast<float>(level.south_m + (i / level.columns + 0.5) * options_.cell_m),
                         static_cast<float>(0.1 * std::min(255.0, std::round(10.0 * distance[i])))});
  }
  level.cell_count = static_cast<std::uint32_t>(map.cells.size()) - level.first_cell;
  if (level.cell_count > kMostCellsOfALevel) {
    throw Error(ErrorCode::Failed, {.what = "a level of the survey is too large for one radio map",
                                    .where = "level " + std::to_string(level.level),
                                    .expected = "at most " + std::to_string(kMostCellsOfALevel) + " cells",
                                    .found = std::to_string(level.cell_count) + " cells",
                                    .next = "learn with larger cells (--cell)"});
  }
}

std::vector<float> RadioMapLearner::count_sweeps(const RadioMap& map, Radio radio, const std::vector<WalkUse>& walks,
                                                 const Kernel& kernel) const {
  std::vector<float> count(map.cells.size(), 0.0f);
  for (const Point& point : sweeps_[static_cast<int>(radio)]) {
    const auto level_index = map.level_index(point.level);
    if (!level_index || !walks[point.walk].counts) continue;
    kernel.scatter(map, map.levels[*level_index], point.x_m, point.y_m,
                   [&](std::uint32_t cell, float weight) { count[cell] += weight; });
  }
  return count;
}

void RadioMapLearner::learn_transmitters(RadioMap& map, const std::vector<WalkUse>& walks, const Kernel& kernel) const {
  map.transmitters.clear();
  map.expectations.clear();
  const std::vector<float> sweeps[2] = {count_sweeps(map, Radio::WiFi, walks, kernel),
                                        count_sweeps(map, Radio::Bluetooth, walks, kernel)};
  for (const Heard& heard : heard_) {
    learn_transmitter(map, heard, sweeps[static_cast<int>(heard.radio)], walks, kernel);
  }
}

/// Moves each walk's offset by the mean deviation of its rows from the map; their mean over all walks stays zero, for
/// the map's own level is free.
void RadioMapLearner::refine_offsets(const RadioMap& map, std::vector<WalkUse>& walks) const {
  std::vector<double> sum(walks.size(), 0.0), count(walks.size(), kOffsetDoubtRows);
  std::unordered_map<std::string_view, const Transmitter*> learnt;
  for (const Transmitter& transmitter : map.transmitters) learnt.emplace(transmitter.id, &transmitter);
  std::vector<std::int16_t> expected(map.cells.size());
  for (const Heard& heard : heard_) {
    const auto found = learnt.find(heard.id);
    if (heard.radio != Radio::WiFi || found == learnt.end()) continue;
    std::fill(expected.begin(), expected.end(), -1);
    for (const auto& span : found->second->spans) {
      for (std::uint32_t i = span.begin; i < span.end; ++i) {
        expected[map.levels[span.level_index].first_cell + map.expectations[i].cell] = map.expectations[i].rssi_q;
      }
    }
    for (const Sample& sample : heard.samples) {
      const auto level_index = map.level_index(sample.at.level);
      const std::int32_t cell = level_index ? map.cell_at(*level_index, sample.at.x_m, sample.at.y_m) : -1;
      if (cell < 0 || expected[cell] < 0 || !walks[sample.at.walk].counts) continue;
      sum[sample.at.walk] += sample.rssi_dbm - walks[sample.at.walk].offset_db + 0.5 * expected[cell];
      count[sample.at.walk] += 1.0;
    }
  }
  double total = 0.0, counting = 0.0;
  for (std::size_t walk = 0; walk < walks.size(); ++walk) {
    if (!walks[walk].counts) continue;
    walks[walk].offset_db += sum[walk] / count[walk];
    total += walks[walk].offset_db;
    counting += 1.0;
  }
  for (WalkUse& walk : walks) walk.offset_db -= total / counting;
}

void RadioMapLearner::learn_transmitter(RadioMap& map, const Heard& heard, const std::vector<float>& sweeps,
                                        const std::vector<WalkUse>& walks, const Kernel& kernel) const {
  Transmitter transmitter{heard.id, heard.radio, {}};
  for (std::uint32_t level_index = 0; level_index < map.levels.size(); ++level_index) {
    const Level& level = map.levels[level_index];
    std::vector<float> count(level.cell_count, 0.0f), sum(level.cell_count, 0.0f);
    for (const Sample& sample : heard.samples) {
      const WalkUse& walk = walks[sample.at.walk];
      if (sample.at.level != level.level || !walk.counts) continue;
      const auto rssi_dbm = static_cast<float>(sample.rssi_dbm - walk.offset_db);
      kernel.scatter(map, level, sample.at.x_m, sample.at.y_m, [&](std::uint32_t cell, float weight) {
        count[cell - level.first_cell] += weight;
        sum[cell - level.first_cell] += weight * rssi_dbm;
      });
    }
    const auto begin = static_cast<std::uint32_t>(map.expectations.size());
    for (std::uint32_t cell = 0; cell < level.cell_count; ++cell) {
      const double share = count[cell] / (sweeps[level.first_cell + cell] + options_.doubt_sweeps);
      if (share < options_.least_heard) continue;
      map.expectations.push_back({static_cast<std::uint16_t>(cell), quantised(-2.0 * sum[cell] / count[cell]),
                                  quantised(256.0 * std::min(share, 0.97) - 0.5)});
    }
    const auto end = static_cast<std::uint32_t>(map.expectations.size());
    if (end > begin) transmitter.spans.push_back({level_index, begin, end});
  }
  if (!transmitter.spans.empty()) map.transmitters.push_back(std::move(transmitter));
}

}  // namespace fiona::radio
