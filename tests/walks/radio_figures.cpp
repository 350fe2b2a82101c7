#include "radio_figures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <utility>

namespace fiona::walks {
namespace {

constexpr double kStill_m = 0.1;
constexpr double kSamePlace_m = 1.0, kRevisit_s = 10.0;
constexpr double kHeardOn_s = 3.0;  ///< a beacon that was not heard for longer may be out of reach
constexpr double kStrong_dbm = -80.0;
constexpr std::size_t kOneOf = 4;  ///< readings is enough where there are many: for a fit, and for pairs
constexpr double kGrid_m = 2.0, kMargin_m = 10.0;

struct Reading {
  double t_s, rssi_dbm;
  walk::WayPoint at;
  bool walks;
  double left_db = 0.0;  ///< of the path loss
};

/// What one walk heard of one beacon, in the order of time.
struct Heard {
  std::size_t walk;
  std::string beacon;
  std::vector<Reading> readings;
};

std::optional<bool> walks_at(const radio::Journey& journey, std::int64_t t_ms) {
  const auto before = walk::position_at(journey.way_points, t_ms - 500);
  const auto after = walk::position_at(journey.way_points, t_ms + 500);
  if (!before || !after) return std::nullopt;
  return std::hypot(after->x_m - before->x_m, after->y_m - before->y_m) > kStill_m;
}

std::vector<Heard> heard_by(const std::vector<radio::Journey>& walks) {
  std::vector<Heard> all;
  for (std::size_t i = 0; i < walks.size(); ++i) {
    const auto& way = walks[i].way_points;
    std::map<std::string, std::vector<Reading>> beacons;
    for (const auto& told : walks[i].told) {
      const auto* row = std::get_if<radio::Journey::Row>(&told.what);
      const std::int64_t t_ms = told.time.count();
      if (row == nullptr || row->radio != radio::Radio::Bluetooth || way.empty()) continue;
      if (t_ms < way.front().first || t_ms > way.back().first) continue;
      const auto at = walk::position_at(way, t_ms);
      const auto moves = walks_at(walks[i], t_ms);
      if (!at || !moves) continue;
      beacons[walks[i].transmitters[row->transmitter]].push_back(
          {static_cast<double>(t_ms) / 1000.0, row->rssi_dbm, *at, *moves});
    }
    for (auto& [beacon, readings] : beacons) all.push_back({i, beacon, std::move(readings)});
  }
  return all;
}

/// Halves of squared differences, and their number.
struct Pairs {
  double squares = 0.0, count = 0.0;
  void add(double difference) { squares += 0.5 * difference * difference, count += 1.0; }
  double sd() const { return count > 0.0 ? std::sqrt(squares / count) : NAN; }
};

std::optional<std::size_t> lag_of(double apart_s) {
  for (std::size_t i = 0; i < RadioFigures::kLags_s.size(); ++i) {
    const double lag_s = RadioFigures::kLags_s[i];
    if (std::abs(apart_s - lag_s) <= std::min(0.12, 0.25 * lag_s)) return i;
  }
  return std::nullopt;
}

/// fn(a, b, lag) for each two readings of a beacon on a walk that are a lag apart, both walking or both standing.
template <class F>
void for_each_lag(const std::vector<Heard>& all, const F& fn) {
  for (const Heard& heard : all) {
    const auto& readings = heard.readings;
    for (std::size_t i = 0; i < readings.size(); ++i) {
      for (std::size_t j = i + 1; j < readings.size(); ++j) {
        const double apart_s = readings[j].t_s - readings[i].t_s;
        if (apart_s > RadioFigures::kLags_s.back() + 0.2) break;
        const auto lag = lag_of(apart_s);
        if (lag && readings[i].walks == readings[j].walks) fn(readings[i], readings[j], *lag);
      }
    }
  }
}

void fit_lags(const std::vector<Heard>& all, RadioFigures& figures) {
  std::array<Pairs, RadioFigures::kLags_s.size()> walking, standing;
  std::array<double, RadioFigures::kLags_s.size()> products{}, squares{};
  for_each_lag(all, [&](const Reading& a, const Reading& b, std::size_t lag) {
    (a.walks ? walking : standing)[lag].add(a.rssi_dbm - b.rssi_dbm);
    if (!a.walks) return;
    products[lag] += a.left_db * b.left_db;
    squares[lag] += 0.5 * (a.left_db * a.left_db + b.left_db * b.left_db);
  });
  for (std::size_t lag = 0; lag < RadioFigures::kLags_s.size(); ++lag) {
    figures.walking_db[lag] = walking[lag].sd();
    figures.standing_db[lag] = standing[lag].sd();
    figures.correlation[lag] = products[lag] / squares[lag];
  }
}

double spread_in_seconds(const std::vector<Heard>& all) {
  double squares = 0.0, freedom = 0.0;
  for (const Heard& heard : all) {
    std::map<std::int64_t, std::vector<double>> seconds;
    for (const Reading& one : heard.readings) {
      if (one.walks) seconds[static_cast<std::int64_t>(one.t_s)].push_back(one.rssi_dbm);
    }
    for (const auto& [second, values] : seconds) {
      double sum = 0.0, sum2 = 0.0;
      for (const double value : values) sum += value, sum2 += value * value;
      const auto n = static_cast<double>(values.size());
      squares += sum2 - sum * sum / n;
      freedom += n - 1.0;
    }
  }
  return std::sqrt(squares / freedom);
}

/// The log-distance path loss of one beacon on one level, wherever it is.
struct PathLoss {
  double x_m = 0.0, y_m = 0.0, power_dbm = 0.0, slope_db = 0.0;
  double squares = std::numeric_limits<double>::max();
  double loss(const walk::WayPoint& at) const {
    return std::log10(1.0 + (at.x_m - x_m) * (at.x_m - x_m) + (at.y_m - y_m) * (at.y_m - y_m));
  }
  double mean_dbm(const walk::WayPoint& at) const { return power_dbm + slope_db * loss(at); }
};

PathLoss fit_at(double x_m, double y_m, const std::vector<const Reading*>& readings) {
  PathLoss fit{.x_m = x_m, .y_m = y_m};
  double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
  for (std::size_t i = 0; i < readings.size(); i += kOneOf) {
    const double loss = fit.loss(readings[i]->at), rssi = readings[i]->rssi_dbm;
    n += 1.0, x += loss, y += rssi, xx += loss * loss, xy += loss * rssi, yy += rssi * rssi;
  }
  const double spread = xx - x * x / n;
  fit.slope_db = spread > 1e-9 ? std::min(0.0, (xy - x * y / n) / spread) : 0.0;
  fit.power_dbm = (y - fit.slope_db * x) / n;
  fit.squares = yy - y * y / n - 2.0 * fit.slope_db * (xy - x * y / n) + fit.slope_db * fit.slope_db * spread;
  return fit;
}

PathLoss fit(const std::vector<const Reading*>& readings) {
  double west = 1e9, east = -1e9, south = 1e9, north = -1e9;
  for (const Reading* one : readings) {
    west = std::min(west, one->at.x_m), east = std::max(east, one->at.x_m);
    south = std::min(south, one->at.y_m), north = std::max(north, one->at.y_m);
  }
  PathLoss best;
  for (double x = west - kMargin_m; x <= east + kMargin_m; x += kGrid_m) {
    for (double y = south - kMargin_m; y <= north + kMargin_m; y += kGrid_m) {
      const PathLoss here = fit_at(x, y, readings);
      if (here.squares < best.squares) best = here;
    }
  }
  return best;
}

/// What is left of the path loss of each beacon on each level, and of the walk: some receivers read more than others.
void fit_path_loss(std::vector<Heard>& all, RadioFigures& figures) {
  std::map<std::pair<std::string, int>, std::vector<const Reading*>> beacons;
  for (const Heard& heard : all) {
    for (const Reading& one : heard.readings) {
      if (one.walks) beacons[{heard.beacon, one.at.level}].push_back(&one);
    }
  }
  std::map<std::pair<std::string, int>, PathLoss> fits;
  for (const auto& [beacon, readings] : beacons) fits[beacon] = fit(readings);
  std::map<std::size_t, std::pair<double, double>> walks;
  for (Heard& heard : all) {
    for (Reading& one : heard.readings) {
      const auto found = fits.find({heard.beacon, one.at.level});
      if (found == fits.end() || !one.walks) continue;
      one.left_db = one.rssi_dbm - found->second.mean_dbm(one.at);
      walks[heard.walk].first += one.left_db;
      walks[heard.walk].second += 1.0;
    }
  }
  double squares = 0.0, count = 0.0, mean2 = 0.0;
  for (const auto& [walk, sum] : walks) mean2 += sum.first / sum.second * sum.first / sum.second;
  for (Heard& heard : all) {
    for (Reading& one : heard.readings) {
      if (!one.walks) continue;
      one.left_db -= walks[heard.walk].first / walks[heard.walk].second;
      squares += one.left_db * one.left_db, count += 1.0;
    }
  }
  figures.walks_db = std::sqrt(mean2 / static_cast<double>(walks.size()));
  figures.path_loss_db = std::sqrt(squares / count);
}

bool same_place(const Reading& a, const Reading& b) {
  return a.at.level == b.at.level && std::hypot(a.at.x_m - b.at.x_m, a.at.y_m - b.at.y_m) <= kSamePlace_m;
}

/// By the mean of each visit's readings there would be less noise, but also none to compare with that of a second.
void fit_revisits(const std::vector<Heard>& all, RadioFigures& figures) {
  std::map<std::string, std::vector<const Heard*>> beacons;
  for (const Heard& heard : all) beacons[heard.beacon].push_back(&heard);
  Pairs same_walk;
  // Differences of two walks, of all beacons: less by their mean.
  std::map<std::pair<std::size_t, std::size_t>, std::vector<double>> walks;
  for (const auto& [beacon, heards] : beacons) {
    for (std::size_t one = 0; one < heards.size(); ++one) {
      for (std::size_t other = one; other < heards.size(); ++other) {
        for (std::size_t i = 0; i < heards[one]->readings.size(); i += kOneOf) {
          const Reading& a = heards[one]->readings[i];
          for (const Reading& b : heards[other]->readings) {
            if (!a.walks || !b.walks || !same_place(a, b)) continue;
            if (one != other) {
              walks[{heards[one]->walk, heards[other]->walk}].push_back(a.rssi_dbm - b.rssi_dbm);
            } else if (b.t_s - a.t_s >= kRevisit_s) {
              same_walk.add(a.rssi_dbm - b.rssi_dbm);
            }
          }
        }
      }
    }
  }
  Pairs other_walk;
  for (const auto& [pair, differences] : walks) {
    double mean = 0.0;
    for (const double one : differences) mean += one / static_cast<double>(differences.size());
    for (const double one : differences) other_walk.add(one - mean);
  }
  figures.revisit_db = same_walk.sd();
  figures.other_walk_db = other_walk.sd();
}

/// A beacon's period is the gap that is usual where nothing was missed.
void count_missed(const std::vector<Heard>& all, RadioFigures& figures) {
  double heard = 0.0, missed = 0.0, strong_heard = 0.0, strong_missed = 0.0;
  for (const Heard& one : all) {
    std::vector<double> gaps;
    for (std::size_t i = 1; i < one.readings.size(); ++i) gaps.push_back(one.readings[i].t_s - one.readings[i - 1].t_s);
    if (gaps.size() < 20) continue;
    std::vector<double> sorted = gaps;
    std::sort(sorted.begin(), sorted.end());
    const double least = sorted[sorted.size() / 20];
    const auto usual = std::upper_bound(sorted.begin(), sorted.end(), 1.5 * least) - sorted.begin();
    const double period = sorted[static_cast<std::size_t>(usual) / 2];
    for (std::size_t i = 0; i < gaps.size(); ++i) {
      if (gaps[i] > kHeardOn_s) continue;
      const double lost = std::max(0.0, std::round(gaps[i] / period) - 1.0);
      heard += 1.0, missed += lost;
      if (std::min(one.readings[i].rssi_dbm, one.readings[i + 1].rssi_dbm) < kStrong_dbm) continue;
      strong_heard += 1.0, strong_missed += lost;
    }
  }
  figures.missed = missed / (missed + heard);
  figures.missed_of_strong = strong_missed / (strong_missed + strong_heard);
}

}  // namespace

RadioFigures figures_of(const std::vector<radio::Journey>& walks) {
  RadioFigures figures;
  std::vector<Heard> all = heard_by(walks);
  for (const Heard& heard : all) figures.readings += heard.readings.size();
  figures.second_db = spread_in_seconds(all);
  fit_path_loss(all, figures);
  fit_lags(all, figures);
  fit_revisits(all, figures);
  count_missed(all, figures);
  return figures;
}

}  // namespace fiona::walks
