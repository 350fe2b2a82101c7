#include "floor_plan.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr double kBucket_m = 2.0;
// A map is from another component: what is more than these is no building, or not to be worked through in a handler.
constexpr std::size_t kMostLevels = 256;
constexpr double kMostBuckets = 1'000'000.0;      // of all levels
constexpr std::size_t kMostInBuckets = 8u << 20;  // of all levels
constexpr double kMostCorners = 5e7;              // of rooms, each as often as the buckets that it touches
constexpr std::size_t kMostWays = 4096;
constexpr int kNobody = 10;             // of MapRoom.access
constexpr std::size_t kMostSteps = 64;  // of a chain of stairs over landings

[[noreturn]] void refuse(const std::string& what, const std::string& expected, const std::string& found) {
  throw Error(ErrorCode::Failed, {.what = "the level map " + what,
                                  .expected = expected,
                                  .found = found,
                                  .next = "ask for a map of one building, with its own provider of LevelMap"});
}

struct Box {
  double low_x_m, low_y_m, high_x_m, high_y_m;
};

Box box_of(const navigation::MapRing& ring) {
  Box box{ring.x(0), ring.y(0), ring.x(0), ring.y(0)};
  for (int i = 1; i < std::min(ring.x_size(), ring.y_size()); ++i) {
    box = {std::min(box.low_x_m, ring.x(i)), std::min(box.low_y_m, ring.y(i)), std::max(box.high_x_m, ring.x(i)),
           std::max(box.high_y_m, ring.y(i))};
  }
  return box;
}

double corners_of(const navigation::MapRoom& room) {
  double corners = room.outline().x_size();
  for (const auto& hole : room.holes()) corners += hole.x_size();
  return corners;
}

std::uint32_t bucket_index(double m, double low, std::uint32_t count) {
  return static_cast<std::uint32_t>(std::clamp((m - low) / kBucket_m, 0.0, count - 1.0));
}

/// A position has a whole level: what lies between two, a mezzanine, is on neither of them.
bool is_whole(double level) { return level == std::round(level); }

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
    if (!is_whole(wall.level())) continue;
    level_at(wall.level(), wall.x2(), wall.y2());
    level_at(wall.level(), wall.x1(), wall.y1()).walls.push_back({wall.x1(), wall.y1(), wall.x2(), wall.y2()});
  }
  for (const auto& room : map.rooms()) {
    const auto& ring = room.outline();
    if (!is_whole(room.level()) || std::min(ring.x_size(), ring.y_size()) < 3) continue;
    for (int i = 0; i < std::min(ring.x_size(), ring.y_size()); ++i) level_at(room.level(), ring.x(i), ring.y(i));
    level_at(room.level(), ring.x(0), ring.y(0)).rooms.push_back(room);
  }
  for (const auto& told : map.levels()) {
    if (!is_whole(told.level())) continue;
    for (Level& level : levels_) level.floor_m = level.level == whole(told.level()) ? told.floor() : level.floor_m;
  }
  std::sort(levels_.begin(), levels_.end(), [](const Level& a, const Level& b) { return a.level < b.level; });
  fill_buckets();
  read_graph(map);
}

std::optional<double> FloorPlan::rise_m(int from_level, int to_level) const {
  if (from_level == to_level) return 0.0;
  const Level *from = find(from_level), *to = find(to_level);
  if (from == nullptr || to == nullptr || from->floor_m == to->floor_m) return std::nullopt;
  return to->floor_m - from->floor_m;
}

FloorPlan::Level& FloorPlan::level_at(double level, double x, double y) {
  auto found = std::find_if(levels_.begin(), levels_.end(), [&](const Level& l) { return l.level == whole(level); });
  if (found == levels_.end()) {
    if (levels_.size() == kMostLevels) refuse("has too many levels", "at most " + std::to_string(kMostLevels), "more");
    levels_.push_back({.level = whole(level), .extent = {whole(level), x, y, x, y}});
    found = levels_.end() - 1;
  }
  Extent& e = found->extent;
  e = {e.level, std::min(e.low_x_m, x), std::min(e.low_y_m, y), std::max(e.high_x_m, x), std::max(e.high_y_m, y)};
  return *found;
}

