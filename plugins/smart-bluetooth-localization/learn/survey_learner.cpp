#include "survey_learner.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr int kTurns = 8;
constexpr double kSearchMargin_m = 10.0, kSearchStep_m = 1.0;
constexpr double kLeastExponent = 1.0, kMostExponent = 4.0;
constexpr double kBin_m = 1.0;
constexpr double kExpectedStep_db = 0.25;
constexpr double kOffsetPrior_db = 6.0;
constexpr double kLeastOffset_db = 5.0;  // the next phone is none of the surveyors'
constexpr std::size_t kLeastRows = 10;
constexpr std::size_t kMostPointsToFit = 150;
constexpr std::array kShadowing_db{1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0};  // tried, each with each reach
constexpr std::array kReach_m{1.5, 2.0, 2.5, 3.5, 5.0, 7.0};
using Evidence = std::array<double, kShadowing_db.size() * kReach_m.size()>;

struct Row {
  std::uint32_t walk;
  double x_m, y_m;
  int level;
  double rssi_dbm;
};

struct Fit {
  double x_m = 0.0, y_m = 0.0, exponent = kUsualExponent;
  std::map<int, double> power_dbm;
  double squares = std::numeric_limits<double>::max();

  double mean_dbm(double x, double y, int level) const {
    const double dx = x - x_m, dy = y - y_m;
    return power_dbm.at(level) - 5.0 * exponent * std::log10(dx * dx + dy * dy + 1.0);
  }
};

/// Power by level and exponent for one place of the beacon; the exponent by regression within levels.
Fit fit_at(double x_m, double y_m, const std::vector<Row>& rows, const std::vector<double>& offsets) {
  struct Sums {
    double n = 0, loss = 0, rssi = 0, loss2 = 0, cross = 0, rssi2 = 0;
  };
  std::map<int, Sums> levels;
  Sums* of_level = nullptr;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Row& row = rows[i];
    const double dx = row.x_m - x_m, dy = row.y_m - y_m;
    const double loss = 5.0 * std::log10(dx * dx + dy * dy + 1.0), rssi = row.rssi_dbm - offsets[row.walk];
    if (i == 0 || row.level != rows[i - 1].level) of_level = &levels[row.level];
    Sums& s = *of_level;
    s.n += 1, s.loss += loss, s.rssi += rssi, s.loss2 += loss * loss, s.cross += loss * rssi, s.rssi2 += rssi * rssi;
  }
  double within_loss2 = 0.0, within_cross = 0.0, within_rssi2 = 0.0;
  for (const auto& [level, s] : levels) {
    within_loss2 += s.loss2 - s.loss * s.loss / s.n;
    within_cross += s.cross - s.loss * s.rssi / s.n;
    within_rssi2 += s.rssi2 - s.rssi * s.rssi / s.n;
  }
  Fit fit{.x_m = x_m, .y_m = y_m};
  fit.exponent =
      std::clamp(within_loss2 > 0.0 ? -within_cross / within_loss2 : kUsualExponent, kLeastExponent, kMostExponent);
  fit.squares = within_rssi2 + 2.0 * fit.exponent * within_cross + fit.exponent * fit.exponent * within_loss2;
  for (const auto& [level, s] : levels) fit.power_dbm[level] = (s.rssi + fit.exponent * s.loss) / s.n;
  return fit;
}

