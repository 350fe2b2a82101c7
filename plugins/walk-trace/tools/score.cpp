// fiona-score TRUTH.csv TRACK.csv [--trace NAME]: how far off positions were, as a person following them live saw it.
//
// Both files have columns trace,t_ms,x,y,floor (metres, integer floor). A truth point is compared with the last position
// at or before it, at most five seconds old; without one it counts as not covered.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <fstream>
#include <iostream>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "fiona/error.hpp"

namespace {

using fiona::Error;
using fiona::ErrorCode;

constexpr std::int64_t kOldest_ms = 5000;

struct Point {
  std::int64_t t_ms = 0;
  double x_m = 0;
  double y_m = 0;
  double floor = 0;
};
using Tracks = std::map<std::string, std::vector<Point>>;

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream text(line);
  for (std::string cell; std::getline(text, cell, ',');) cells.push_back(cell);
  return cells;
}

double number(const std::string& cell, const std::string& where) {
  std::size_t used = 0;
  try {
    const double value = std::stod(cell, &used);
    if (used == cell.size() && std::isfinite(value)) return value;
  } catch (const std::logic_error&) {  // told below
  }
  throw Error(ErrorCode::Failed, {.what = "a number is no number", .where = where, .found = cell});
}

/// Truth files may have further columns, and their columns may stand in another order.
Tracks read(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) {
    throw Error(ErrorCode::NotFound, {.what = "the file cannot be read, or is empty", .where = path});
  }
  const auto header = split(line);
  const auto column = [&](const char* name) {
    const auto found = std::find(header.begin(), header.end(), name);
    if (found != header.end()) return static_cast<std::size_t>(found - header.begin());
    throw Error(ErrorCode::Failed, {.what = std::string("there is no column '") + name + "'",
                                    .where = path + ":1",
                                    .expected = "trace,t_ms,x,y,floor",
                                    .found = line});
  };
  const std::size_t trace = column("trace"), t = column("t_ms"), x = column("x"), y = column("y"), floor = column("floor");
  Tracks tracks;
  for (std::size_t row = 2; std::getline(file, line); ++row) {
    const auto cells = split(line);
    const std::string where = path + ":" + std::to_string(row);
    if (cells.size() < header.size()) throw Error(ErrorCode::Failed, {.what = "the line is cut short", .where = where, .found = line});
    tracks[cells[trace]].push_back({static_cast<std::int64_t>(number(cells[t], where)), number(cells[x], where),
                                    number(cells[y], where), number(cells[floor], where)});
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

int score(const std::string& truth_file, const std::string& track_file, const std::string& only) {
  const Tracks truth = read(truth_file);
  const Tracks tracks = read(track_file);
  std::vector<double> errors;
  std::size_t points = 0, right_floor = 0;
  for (const auto& [name, expected] : truth) {
    if (!only.empty() && name != only) continue;
    const auto track = tracks.find(name);
    for (const Point& p : expected) {
      ++points;
      const auto shown = track == tracks.end() ? std::nullopt : shown_at(track->second, p.t_ms);
      if (!shown) continue;
      errors.push_back(std::hypot(shown->x_m - p.x_m, shown->y_m - p.y_m));
      if (std::lround(shown->floor) == std::lround(p.floor)) ++right_floor;
    }
  }
  if (errors.empty()) {
    throw Error(ErrorCode::Failed,
                {.what = points == 0 ? "there is no truth for this walk" : "not one position was given",
                 .where = points == 0 ? truth_file : track_file,
                 .next = points == 0 ? "name a test walk: fiona-walks DIR lists them"
                                     : "see the log: a radio map of another building, or a walk without radio, gives none"});
  }
  double sum = 0;
  for (const double e : errors) sum += e;
  std::sort(errors.begin(), errors.end());
  const auto count = static_cast<double>(errors.size());
  std::printf("error: mean %.2f m, median %.2f m, p90 %.2f m; right floor %.1f %%; %zu of %zu points covered\n", sum / count,
              percentile(errors, 0.5), percentile(errors, 0.9), 100.0 * static_cast<double>(right_floor) / count,
              errors.size(), points);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const bool one = argc == 5 && std::string(argv[3]) == "--trace";
  if (argc != 3 && !one) {
    std::cerr << "usage: fiona-score TRUTH.csv TRACK.csv [--trace NAME]\n";
    return 2;
  }
  try {
    return score(argv[1], argv[2], one ? argv[4] : "");
  } catch (const Error& error) {
    std::cerr << "error: " << error.what() << "\n";
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    std::cerr << "error: " << error.what() << "\n";
    return 1;
  }
}
