#include "beacon_field.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <map>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr double kFinestCell_m = 0.5;
constexpr double kBeyondSurvey_m = 2.0;   // people are where surveyors went, or beside it
constexpr double kBeyondBeacons_m = 4.0;  // where nobody surveyed
constexpr std::size_t kMostValues = 16u << 20;
constexpr int kMostPlacesOfBeacon = 400;  // of one level: the cost of the process grows with the square
constexpr double kNothing = 1e-4;         // of the variance: a covariance that changes nothing
const double kLogNear = std::log(0.01);
constexpr double kCompassWidth_m = 1.0, kCompassReach_m = 3.0;
constexpr float kNoDeviation = 0.1f;         // of a compass: counts as a tenth of a step that says so
constexpr std::uint32_t kReliableSteps = 4;  // in one place: more of them share the same error
constexpr std::uint32_t kBlock = 12;         // cells of a side, which are worked out together
constexpr double kNearest_m = 1.0;           // path loss is not defined at distance 0
constexpr double kReliableCount = 4.0;       // seconds in one place: more of them share the same error
constexpr double kOutliers = 0.02, kOutlierRange_db = 60.0;
constexpr double kTableLow_dbm = -160.0, kTableStep_db = 0.25;
constexpr std::size_t kTableSize = 960;

double path_loss_db(double exponent, double dx_m, double dy_m) {
  return 5.0 * exponent * std::log10(dx_m * dx_m + dy_m * dy_m + kNearest_m * kNearest_m);
}

/// What the beacon sends, as heard on a level.
double power_dbm(const BeaconMap::Beacon& beacon, int level, double level_loss_db) {
  const BeaconMap::Beacon::OnLevel* nearest = &beacon.heard(0);
  for (const auto& on : beacon.heard()) {
    if (std::abs(on.level() - level) < std::abs(nearest->level() - level)) nearest = &on;
  }
  return nearest->power() - level_loss_db * std::abs(nearest->level() - level);
}

struct Point {
  double x_m, y_m, residual_db, variance_db2;
};

std::vector<Point> surveyed(const BeaconMap& map, std::uint32_t beacon, int level, double power, double exponent) {
  std::vector<Point> all;
  for (const auto& place : map.survey()) {
    if (place.level() != level) continue;
    for (const auto& reading : place.readings()) {
      if (reading.beacon() != beacon) continue;
      const double mean =
          power - path_loss_db(exponent, place.x() - map.beacons(beacon).x(), place.y() - map.beacons(beacon).y());
      const double sd = map.radio().reading();
      all.push_back({place.x(), place.y(), reading.rssi() - mean,
                     sd * sd / std::clamp<double>(reading.count(), 1.0, kReliableCount)});
    }
  }
  if (all.size() <= kMostPlacesOfBeacon) return all;
  std::vector<Point> some;
  for (int i = 0; i < kMostPlacesOfBeacon; ++i) some.push_back(all[i * all.size() / kMostPlacesOfBeacon]);
  return some;
}

/// The process over the residuals of one beacon on one level. Its cost would be that of all pairs of points for each
/// place; but a point says nothing of a place that is far from it, so each block of places is worked out with those
/// points alone that it is near to.
class Shadowing {
 public:
  Shadowing(const std::vector<Point>& points, const BeaconMap::Radio& radio)
      : points_(points),
        variance_(radio.shadowing() * radio.shadowing()),
        scale_(-0.5 / (radio.shadowing_reach() * radio.shadowing_reach())),
        weights_(covariance_of(points).llt().solve(residuals())) {}