Fit fit_beacon(const std::vector<Row>& rows, const std::vector<double>& offsets) {
  const auto [west, east] =
      std::minmax_element(rows.begin(), rows.end(), [](auto& a, auto& b) { return a.x_m < b.x_m; });
  const auto [south, north] =
      std::minmax_element(rows.begin(), rows.end(), [](auto& a, auto& b) { return a.y_m < b.y_m; });
  Fit best;
  const double span = std::max(east->x_m - west->x_m, north->y_m - south->y_m) + 2 * kSearchMargin_m;
  for (double step = std::max(kSearchStep_m, span / 64);; step = kSearchStep_m) {
    const bool again = best.squares < std::numeric_limits<double>::max();
    const double half = 2 * std::max(kSearchStep_m, span / 64);
    const double x1 = again ? best.x_m - half : west->x_m - kSearchMargin_m;
    const double x2 = again ? best.x_m + half : east->x_m + kSearchMargin_m;
    const double y1 = again ? best.y_m - half : south->y_m - kSearchMargin_m;
    const double y2 = again ? best.y_m + half : north->y_m + kSearchMargin_m;
    for (double x = x1; x <= x2; x += step) {
      for (double y = y1; y <= y2; y += step) {
        const Fit fit = fit_at(x, y, rows, offsets);
        if (fit.squares < best.squares) best = fit;
      }
    }
    if (again || step == kSearchStep_m) return best;
  }
}

struct Bin {
  double x_m = 0, y_m = 0, residual_db = 0;
  int level = 0;
  double count = 0;
};

/// Readings by place: of each beacon, around each place of a grid.
std::map<std::array<int, 3>, Bin> bins_of(const std::vector<Row>& rows, const std::vector<double>& offsets,
                                          const Fit& fit) {
  std::map<std::array<int, 3>, Bin> bins;
  for (const Row& row : rows) {
    Bin& bin = bins[{row.level, static_cast<int>(std::lround(row.x_m / kBin_m)),
                     static_cast<int>(std::lround(row.y_m / kBin_m))}];
    bin.level = row.level;
    bin.x_m += row.x_m;
    bin.y_m += row.y_m;
    bin.residual_db += row.rssi_dbm - offsets[row.walk] - fit.mean_dbm(row.x_m, row.y_m, row.level);
    bin.count += 1;
  }
  for (auto& [key, bin] : bins) {
    bin.x_m /= bin.count;
    bin.y_m /= bin.count;
    bin.residual_db /= bin.count;
  }
  return bins;
}

class Learner {
 public:
  Learner(const std::vector<SurveySecond>& survey, const std::string& name) : survey_(survey) {
    map_.set_name(name);
    std::uint32_t walks = 0;
    for (const SurveySecond& second : survey) {
      walks = std::max(walks, second.walk + 1);
      for (const auto& [id, rssi] : second.rssi_dbm) {
        rows_[id].push_back({second.walk, second.x_m, second.y_m, second.level, rssi});
      }
    }
    std::erase_if(rows_, [](const auto& entry) { return entry.second.size() < kLeastRows; });
    if (rows_.empty()) {
      throw Error(ErrorCode::Usage, {.what = "the survey heard no beacon often enough to learn it",
                                     .where = name,
                                     .expected = std::to_string(kLeastRows) + " seconds that hear it"});
    }
    offsets_.assign(walks, 0.0);
  }

  BeaconMap learn() {
    for (int turn = 0; turn < kTurns; ++turn) {
      // Where beacons are is searched for with two sets of offsets; it hardly moves thereafter.
      for (const auto& [id, rows] : rows_) {
        Fit& fit = fits_[id];
        fit = turn < 2 ? fit_beacon(rows, offsets_) : fit_at(fit.x_m, fit.y_m, rows, offsets_);
      }
      fit_offsets();
    }
    *map_.mutable_radio() = usual_radio();
    fit_spread();
    fit_shadowing();
    write_beacons();
    fit_silence();
    return map_;
  }

