#include "fiona/simulator/survey.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>
#include <tuple>
#include <utility>

#include <fiona/error.hpp>

namespace fiona::simulator {
namespace {

using building::Building;
using building::PathPoint;
using building::Point;
using building::Room;
using building::Route;

constexpr double kWallDistance_m = 0.5;
constexpr std::size_t kNearest = 6;

double seconds(milliseconds span) { return static_cast<double>(span.count()) / 1000.0; }

std::string trace_id(std::uint64_t seed, std::uint64_t run) {
  Random random{seed, hash("trace") + run};
  char text[25];
  std::snprintf(text, sizeof(text), "%08x%08x%08x", random.next(), random.next(), random.next());
  return text;
}

/// Different numbers for every walk of a survey: level, kind and count.
std::uint64_t run_number(double level, bool test, std::size_t walk) {
  const auto floor = static_cast<std::uint64_t>(static_cast<std::int64_t>(std::lround(level * 10.0)) + 100'000);
  return (floor << 24u) + (test ? 1u << 20u : 0u) + walk;
}

/// Runs the sensors beside somebody who walks.
class Recorder {
 public:
  Recorder(const Building& building, double level, std::uint64_t seed, std::uint64_t run, bool inertial,
           const SurveyOptions& options)
      : imu_(seed, options.imu, run), radio_(building, seed, options.radio, run), inertial_(inertial) {
    trace_.id = trace_id(seed, run);
    trace_.level = level;
  }

  /// Call it every 5 ms of the walk.
  void record(const Truth& truth) {
    trace_.duration = truth.t;
    if (truth.t % ImuModel::kPeriod != milliseconds{0}) return;
    if (inertial_) trace_.imu.push_back(imu_.sample(truth));
    RadioOutput heard = radio_.advance(truth);
    for (WifiScan& scan : heard.scans) trace_.scans.push_back(std::move(scan));
    for (const BeaconBatch& batch : heard.batches) {
      trace_.beacons.insert(trace_.beacons.end(), batch.readings.begin(), batch.readings.end());
    }
  }

  void add_waypoints(const std::vector<Truth>& waypoints) {
    for (const Truth& p : waypoints) {
      // The end of one leg and the start of the next are one corner, unless one turned in between.
      const bool repeats = !trace_.waypoints.empty() && p.t - trace_.waypoints.back().t < milliseconds{50};
      if (!repeats) trace_.waypoints.push_back(p);
    }
  }

  Trace take() { return std::move(trace_); }

 private:
  ImuModel imu_;
  RadioModel radio_;
  bool inertial_;
  Trace trace_{};
};

double clearance_m(const std::vector<building::Segment>& sides, Point p) {
  double nearest = 1e9;
  for (const building::Segment& side : sides) nearest = std::min(nearest, distance_m(p, side));
  return nearest;
}

/// The middle of each cell of a grid over the room that keeps its distance from the walls; at least the
/// centre.
std::vector<Point> points_in(const Room& room, double spacing_m) {
  const building::Box box = bounds(room.polygon.outer);
  const std::vector<building::Segment> sides = edges(room.polygon);
  const auto cells = [&](double length_m) { return std::max(1, static_cast<int>(std::lround(length_m / spacing_m))); };
  const Point size = box.high - box.low;
  const int columns = cells(size.x_m), rows = cells(size.y_m);
  std::vector<Point> points;
  for (int column = 0; column < columns; ++column) {
    for (int row = 0; row < rows; ++row) {
      const Point p{box.low.x_m + size.x_m * (column + 0.5) / columns, box.low.y_m + size.y_m * (row + 0.5) / rows};
      if (contains(room.polygon, p) && clearance_m(sides, p) >= kWallDistance_m) points.push_back(p);
    }
  }
  if (points.empty()) points.push_back(room.centre);
  return points;
}

/// Takes the goal that is nearest on foot out of `goals`; of those in the air nearest, so that big halls stay
/// cheap.
std::optional<Route> to_nearest(const Building& building, const PathPoint& from, std::vector<Point>& goals) {
  const std::size_t tried = std::min(kNearest, goals.size());
  std::partial_sort(goals.begin(), goals.begin() + static_cast<std::ptrdiff_t>(tried), goals.end(),
                    [&](Point a, Point b) {
                      const double to_a = distance_m(from.at, a), to_b = distance_m(from.at, b);
                      return std::tie(to_a, a.x_m, a.y_m) < std::tie(to_b, b.x_m, b.y_m);
                    });
  std::optional<Route> best;
  std::size_t chosen = 0;
  for (std::size_t i = 0; i < tried; ++i) {
    auto route = building.route(from, {goals[i], from.level});
    if (route && (!best || route->cost_s < best->cost_s)) best = std::move(route), chosen = i;
  }
  if (tried > 0) goals.erase(goals.begin() + static_cast<std::ptrdiff_t>(best ? chosen : 0));
  return best;
}

bool stays_on_level(const Route& route, double level) {
  return std::all_of(route.points.begin(), route.points.end(),
                     [level](const building::RoutePoint& p) { return p.level == level; });
}

/// The ways of a survey of one level, room by room.
class Tour {
 public:
  Tour(const Building& building, double level, double spacing_m) : building_(building), spacing_m_(spacing_m) {
    for (const Room& room : building.rooms()) {
      if (room.level == level && room.kind != building::RoomKind::Lift) rooms_.push_back(&room);
    }
    if (rooms_.empty()) {
      throw Error(ErrorCode::NotFound, {.what = "level " + building::level_text(level) + " of " + building.name() +
                                                " cannot be surveyed: it has no room",
                                        .where = building.name(),
                                        .expected = "rooms or corridors with this level",
                                        .next = "draw them, or survey another level"});
    }
    here_ = {rooms_.front()->centre, level};
  }

  PathPoint here() const { return here_; }

  /// The way to the next point; nothing when all are done. Points without a way on this level are left out.
  std::optional<Route> next() {
    while (true) {
      while (!points_.empty()) {
        auto route = to_nearest(building_, here_, points_);
        if (!route || !stays_on_level(*route, here_.level)) continue;
        here_.at = route->points.back().at;
        return route;
      }
      if (rooms_.empty()) return std::nullopt;
      points_ = points_in(take_nearest_room(), spacing_m_);
    }
  }

 private:
  const Room& take_nearest_room() {
    double best_s = 1e18;
    auto best = rooms_.begin();
    for (auto room = rooms_.begin(); room != rooms_.end(); ++room) {
      const auto route = building_.route(here_, {(*room)->centre, here_.level});
      if (route && route->cost_s < best_s) best = room, best_s = route->cost_s;
    }
    const Room& room = **best;
    rooms_.erase(best);
    return room;
  }

  const Building& building_;
  double spacing_m_;
  std::vector<const Room*> rooms_{};
  std::vector<Point> points_{};
  PathPoint here_{};
};

}  // namespace

std::vector<Trace> survey_walk(const Building& building, double level, std::uint64_t seed,
                               const SurveyOptions& options) {
  std::vector<Trace> traces;
  Tour tour{building, level, options.spacing_m};
  PathPoint start = tour.here();
  for (auto way = tour.next(); way;) {
    const bool inertial = traces.size() < options.inertial_walks;
    Recorder recorder{building, level, seed, run_number(level, false, traces.size()), inertial, options};
    Pedestrian pedestrian{building, start, options.gait};
    // The points are passed without a halt: one route through all of them.
    Route walk{};
    for (; way && walk.cost_s < seconds(options.longest_walk); way = tour.next()) {
      walk.points.insert(walk.points.end(), way->points.begin() + (walk.points.empty() ? 0 : 1), way->points.end());
      walk.cost_s += way->cost_s;
    }
    start = {walk.points.back().at, level};
    pedestrian.follow(walk, milliseconds{0});
    while (!pedestrian.idle()) {
      pedestrian.step();
      recorder.record(pedestrian.truth());
      recorder.add_waypoints(pedestrian.take_waypoints());
    }
    traces.push_back(recorder.take());
  }
  return traces;
}

std::vector<Trace> test_walks(const Building& building, double level, std::uint64_t seed,
                              const SurveyOptions& options) {
  std::vector<Trace> traces;
  for (std::size_t walk = 0; walk < options.test_walks; ++walk) {
    const std::uint64_t run = run_number(level, true, walk);
    Recorder recorder{building, level, seed, run, true, options};
    Walker::Options choice;
    choice.gait = options.gait;
    choice.levels = {level};
    choice.routes = {.stairs = false, .lift = false};
    choice.longest_pause = milliseconds{4000};
    Walker walker{building, seed + run, choice};
    std::vector<Truth> waypoints{walker.truth()};
    for (milliseconds t = Pedestrian::kTick; t <= options.test_duration; t += Pedestrian::kTick) {
      walker.advance(t);
      recorder.record(walker.truth());
      for (Truth& p : walker.take_waypoints()) waypoints.push_back(p);
    }
    waypoints.push_back(walker.truth());
    recorder.add_waypoints(waypoints);
    traces.push_back(recorder.take());
  }
  return traces;
}

}  // namespace fiona::simulator