  /// Mean and variance in some places beside each other; where no point of the survey is near, the prior.
  std::vector<Expected> predict(const std::vector<BeaconField::Cell>& places) const {
    std::vector<Expected> result(places.size(), {0.0f, static_cast<float>(variance_)});
    const auto [points, weights] = around(places);
    std::vector<std::size_t> near;
    for (std::size_t j = 0; j < places.size(); ++j) {
      if (std::any_of(points.begin(), points.end(), [&](const Point& p) { return is_near(p, places[j]); })) {
        near.push_back(j);
      }
    }
    if (near.empty()) return result;  // Eigen's solver reads the first element
    Eigen::MatrixXd to(static_cast<Eigen::Index>(points.size()), static_cast<Eigen::Index>(near.size()));
    for (Eigen::Index j = 0; j < to.cols(); ++j) {
      for (Eigen::Index i = 0; i < to.rows(); ++i)
        to(i, j) = between(points[i], places[near[j]].x_m, places[near[j]].y_m);
    }
    const Eigen::VectorXd mean = to.transpose() * weights;
    const Eigen::LLT<Eigen::MatrixXd> factor(covariance_of(points));
    factor.matrixL().solveInPlace(to);
    for (Eigen::Index j = 0; j < to.cols(); ++j) {
      result[near[j]] = {static_cast<float>(mean[j]),
                         static_cast<float>(std::max(0.0, variance_ - to.col(j).squaredNorm()))};
    }
    return result;
  }

 private:
  double between(const Point& p, double x_m, double y_m) const {
    const double dx = p.x_m - x_m, dy = p.y_m - y_m;
    return variance_ * std::exp(scale_ * (dx * dx + dy * dy));
  }

  Eigen::MatrixXd covariance_of(const std::vector<Point>& points) const {
    const auto n = static_cast<Eigen::Index>(points.size());
    Eigen::MatrixXd covariance(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        covariance(i, j) = covariance(j, i) = between(points[i], points[j].x_m, points[j].y_m);
      }
      covariance(i, i) += points[i].variance_db2;
    }
    return covariance;
  }

  Eigen::VectorXd residuals() const {
    Eigen::VectorXd all(static_cast<Eigen::Index>(points_.size()));
    for (std::size_t i = 0; i < points_.size(); ++i) all[static_cast<Eigen::Index>(i)] = points_[i].residual_db;
    return all;
  }

  /// Those that say anything of the places, with their weights in the mean.
  std::pair<std::vector<Point>, Eigen::VectorXd> around(const std::vector<BeaconField::Cell>& places) const {
    const auto [west, east] =
        std::minmax_element(places.begin(), places.end(), [](const auto& a, const auto& b) { return a.x_m < b.x_m; });
    const auto [south, north] =
        std::minmax_element(places.begin(), places.end(), [](const auto& a, const auto& b) { return a.y_m < b.y_m; });
    std::vector<Point> points;
    std::vector<double> weights;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const double dx = points_[i].x_m - std::clamp(points_[i].x_m, west->x_m, east->x_m);
      const double dy = points_[i].y_m - std::clamp(points_[i].y_m, south->y_m, north->y_m);
      if (scale_ * (dx * dx + dy * dy) < std::log(kNothing)) continue;
      points.push_back(points_[i]);
      weights.push_back(weights_[static_cast<Eigen::Index>(i)]);
    }
    return {std::move(points), Eigen::Map<Eigen::VectorXd>(weights.data(), static_cast<Eigen::Index>(weights.size()))};
  }

  /// Beyond, the covariance is below 1 % of the variance.
  bool is_near(const Point& p, const BeaconField::Cell& cell) const {
    const double dx = p.x_m - cell.x_m, dy = p.y_m - cell.y_m;
    return scale_ * (dx * dx + dy * dy) > kLogNear;
  }

  const std::vector<Point>& points_;
  const double variance_, scale_;
  const Eigen::VectorXd weights_;
};

}  // namespace

BeaconField::BeaconField(const BeaconMap& map, std::span<const Extent> more)
    : radio_(map.radio()), beacons_(static_cast<std::size_t>(map.beacons_size())) {
  lay_out(map, more);
  expected_.resize(cells_ * beacons_);
  for (std::size_t i = 0; i < kTableSize; ++i) {
    const double mean = kTableLow_dbm + kTableStep_db * static_cast<double>(i);
    const double heard = radio_.heard_most() / (1.0 + std::exp((radio_.threshold() - mean) / radio_.slope()));
    log_heard_.push_back(static_cast<float>(std::log(std::max(heard, 1e-6))));
    log_unheard_.push_back(static_cast<float>(std::log1p(-heard)));
  }
  for (std::size_t i = 0; i < beacons_; ++i) {
    by_id_.emplace(normalised_id(map.beacons(static_cast<int>(i)).id()), static_cast<std::uint32_t>(i));
    work_out(map, i);
  }
  work_out_compass(map);
}