void FloorPlan::fill_buckets() {
  double buckets = 0.0, corners = 0.0;
  std::size_t in_buckets = 0;
  const auto fill = [&](const Level& level, const std::vector<Box>& boxes, Buckets& into) {
    std::vector<std::vector<std::uint32_t>> lists(std::size_t{level.columns} * level.rows);
    for (std::uint32_t i = 0; i < boxes.size(); ++i) {
      const std::uint32_t x1 = bucket_index(boxes[i].low_x_m, level.extent.low_x_m, level.columns);
      const std::uint32_t x2 = bucket_index(boxes[i].high_x_m, level.extent.low_x_m, level.columns);
      const std::uint32_t y1 = bucket_index(boxes[i].low_y_m, level.extent.low_y_m, level.rows);
      const std::uint32_t y2 = bucket_index(boxes[i].high_y_m, level.extent.low_y_m, level.rows);
      in_buckets += std::size_t{x2 - x1 + 1} * (y2 - y1 + 1);
      if (in_buckets > kMostInBuckets) {
        refuse("has too many long walls and large rooms", "those of one building", "more");
      }
      for (std::uint32_t y = y1; y <= y2; ++y) {
        for (std::uint32_t x = x1; x <= x2; ++x) lists[std::size_t{y} * level.columns + x].push_back(i);
      }
      if (&into != &level.rooms_near) continue;
      corners += corners_of(level.rooms[i]) * (x2 - x1 + 1.0) * (y2 - y1 + 1.0);
      if (corners > kMostCorners) refuse("has rooms of too many corners", "outlines of rooms", "too fine ones");
    }
    for (const auto& list : lists) {
      into.first.push_back(static_cast<std::uint32_t>(into.items.size()));
      into.items.insert(into.items.end(), list.begin(), list.end());
    }
    into.first.push_back(static_cast<std::uint32_t>(into.items.size()));
  };
  for (Level& level : levels_) {
    const double columns = std::floor((level.extent.high_x_m - level.extent.low_x_m) / kBucket_m) + 1;
    const double rows = std::floor((level.extent.high_y_m - level.extent.low_y_m) / kBucket_m) + 1;
    buckets += columns * rows;
    if (!(buckets <= kMostBuckets)) {
      refuse("is larger than a building", "at most " + std::to_string(kMostBuckets * kBucket_m * kBucket_m) + " m2",
             std::to_string(buckets * kBucket_m * kBucket_m) + " m2");
    }
    level.columns = static_cast<std::uint32_t>(columns);
    level.rows = static_cast<std::uint32_t>(rows);
    std::vector<Box> walls, rooms;
    for (const Wall& w : level.walls) {
      walls.push_back(
          {std::min(w.x1_m, w.x2_m), std::min(w.y1_m, w.y2_m), std::max(w.x1_m, w.x2_m), std::max(w.y1_m, w.y2_m)});
    }
    for (const auto& room : level.rooms) {
      const Box& box = rooms.emplace_back(box_of(room.outline()));
      if (room.access() < kNobody) continue;
      level.closed.push_back({{level.level, box.low_x_m, box.low_y_m, box.high_x_m, box.high_y_m}, rooms.size() - 1});
    }
    fill(level, walls, level.walls_near);
    fill(level, rooms, level.rooms_near);
  }
}

