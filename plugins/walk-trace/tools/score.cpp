// fiona-score TRUTH.csv TRACK.csv [--trace NAME]: how far off positions were, as a person following them live saw it.
//
// Both files have columns trace,t_ms,x,y,floor (metres, integer floor); the track may have cov_xx,cov_xy,cov_yy (m^2)
// as well, and is then told how true they are. A truth point is compared with the last position at or before it, at
// most five seconds old; without one it counts as not covered.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <fstream>
#include <iostream>
#include <map>
#include <numbers>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/tool.hpp"

namespace {

using fiona::Error;
using fiona::ErrorCode;

constexpr std::int64_t kOldest_ms = 5000;
constexpr double kChiSquare95 = 5.991;  // of two degrees of freedom

struct Point {
  std::int64_t t_ms = 0;
  double x_m = 0;
  double y_m = 0;
  double floor = 0;
  std::optional<std::array<double, 3>> covariance = {};  ///< xx, xy, yy in m^2
};
using Tracks = std::map<std::string, std::vector<Point>>;

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream text(line);
  for (std::string cell; std::getline(text, cell, ',');) cells.push_back(cell);
  if (line.ends_with(',')) cells.emplace_back();
  return cells;
}

double number(const std::string& cell, const std::string& where) {
  std::size_t used = 0;
  try {
    const double value = std::stod(cell, &used);
    if (used == cell.size() && std::isfinite(value)) return value;
  } catch (const std::logic_error&) {  // told below
  }
  throw Error(ErrorCode::Failed,
              {.what = "a number is no number", .where = where, .expected = "a finite number", .found = cell});
}

/// Truth files may have further columns, and their columns may stand in another order.
Tracks read(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) {
    throw Error(ErrorCode::NotFound, {.what = "the file cannot be read, or is empty",
                                      .where = path,
                                      .expected = "a header line, and a line for each place"});
  }
  const auto header = split(line);
  const auto place = [&](const char* name) {
    return static_cast<std::size_t>(std::find(header.begin(), header.end(), name) - header.begin());
  };
  const auto column = [&](const char* name) {
    if (const std::size_t found = place(name); found < header.size()) return found;
    throw Error(ErrorCode::Failed, {.what = std::string("there is no column '") + name + "'",
                                    .where = path + ":1",
                                    .expected = "trace,t_ms,x,y,floor",
                                    .found = line});
  };
  const std::size_t trace = column("trace"), t = column("t_ms"), x = column("x"), y = column("y"),
                    floor = column("floor");
  const std::array<std::size_t, 3> covariance = {place("cov_xx"), place("cov_xy"), place("cov_yy")};
  const bool has_covariance = *std::max_element(covariance.begin(), covariance.end()) < header.size();
  Tracks tracks;
  for (std::size_t row = 2; std::getline(file, line); ++row) {
    const auto cells = split(line);
    const std::string where = path + ":" + std::to_string(row);
    if (cells.size() < header.size())
      throw Error(ErrorCode::Failed, {.what = "the line is cut short",
                                      .where = where,
                                      .expected = std::to_string(header.size()) + " cells",
                                      .found = line});
    Point point{static_cast<std::int64_t>(number(cells[t], where)), number(cells[x], where), number(cells[y], where),
                number(cells[floor], where)};
    if (has_covariance && !cells[covariance[0]].empty()) {
      point.covariance.emplace();
      for (std::size_t i = 0; i < 3; ++i) (*point.covariance)[i] = number(cells[covariance[i]], where);
    }
    tracks[cells[trace]].push_back(point);
  }
  for (auto& [name, points] : tracks) {
    std::stable_sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.t_ms < b.t_ms; });
  }
  return tracks;
}

std::optional<Point> shown_at(const std::vector<Point>& track, std::int64_t t_ms) {
  const auto after = std::upper_bound(track.begin(), track.end(), t_ms,
                                      [](std::int64_t time, const Point& p) { return time < p.t_ms; });
  if (after == track.begin() || t_ms - std::prev(after)->t_ms > kOldest_ms) return std::nullopt;
  return *std::prev(after);
}

double percentile(const std::vector<double>& sorted, double part) {
  const double place = part * static_cast<double>(sorted.size() - 1);
  const auto low = static_cast<std::size_t>(place);
  const std::size_t high = std::min(low + 1, sorted.size() - 1);
  return sorted[low] + (place - static_cast<double>(low)) * (sorted[high] - sorted[low]);
}

/// Errors of the shown positions, and how they lie in their own 95 % regions.
struct Score {
  std::vector<double> errors_m = {};
  std::vector<double> radii_m = {};  ///< of circles as large as the 95 % regions
  std::size_t points = 0, right_floor = 0, inside = 0;
  double log_density = 0.0;                   ///< of the truths, in all
  std::array<double, 3> moments_m2{0, 0, 0};  ///< xx, xy, yy of those errors, in all