void BeaconField::lay_out(const BeaconMap& map, std::span<const Extent> more) {
  std::map<int, Extent> extents;
  const auto add = [&](int level, double x, double y, double margin) {
    auto& e = extents.try_emplace(level, Extent{level, x, y, x, y}).first->second;
    e = {level, std::min(e.low_x_m, x - margin), std::min(e.low_y_m, y - margin), std::max(e.high_x_m, x + margin),
         std::max(e.high_y_m, y + margin)};
  };
  for (const auto& place : map.survey()) add(place.level(), place.x(), place.y(), kBeyondSurvey_m);
  if (map.survey().empty()) {
    for (const auto& beacon : map.beacons()) {
      for (const auto& on : beacon.heard()) add(on.level(), beacon.x(), beacon.y(), kBeyondBeacons_m);
    }
  }
  for (const Extent& e : more) {
    add(e.level, e.low_x_m, e.low_y_m, 0.0);
    add(e.level, e.high_x_m, e.high_y_m, 0.0);
  }
  for (cell_m_ = kFinestCell_m;; cell_m_ *= 2) {
    levels_.clear();
    cells_ = 0;
    for (const auto& [level, e] : extents) {
      const auto columns = static_cast<std::uint32_t>((e.high_x_m - e.low_x_m) / cell_m_) + 1;
      const auto rows = static_cast<std::uint32_t>((e.high_y_m - e.low_y_m) / cell_m_) + 1;
      levels_.push_back({level, e.low_x_m, e.low_y_m, columns, rows, cells_});
      cells_ += std::size_t{columns} * rows;
    }
    if (cells_ * beacons_ <= kMostValues) return;
    if (cells_ == levels_.size()) {
      throw Error(ErrorCode::Usage,
                  {.what = "the beacon map is too large",
                   .where = map.name(),
                   .expected = std::to_string(kMostValues) + " values, a beacon on a level each",
                   .found = std::to_string(beacons_) + " beacons, " + std::to_string(cells_) + " levels",
                   .next = "a map for each building"});
    }
  }
}

BeaconField::Cell BeaconField::centre(std::size_t level_index, std::size_t cell) const {
  const Level& level = levels_[level_index];
  return {level.west_m + (static_cast<double>(cell % level.columns) + 0.5) * cell_m_,
          level.south_m + (static_cast<double>(cell / level.columns) + 0.5) * cell_m_};
}

void BeaconField::work_out(const BeaconMap& map, std::size_t number) {
  const auto& beacon = map.beacons(static_cast<int>(number));
  const double exponent = beacon.has_exponent() ? beacon.exponent() : kUsualExponent;
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    const double power = power_dbm(beacon, levels_[l].level, radio_.level_loss());
    const auto points = surveyed(map, static_cast<std::uint32_t>(number), levels_[l].level, power, exponent);
    const float prior = static_cast<float>(radio_.shadowing() * radio_.shadowing());
    std::optional<Shadowing> shadowing;
    if (!points.empty()) shadowing.emplace(points, radio_);
    for (std::uint32_t row = 0; row < levels_[l].rows; row += kBlock) {
      for (std::uint32_t column = 0; column < levels_[l].columns; column += kBlock) {
        std::vector<std::size_t> cells;
        std::vector<Cell> places;
        for (std::uint32_t y = row; y < std::min(row + kBlock, levels_[l].rows); ++y) {
          for (std::uint32_t x = column; x < std::min(column + kBlock, levels_[l].columns); ++x) {
            cells.push_back(std::size_t{y} * levels_[l].columns + x);
            places.push_back(centre(l, cells.back()));
          }
        }
        const auto shadows =
            shadowing ? shadowing->predict(places) : std::vector<Expected>(places.size(), {0.0f, prior});
        for (std::size_t i = 0; i < places.size(); ++i) {
          const double loss = path_loss_db(exponent, places[i].x_m - beacon.x(), places[i].y_m - beacon.y());
          expected_[(levels_[l].first_cell + cells[i]) * beacons_ + number] = {
              static_cast<float>(power - loss) + shadows[i].mean_dbm, shadows[i].variance_db2};
        }
      }
    }
  }
}

