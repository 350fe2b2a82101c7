#include "floor_plan.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace fiona::beacons {
namespace {

constexpr double kBucket_m = 2.0;
constexpr double kMostBuckets = 4'000'000.0;
constexpr int kMostSteps = 64;  // of a chain of stairs over landings

int whole(double level) { return static_cast<int>(std::lround(std::clamp(level, -1000.0, 1000.0))); }

bool inside(const navigation::MapRing& ring, double x, double y) {
  bool in = false;
  const int n = std::min(ring.x_size(), ring.y_size());
  for (int i = 0, j = n - 1; i < n; j = i++) {
    if ((ring.y(i) > y) == (ring.y(j) > y)) continue;
    in ^= x < (ring.x(j) - ring.x(i)) * (y - ring.y(i)) / (ring.y(j) - ring.y(i)) + ring.x(i);
  }
  return in;
}

double side(double ax, double ay, double bx, double by, double px, double py) {
  return (bx - ax) * (py - ay) - (by - ay) * (px - ax);
}

bool joins_levels(const navigation::MapEdge& edge) {
  switch (edge.kind()) {
    case navigation::MapEdge::STAIRS:
    case navigation::MapEdge::ESCALATOR:
    case navigation::MapEdge::RAMP:
    case navigation::MapEdge::LIFT: return true;
    default: return false;
  }
}

}  // namespace

FloorPlan::FloorPlan(const navigation::CommLevelMap& map) {
  for (const auto& wall : map.walls()) {
    level_at(wall.level(), wall.x2(), wall.y2());
    level_at(wall.level(), wall.x1(), wall.y1()).walls.push_back({wall.x1(), wall.y1(), wall.x2(), wall.y2()});
  }
  for (const auto& room : map.rooms()) {
    const auto& ring = room.outline();
    if (std::min(ring.x_size(), ring.y_size()) < 3) continue;
    for (int i = 0; i < std::min(ring.x_size(), ring.y_size()); ++i) level_at(room.level(), ring.x(i), ring.y(i));
    level_at(room.level(), ring.x(0), ring.y(0)).rooms.push_back(room);
  }
  std::sort(levels_.begin(), levels_.end(), [](const Level& a, const Level& b) { return a.level < b.level; });
  for (Level& level : levels_) fill_buckets(level);
  read_graph(map);
}

FloorPlan::Level& FloorPlan::level_at(double level, double x, double y) {
  auto found = std::find_if(levels_.begin(), levels_.end(), [&](const Level& l) { return l.level == whole(level); });
  if (found == levels_.end()) {
    levels_.push_back({.level = whole(level), .extent = {whole(level), x, y, x, y}});
    found = levels_.end() - 1;
  }
  Extent& e = found->extent;
  e = {e.level, std::min(e.low_x_m, x), std::min(e.low_y_m, y), std::max(e.high_x_m, x), std::max(e.high_y_m, y)};
  return *found;
}

void FloorPlan::fill_buckets(Level& level) {
  const double width = (level.extent.high_x_m - level.extent.low_x_m) / kBucket_m + 1;
  const double height = (level.extent.high_y_m - level.extent.low_y_m) / kBucket_m + 1;
  if (!(width * height <= kMostBuckets)) return;  // no building: walls are then looked at one by one
  level.columns = static_cast<std::uint32_t>(width);
  level.rows = static_cast<std::uint32_t>(height);
  std::vector<std::vector<std::uint32_t>> buckets(std::size_t{level.columns} * level.rows);
  const auto index = [&](double m, double low, std::uint32_t count) {
    return static_cast<std::uint32_t>(std::clamp((m - low) / kBucket_m, 0.0, count - 1.0));
  };
  for (std::uint32_t i = 0; i < level.walls.size(); ++i) {
    const Wall& w = level.walls[i];
    const auto [x1, x2] = std::minmax(
        {index(w.x1_m, level.extent.low_x_m, level.columns), index(w.x2_m, level.extent.low_x_m, level.columns)});
    const auto [y1, y2] =
        std::minmax({index(w.y1_m, level.extent.low_y_m, level.rows), index(w.y2_m, level.extent.low_y_m, level.rows)});
    for (std::uint32_t y = y1; y <= y2; ++y) {
      for (std::uint32_t x = x1; x <= x2; ++x) buckets[std::size_t{y} * level.columns + x].push_back(i);
    }
  }
  for (const auto& bucket : buckets) {
    level.first.push_back(static_cast<std::uint32_t>(level.in_bucket.size()));
    level.in_bucket.insert(level.in_bucket.end(), bucket.begin(), bucket.end());
  }
  level.first.push_back(static_cast<std::uint32_t>(level.in_bucket.size()));
}