  void add(const Point& truth, const Point& shown) {
    const double x = shown.x_m - truth.x_m, y = shown.y_m - truth.y_m;
    errors_m.push_back(std::hypot(x, y));
    if (std::lround(shown.floor) == std::lround(truth.floor)) ++right_floor;
    if (!shown.covariance) return;
    const auto [xx, xy, yy] = *shown.covariance;
    const double determinant = xx * yy - xy * xy;
    if (!(xx > 0.0 && determinant > 0.0)) return;
    radii_m.push_back(std::sqrt(kChiSquare95 * std::sqrt(determinant)));
    const double distance2 = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant;
    if (distance2 <= kChiSquare95) ++inside;
    log_density += log_density_of(distance2, determinant);
    moments_m2[0] += x * x, moments_m2[1] += x * y, moments_m2[2] += y * y;
  }

  /// Of a normal variate of two dimensions, at so many standard deviations, squared.
  static double log_density_of(double distance2, double determinant) {
    return -0.5 * (distance2 + std::log(determinant)) - std::log(2.0 * std::numbers::pi);
  }
  double log_score() const { return log_density / static_cast<double>(radii_m.size()); }
  /// The log score of the constant covariance that is best on these very points: none chosen before can be better.
  double constant_log_score() const {
    const auto n = static_cast<double>(radii_m.size());
    const auto [xx, xy, yy] = moments_m2;
    return log_density_of(2.0, (xx * yy - xy * xy) / (n * n));
  }
};

Score compare(const Tracks& truth, const Tracks& tracks, const std::string& only) {
  Score score;
  for (const auto& [name, expected] : truth) {
    if (!only.empty() && name != only) continue;
    const auto track = tracks.find(name);
    for (const Point& p : expected) {
      ++score.points;
      if (track == tracks.end()) continue;
      if (const auto shown = shown_at(track->second, p.t_ms)) score.add(p, *shown);
    }
  }
  return score;
}

void print(Score score) {
  double sum = 0;
  for (const double e : score.errors_m) sum += e;
  std::sort(score.errors_m.begin(), score.errors_m.end());
  std::sort(score.radii_m.begin(), score.radii_m.end());
  const auto count = static_cast<double>(score.errors_m.size());
  const double median = percentile(score.errors_m, 0.5);
  std::printf("error: mean %.2f m, median %.2f m, p90 %.2f m; right floor %.1f %%; %zu of %zu points covered\n",
              sum / count, median, percentile(score.errors_m, 0.9),
              100.0 * static_cast<double>(score.right_floor) / count, score.errors_m.size(), score.points);
  if (score.radii_m.empty()) return;
  const double radius = percentile(score.radii_m, 0.5);
  std::printf(
      "95 %% region: holds %.1f %% of %zu truths; its median radius is %.2f m, %.2f times the median error; log score "
      "%.2f, of the best constant one %.2f\n",
      100.0 * static_cast<double>(score.inside) / static_cast<double>(score.radii_m.size()), score.radii_m.size(),
      radius, median > 0.0 ? radius / median : 0.0, score.log_score(), score.constant_log_score());
}

/// A few of them, as an error tells them.
std::string names_of(const Tracks& tracks) {
  constexpr std::size_t kMostTold = 5;
  std::string names;
  std::size_t told = 0;
  for (const auto& [name, points] : tracks) {
    if (told == kMostTold) return names + " and " + std::to_string(tracks.size() - kMostTold) + " more";
    names += (told++ > 0 ? ", " : "") + name;
  }
  return names.empty() ? "none" : names;
}

/// Why nothing could be compared.
Error nothing_compared(const Tracks& truth, const std::string& truth_file, const Tracks& tracks,
                       const std::string& track_file, const std::string& only) {
  if (!only.empty() && !truth.contains(only)) {
    return Error(ErrorCode::Failed, {.what = "there is no truth for walk " + only,
                                     .where = truth_file,
                                     .found = names_of(truth),
                                     .next = "--trace NAME with one of these"});
  }
  const bool shared = std::any_of(truth.begin(), truth.end(), [&](const auto& one) {
    return (only.empty() || one.first == only) && tracks.contains(one.first);
  });
  if (!shared && !tracks.empty()) {
    return Error(ErrorCode::Failed,
                 {.what = "the track has no walk of a name that the truth has",
                  .where = track_file,
                  .expected = only.empty() ? names_of(truth) : only,
                  .found = names_of(tracks),
                  .next = "load track-recorder with trace=NAME, or name it so in the column 'trace'"});
  }
  return Error(ErrorCode::Failed,
               {.what = "not one position was given",
                .where = track_file,
                .next = "see the log: a radio map of another building, or a walk without radio, gives none"});
}

int run(const std::string& truth_file, const std::string& track_file, const std::string& only) {
  const Tracks truth = read(truth_file), tracks = read(track_file);
  const Score score = compare(truth, tracks, only);
  if (score.errors_m.empty()) throw nothing_compared(truth, truth_file, tracks, track_file, only);
  print(score);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const bool help = argc == 2 && (argv[1] == std::string("--help") || argv[1] == std::string("-h"));
  const bool one = argc == 5 && std::string(argv[3]) == "--trace";
  if (help || (argc != 3 && !one)) {
    (help ? std::cout : std::cerr)
        << "usage: fiona-score TRUTH.csv TRACK.csv [--trace NAME]\n"
           "How far off the positions of TRACK are; both have columns trace,t_ms,x,y,floor.\n";
    return help ? 0 : static_cast<int>(fiona::ErrorCode::Usage);
  }
  return fiona::run_tool([&] { return run(argv[1], argv[2], one ? argv[4] : ""); });
}