 private:
  /// Against what other walks read in the same place, so that shadows are no offsets.
  void fit_offsets() {
    std::vector<double> sum(offsets_.size(), 0.0), count(offsets_.size(), 0.0);
    for (const auto& [id, rows] : rows_) {
      const auto bins = bins_of(rows, offsets_, fits_[id]);
      for (const Row& row : rows) {
        const Bin& bin = bins.at({row.level, static_cast<int>(std::lround(row.x_m / kBin_m)),
                                  static_cast<int>(std::lround(row.y_m / kBin_m))});
        // Half of the shadow of a place is taken for known.
        sum[row.walk] += row.rssi_dbm - fits_[id].mean_dbm(row.x_m, row.y_m, row.level) - 0.5 * bin.residual_db;
        count[row.walk] += 1;
      }
    }
    double mean = 0.0;
    for (std::size_t i = 0; i < offsets_.size(); ++i)
      mean += offsets_[i] = count[i] > 0 ? sum[i] / (count[i] + 5.0) : 0.0;
    mean /= static_cast<double>(offsets_.size());
    double squares = 0.0;
    for (double& offset : offsets_) offset -= mean, squares += offset * offset;
    const auto n = static_cast<double>(offsets_.size());
    offset_sd_db_ = std::sqrt((squares + 2 * kOffsetPrior_db * kOffsetPrior_db) / (n + 2));
  }

  /// Of readings around what is usual in their place: the survey says where there are several.
  void fit_spread() {
    double squares = 0.0, freedom = 0.0;
    for (const auto& [id, rows] : rows_) {
      const auto bins = bins_of(rows, offsets_, fits_[id]);
      for (const Row& row : rows) {
        const Bin& bin = bins.at({row.level, static_cast<int>(std::lround(row.x_m / kBin_m)),
                                  static_cast<int>(std::lround(row.y_m / kBin_m))});
        const double off =
            row.rssi_dbm - offsets_[row.walk] - fits_[id].mean_dbm(row.x_m, row.y_m, row.level) - bin.residual_db;
        squares += off * off;
      }
      freedom += static_cast<double>(rows.size()) - static_cast<double>(bins.size());
    }
    if (freedom > 30) map_.mutable_radio()->set_reading(std::clamp(std::sqrt(squares / freedom), 1.0, 12.0));
    map_.mutable_radio()->set_offset(std::clamp(offset_sd_db_, kLeastOffset_db, 12.0));
  }

  void fit_shadowing() {
    Evidence log{};
    for (const auto& [id, rows] : rows_) {
      const Evidence of_beacon = log_evidence(id, rows);
      for (std::size_t i = 0; i < log.size(); ++i) log[i] += of_beacon[i];
    }
    const auto best = static_cast<std::size_t>(std::max_element(log.begin(), log.end()) - log.begin());
    map_.mutable_radio()->set_shadowing(kShadowing_db[best / kReach_m.size()]);
    map_.mutable_radio()->set_shadowing_reach(kReach_m[best % kReach_m.size()]);
  }

  /// Of each standard deviation with each reach.
  Evidence log_evidence(const std::string& id, const std::vector<Row>& rows) {
    std::map<int, std::vector<Bin>> levels;
    for (const auto& [key, bin] : bins_of(rows, offsets_, fits_[id])) levels[bin.level].push_back(bin);
    Evidence log{};
    for (const auto& [level, all] : levels) {
      std::vector<Bin> bins;
      const std::size_t n = std::min(all.size(), kMostPointsToFit);
      for (std::size_t i = 0; i < n; ++i) bins.push_back(all[i * all.size() / n]);
      const auto size = static_cast<Eigen::Index>(n);
      Eigen::VectorXd residual(size), noise(size);
      for (Eigen::Index i = 0; i < size; ++i) {
        residual[i] = bins[i].residual_db;
        noise[i] = map_.radio().reading() * map_.radio().reading() / std::min(4.0, bins[i].count);
      }
      Eigen::MatrixXd alike(size, size), covariance(size, size);  // lower halves
      for (std::size_t r = 0; r < kReach_m.size(); ++r) {
        for (Eigen::Index j = 0; j < size; ++j) {
          for (Eigen::Index i = j; i < size; ++i) {
            const double dx = bins[i].x_m - bins[j].x_m, dy = bins[i].y_m - bins[j].y_m;
            alike(i, j) = std::exp(-0.5 * (dx * dx + dy * dy) / (kReach_m[r] * kReach_m[r]));
          }
        }
        for (std::size_t s = 0; s < kShadowing_db.size(); ++s) {
          covariance.triangularView<Eigen::Lower>() = kShadowing_db[s] * kShadowing_db[s] * alike;
          covariance.diagonal() += noise;
          const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
          double& sum = log[s * kReach_m.size() + r];
          sum -= 0.5 * residual.dot(factor.solve(residual));
          for (Eigen::Index i = 0; i < size; ++i) sum -= std::log(factor.matrixL()(i, i));
        }
      }
    }
    return log;
  }