/// Stairs may go over nodes on landings: each chain of them from one whole level to the next is one way.
void FloorPlan::read_graph(const navigation::CommLevelMap& map) {
  std::map<std::uint32_t, std::vector<std::uint32_t>> next;
  const auto nodes = static_cast<std::uint32_t>(map.nodes_size());
  for (const auto& edge : map.edges()) {
    if (!joins_levels(edge) || edge.from() >= nodes || edge.to() >= nodes) continue;
    next[edge.from()].push_back(edge.to());
    if (!edge.one_way()) next[edge.to()].push_back(edge.from());
  }
  for (const auto& [start, unused] : next) {
    const auto& from = map.nodes(static_cast<int>(start));
    if (from.level() != std::floor(from.level())) continue;
    std::vector<std::uint32_t> seen{start};
    for (std::size_t i = 0; i < seen.size() && i < kMostSteps; ++i) {
      const auto& at = map.nodes(static_cast<int>(seen[i]));
      if (whole(at.level()) != whole(from.level()) && at.level() == std::floor(at.level())) {
        ways_.push_back({whole(from.level()), whole(at.level()), from.x(), from.y(), at.x(), at.y()});
        continue;
      }
      for (const std::uint32_t to : next[seen[i]]) {
        if (std::find(seen.begin(), seen.end(), to) == seen.end()) seen.push_back(to);
      }
    }
  }
}

const FloorPlan::Level* FloorPlan::find(int level) const {
  const auto found = std::lower_bound(levels_.begin(), levels_.end(), level,
                                      [](const Level& l, int wanted) { return l.level < wanted; });
  return found != levels_.end() && found->level == level ? &*found : nullptr;
}

bool FloorPlan::wall_between(int level_number, double x1, double y1, double x2, double y2) const {
  const Level* level = find(level_number);
  if (level == nullptr || level->walls.empty()) return false;
  const auto crosses = [&](const Wall& w) {
    return (side(w.x1_m, w.y1_m, w.x2_m, w.y2_m, x1, y1) > 0) != (side(w.x1_m, w.y1_m, w.x2_m, w.y2_m, x2, y2) > 0) &&
           (side(x1, y1, x2, y2, w.x1_m, w.y1_m) > 0) != (side(x1, y1, x2, y2, w.x2_m, w.y2_m) > 0);
  };
  if (level->columns == 0) return std::any_of(level->walls.begin(), level->walls.end(), crosses);
  const auto index = [&](double m, double low, std::uint32_t count) {
    return static_cast<std::uint32_t>(std::clamp((m - low) / kBucket_m, 0.0, count - 1.0));
  };
  const auto [west, east] =
      std::minmax({index(x1, level->extent.low_x_m, level->columns), index(x2, level->extent.low_x_m, level->columns)});
  const auto [south, north] =
      std::minmax({index(y1, level->extent.low_y_m, level->rows), index(y2, level->extent.low_y_m, level->rows)});
  for (std::uint32_t y = south; y <= north; ++y) {
    for (std::uint32_t x = west; x <= east; ++x) {
      const std::size_t bucket = std::size_t{y} * level->columns + x;
      for (std::uint32_t i = level->first[bucket]; i < level->first[bucket + 1]; ++i) {
        if (crosses(level->walls[level->in_bucket[i]])) return true;
      }
    }
  }
  return false;
}

bool FloorPlan::may_be_at(int level_number, double x, double y) const {
  const Level* level = find(level_number);
  if (level == nullptr || level->rooms.empty()) return true;
  return std::any_of(level->rooms.begin(), level->rooms.end(), [&](const navigation::MapRoom& room) {
    return inside(room.outline(), x, y) &&
           std::none_of(room.holes().begin(), room.holes().end(),
                        [&](const navigation::MapRing& hole) { return inside(hole, x, y); });
  });
}

std::vector<Extent> FloorPlan::extents() const {
  std::vector<Extent> result;
  for (const Level& level : levels_) result.push_back(level.extent);
  return result;
}

}  // namespace fiona::beacons