std::optional<std::uint32_t> BeaconField::find(std::string_view id) const {
  const auto found = by_id_.find(normalised_id(id));
  return found == by_id_.end() ? std::nullopt : std::optional(found->second);
}

std::size_t BeaconField::cell_at(const Level& level, double x_m, double y_m) const {
  const auto index = [&](double from_low_m, std::uint32_t count) {
    return static_cast<std::size_t>(std::clamp(from_low_m / cell_m_, 0.0, static_cast<double>(count - 1)));
  };
  return level.first_cell + index(y_m - level.south_m, level.rows) * level.columns +
         index(x_m - level.west_m, level.columns);
}

std::span<const Expected> BeaconField::at(std::size_t level_index, double x_m, double y_m) const {
  return of_cell(cell_at(levels_[level_index], x_m, y_m));
}

double BeaconField::compass_deviation_rad(std::size_t level_index, double x_m, double y_m) const {
  return knows_compass() ? deviation_rad_[cell_at(levels_[level_index], x_m, y_m)] : 0.0;
}

void BeaconField::work_out_compass(const BeaconMap& map) {
  if (map.compass().empty()) return;
  std::vector<std::complex<float>> sums(cells_, kNoDeviation);
  for (const auto& one : map.compass()) {
    usual_deviation_rad_ += one.angle() * one.angle() / map.compass_size();
    const auto level =
        std::find_if(levels_.begin(), levels_.end(), [&](const Level& l) { return l.level == one.level(); });
    if (level == levels_.end()) continue;
    const auto places = static_cast<float>(std::min(one.steps(), kReliableSteps));
    const auto sum = std::polar(places, static_cast<float>(one.angle()));
    for (double y = one.y() - kCompassReach_m; y <= one.y() + kCompassReach_m; y += cell_m_) {
      for (double x = one.x() - kCompassReach_m; x <= one.x() + kCompassReach_m; x += cell_m_) {
        if (x < level->west_m || y < level->south_m || x >= level->west_m + level->columns * cell_m_ ||
            y >= level->south_m + level->rows * cell_m_) {
          continue;
        }
        const std::size_t cell = cell_at(*level, x, y);
        const Cell at = centre(static_cast<std::size_t>(level - levels_.begin()), cell - level->first_cell);
        const double off = std::hypot(at.x_m - one.x(), at.y_m - one.y()) / kCompassWidth_m;
        sums[cell] += sum * static_cast<float>(std::exp(-0.5 * off * off));
      }
    }
  }
  usual_deviation_rad_ = std::sqrt(usual_deviation_rad_);
  for (const auto& sum : sums) deviation_rad_.push_back(std::arg(sum));
}

float BeaconField::table(const std::vector<float>& values, double mean_dbm) const {
  const double place = (mean_dbm - kTableLow_dbm) / kTableStep_db;
  return values[static_cast<std::size_t>(std::clamp(place, 0.0, static_cast<double>(kTableSize - 1)))];
}

double BeaconField::log_likelihood(std::span<const Expected> expected, std::span<const Heard> heard, double offset_db,
                                   double silence) const {
  const double reading = radio_.reading() * radio_.reading();
  double sum = 0.0;
  auto next = heard.begin();
  for (std::uint32_t beacon = 0; beacon < beacons_; ++beacon) {
    const double mean = expected[beacon].mean_dbm + offset_db;
    if (next == heard.end() || next->beacon != beacon) {
      if (silence > 0.0) sum += silence * log_unheard(mean);
      continue;
    }
    const double variance = reading + expected[beacon].variance_db2;
    const double off = next->rssi_dbm - mean;
    const double density = std::exp(-0.5 * off * off / variance) / std::sqrt(2.0 * M_PI * variance);
    sum += std::log((1.0 - kOutliers) * density + kOutliers / kOutlierRange_db) + silence * log_heard(mean);
    ++next;
  }
  return sum;
}

}  // namespace fiona::beacons