  void write_beacons() {
    std::map<std::array<int, 3>, BeaconMap::Place> places;
    for (const auto& [id, rows] : rows_) {
      const Fit& fit = fits_[id];
      auto& beacon = *map_.add_beacons();
      beacon.set_id(id);
      beacon.set_x(fit.x_m);
      beacon.set_y(fit.y_m);
      beacon.set_exponent(fit.exponent);
      for (const auto& [level, power] : fit.power_dbm) {
        auto& on = *beacon.add_heard();
        on.set_level(level);
        on.set_power(power);
      }
      for (const auto& [key, bin] : bins_of(rows, offsets_, fit)) {
        auto& place = places[key];
        // The place of the first beacon's readings stands for all: a bin is small.
        if (place.readings().empty()) {
          place.set_x(bin.x_m);
          place.set_y(bin.y_m);
          place.set_level(bin.level);
        }
        auto& reading = *place.add_readings();
        reading.set_beacon(static_cast<std::uint32_t>(map_.beacons_size() - 1));
        reading.set_rssi(static_cast<float>(fit.mean_dbm(place.x(), place.y(), bin.level) + bin.residual_db));
        reading.set_count(static_cast<std::uint32_t>(bin.count));
      }
    }
    for (const auto& [key, place] : places) *map_.add_survey() = place;
  }

  void fit_silence() {
    struct Seconds {
      double heard = 0.0, silent = 0.0;
    };
    std::map<long, Seconds> expected;  // by what is usual there, in steps
    for (const SurveySecond& second : survey_) {
      for (const auto& [id, fit] : fits_) {
        if (!fit.power_dbm.contains(second.level)) continue;
        const double mean_dbm = fit.mean_dbm(second.x_m, second.y_m, second.level) + offsets_[second.walk];
        Seconds& seconds = expected[std::lround(mean_dbm / kExpectedStep_db)];
        (second.rssi_dbm.contains(id) ? seconds.heard : seconds.silent) += 1.0;
      }
    }
    double best = -std::numeric_limits<double>::max();
    for (double threshold = -110; threshold <= -60; threshold += 2) {
      for (const double slope : {1.5, 2.5, 4.0, 6.0, 9.0}) {
        for (const double most : {0.3, 0.5, 0.7, 0.85, 0.95, 0.99}) {
          double log = 0.0;
          for (const auto& [step, seconds] : expected) {
            const double mean_dbm = kExpectedStep_db * static_cast<double>(step);
            const double p = most / (1.0 + std::exp((threshold - mean_dbm) / slope));
            log += seconds.heard * std::log(std::max(p, 1e-6)) + seconds.silent * std::log(1.0 - p);
          }
          if (log <= best) continue;
          best = log;
          map_.mutable_radio()->set_threshold(threshold);
          map_.mutable_radio()->set_slope(slope);
          map_.mutable_radio()->set_heard_most(most);
        }
      }
    }
  }

  const std::vector<SurveySecond>& survey_;
  BeaconMap map_;
  std::map<std::string, std::vector<Row>> rows_;
  std::map<std::string, Fit> fits_;
  std::vector<double> offsets_;  ///< of each walk, their mean 0
  double offset_sd_db_ = kOffsetPrior_db;
};

}  // namespace

BeaconMap learn(const std::vector<SurveySecond>& survey, const std::string& name) {
  return Learner(survey, name).learn();
}

}  // namespace fiona::beacons