/// Stairs may go over nodes on landings: each chain of them from one whole level to the next is one way.
void FloorPlan::read_graph(const navigation::CommLevelMap& map) {
  struct By {
    bool lift = false, escalator = false;
  };
  std::map<std::uint32_t, std::map<std::uint32_t, By>> next;
  const auto nodes = static_cast<std::uint32_t>(map.nodes_size());
  for (const auto& edge : map.edges()) {
    if (!joins_levels(edge) || edge.from() >= nodes || edge.to() >= nodes) continue;
    for (const auto& [from, to] : {std::pair(edge.from(), edge.to()), std::pair(edge.to(), edge.from())}) {
      if (edge.one_way() && from != edge.from()) continue;
      By& by = next[from][to];
      by.lift |= edge.kind() == navigation::MapEdge::LIFT;
      by.escalator |= edge.kind() == navigation::MapEdge::ESCALATOR;
    }
  }
  for (const auto& [start, unused] : next) {
    const auto& from = map.nodes(static_cast<int>(start));
    if (!is_whole(from.level())) continue;
    std::vector<std::pair<std::uint32_t, std::size_t>> seen{{start, 0}};  // and whence
    for (std::size_t i = 0; i < seen.size(); ++i) {
      const auto& at = map.nodes(static_cast<int>(seen[i].first));
      if (whole(at.level()) != whole(from.level()) && is_whole(at.level())) {
        if (ways_.size() == kMostWays)
          refuse("has too many stairs and lifts", std::to_string(kMostWays) + " ways", "more");
        Way way{whole(from.level()), whole(at.level()), {}, true};
        for (std::size_t j = i;; j = seen[j].second) {
          const auto& node = map.nodes(static_cast<int>(seen[j].first));
          way.path.insert(way.path.begin(), {node.x(), node.y(), node.level(), 0.0});
          if (j == 0) break;
          const By& by = next[seen[seen[j].second].first][seen[j].first];
          way.by_lift = way.by_lift && by.lift;
          way.conveys = way.conveys || by.escalator;
        }
        for (std::size_t j = 1; j < way.path.size(); ++j) {
          const Way::Place& before = way.path[j - 1];
          way.path[j].on_m = before.on_m + std::hypot(way.path[j].x_m - before.x_m, way.path[j].y_m - before.y_m);
        }
        ways_.push_back(std::move(way));
        continue;
      }
      for (const auto& [to, by] : next[seen[i].first]) {
        if (seen.size() == kMostSteps) break;
        if (std::none_of(seen.begin(), seen.end(), [node = to](const auto& one) { return one.first == node; }))
          seen.push_back({to, i});
      }
    }
  }
}

FloorPlan::Way::Place FloorPlan::Way::at(double share) const {
  if (is_lift()) {
    const Place &from = path.front(), &to = path.back();
    return {from.x_m + share * (to.x_m - from.x_m), from.y_m + share * (to.y_m - from.y_m),
            from.level + share * (to.level - from.level), share * to.on_m};
  }
  const double on_m = share * length_m();
  auto to = path.begin() + 1;
  while (to + 1 != path.end() && to->on_m < on_m) ++to;
  const Place& from = *(to - 1);
  const double part = to->on_m > from.on_m ? (on_m - from.on_m) / (to->on_m - from.on_m) : 1.0;
  return {from.x_m + part * (to->x_m - from.x_m), from.y_m + part * (to->y_m - from.y_m),
          from.level + part * (to->level - from.level), on_m};
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
  const auto [west, east] = std::minmax({bucket_index(x1, level->extent.low_x_m, level->columns),
                                         bucket_index(x2, level->extent.low_x_m, level->columns)});
  const auto [south, north] = std::minmax(
      {bucket_index(y1, level->extent.low_y_m, level->rows), bucket_index(y2, level->extent.low_y_m, level->rows)});
  for (std::uint32_t y = south; y <= north; ++y) {
    for (std::uint32_t x = west; x <= east; ++x) {
      for (const std::uint32_t i : level->walls_near.at(std::size_t{y} * level->columns + x)) {
        if (crosses(level->walls[i])) return true;
      }
    }
  }
  return false;
}

bool FloorPlan::is_closed(int level_number, double x, double y) const {
  const Level* level = find(level_number);
  if (level == nullptr) return false;
  return std::any_of(level->closed.begin(), level->closed.end(), [&](const auto& one) {
    const Extent& e = one.first;
    return x >= e.low_x_m && x <= e.high_x_m && y >= e.low_y_m && y <= e.high_y_m &&
           inside(level->rooms[one.second].outline(), x, y);
  });
}

bool FloorPlan::may_be_at(int level_number, double x, double y) const {
  const Level* level = find(level_number);
  if (level == nullptr || level->rooms.empty()) return true;
  const Extent& e = level->extent;
  if (x < e.low_x_m || x > e.high_x_m || y < e.low_y_m || y > e.high_y_m) return false;
  const std::size_t bucket = std::size_t{bucket_index(y, e.low_y_m, level->rows)} * level->columns +
                             bucket_index(x, e.low_x_m, level->columns);
  const auto near = level->rooms_near.at(bucket);
  return std::any_of(near.begin(), near.end(), [&](std::uint32_t i) {
    const navigation::MapRoom& room = level->rooms[i];
    return room.access() < kNobody && inside(room.outline(), x, y) &&
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
