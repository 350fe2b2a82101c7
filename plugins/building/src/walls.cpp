// Walls from rooms, the outline and indoor=wall; doors, and the gaps that they make.

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "draft.hpp"

namespace fiona::building {
namespace {

/// A door and a wall belong together up to here: mappers draw doors beside the line, and walls twice.
constexpr double kDoorReach_m = 0.5;
/// Sine of the angle up to which a second wall at a door counts as the other face of the same wall.
constexpr double kParallel = 0.25;

class WallSet {
  using End = std::pair<long, long>;  // millimetres

 public:
  explicit WallSet(Draft& draft) : plan_(draft.plan), work_(draft.work) {}

  /// Adds a wall unless it is there already (two rooms share their wall); the stronger attenuation stays.
  void add(ElementId of, const Segment& segment, double level, double attenuation_db, bool exterior,
           bool drawn = false) {
    if (distance_m(segment.from, segment.to) < 0.01) return;
    const auto end = [](Point p) { return End(std::lround(p.x_m * 1000), std::lround(p.y_m * 1000)); };
    const std::pair<End, End> ends = std::minmax({end(segment.from), end(segment.to)});
    const auto [known, added] = index_.try_emplace({level, ends.first, ends.second}, plan_.walls.size());
    if (added) {
      work_.limit(plan_.walls.size() + 1, kMostWalls, "walls", of);
      plan_.walls.push_back({segment, level, attenuation_db, exterior, drawn});
      return;
    }
    Wall& wall = plan_.walls[known->second];
    wall.attenuation_db = std::max(wall.attenuation_db, attenuation_db);
    wall.exterior = wall.exterior || exterior;
  }

 private:
  Plan& plan_;
  const Work& work_;
  std::map<std::tuple<double, End, End>, std::size_t> index_{};
};

bool outline_stands_on(double level, const Tags& tags) {
  const double lowest = parse_metres(tag(tags, "building:min_level"))
                            .value_or(-parse_metres(tag(tags, "building:levels:underground")).value_or(0.0));
  return level >= lowest;
}

/// A wall through the middle of a hall: who is in the wall would be on both of its sides.
void keep_centres_off(Draft& draft, ElementId id, const Segment& wall, double level) {
  constexpr double kClear_m = 0.5;
  draft.work.spend(4 * draft.plan.rooms.size(), id);
  const Point aside = left_of(unit(wall.to - wall.from)) * (2 * kClear_m);
  for (Room& room : draft.plan.rooms) {
    if (room.level != level || distance_m(room.centre, wall) >= kClear_m) continue;
    for (const Point side : {aside, aside * -1.0}) {
      if (!contains(room.polygon, room.centre + side)) continue;
      room.centre = room.centre + side;
      break;
    }
  }
}

void add_drawn_walls(Draft& draft, WallSet& walls) {
  for (const auto& [id, way] : draft.file.ways) {
    if (tag(way.tags, "indoor") != "wall") continue;
    const ElementId element{'w', id};
    const auto points = draft.points_of(id);
    const std::vector<double> levels = draft.levels_of(element, way.tags);
    if (levels.empty()) draft.warn(element, "the wall has no level; left out");
    if (!points) continue;
    const double loss = draft.attenuation_db(element, way.tags).value_or(kInteriorWall_db);
    for (double level : levels) {
      draft.levels_of_way[id].insert(level);
      for (std::size_t i = 1; i < points->size(); ++i) {
        walls.add(element, {(*points)[i - 1], (*points)[i]}, level, loss, false, true);
        keep_centres_off(draft, element, {(*points)[i - 1], (*points)[i]}, level);
      }
    }
  }
}

std::set<double> door_levels(Draft& draft, std::int64_t id, const OsmNode& node) {
  const std::vector<double> own = draft.levels_of({'n', id}, node.tags);
  if (!own.empty()) return {own.begin(), own.end()};
  std::set<double> inherited;
  if (const auto ways = draft.ways_of_node.find(id); ways != draft.ways_of_node.end()) {
    for (std::int64_t way : ways->second) {
      if (const auto levels = draft.levels_of_way.find(way); levels != draft.levels_of_way.end()) {
        inherited.insert(levels->second.begin(), levels->second.end());
      }
    }
  }
  if (node.tags.contains("entrance") && (inherited.empty() || inherited.contains(0.0))) return {0.0};
  return inherited;
}

double door_width_m(const Tags& tags) {
  const double width = parse_metres(tag(tags, "width")).value_or(tag(tags, "door") == "double" ? 1.8 : 0.9);
  return width >= 0.3 && width <= 20.0 ? width : 0.9;
}

bool is_door(const Tags& tags) {
  const std::string& door = tag(tags, "door");
  return (!door.empty() && door != "no") || tags.contains("entrance") || tag(tags, "indoor") == "door";
}

/// Cheap, and no for nearly all.
bool near(Point p, const Segment& segment, double reach_m) {
  const auto between = [&](double value, double a, double b) {
    return value >= std::min(a, b) - reach_m && value <= std::max(a, b) + reach_m;
  };
  return between(p.x_m, segment.from.x_m, segment.to.x_m) && between(p.y_m, segment.from.y_m, segment.to.y_m);
}

void add_door(Draft& draft, Door door, bool told) {
  const Wall* host = nullptr;
  double nearest = kDoorReach_m;
  draft.work.limit(draft.plan.doors.size() + 1, kMostDoors, "doors", door.id);
  draft.work.spend(draft.plan.walls.size() * 2, door.id);
  for (const Wall& wall : draft.plan.walls) {
    if (wall.level != door.level || !near(door.at, wall.segment, kDoorReach_m)) continue;
    const double distance = distance_m(door.at, wall.segment);
    if (distance < nearest) host = &wall, nearest = distance;
  }
  if (host == nullptr) {
    // Entrances of the neighbours are no concern of this building; a door that names its level was meant.
    if (told) draft.warn(door.id, "there is no wall at this door on level " + level_text(door.level) + "; left out");
    return;
  }
  door.normal = unit(left_of(host->segment.to - host->segment.from));
  draft.plan.doors.push_back(std::move(door));
}

/// What is left of a wall beside a gap of `width_m` around `middle`.
std::vector<Wall> beside_gap(const Wall& wall, Point middle, double width_m) {
  const Point along = wall.segment.to - wall.segment.from;
  const double length = length_m(along);
  const double centre = dot(middle - wall.segment.from, along) / length;
  std::vector<Wall> left;
  const auto keep = [&](double from_m, double to_m) {
    if (to_m - from_m < 0.01) return;
    Wall piece = wall;
    piece.segment = {wall.segment.from + along * (from_m / length), wall.segment.from + along * (to_m / length)};
    left.push_back(piece);
  };
  keep(0.0, std::min(length, centre - width_m / 2));
  keep(std::max(0.0, centre + width_m / 2), length);
  return left;
}

}  // namespace

std::optional<double> material_attenuation_db(const std::string& material) {
  static const std::map<std::string, double> kTable = {
      {"brick", 8.0},        {"concrete", 12.0},      {"reinforced_concrete", 15.0},
      {"drywall", 3.0},      {"glass", 3.0},          {"gypsum", 3.0},
      {"masonry", 8.0},      {"metal", 20.0},         {"plaster", 4.0},
      {"plasterboard", 3.0}, {"sandstone", 10.0},     {"steel", 20.0},
      {"stone", 10.0},       {"timber_framing", 4.0}, {"wood", 4.0},
      {"cinder_block", 7.0}};
  const auto known = kTable.find(material);
  return known == kTable.end() ? std::nullopt : std::optional(known->second);
}

void add_walls(Draft& draft) {
  WallSet walls{draft};
  for (const Room& room : draft.plan.rooms) {
    if (!has_walls(room.kind)) continue;
    const auto told = draft.attenuation_of_room.find(room.id);
    const double loss = told == draft.attenuation_of_room.end() ? kInteriorWall_db : told->second;
    for (const Segment& side : edges(room.polygon)) walls.add(room.id, side, room.level, loss, false);
  }
  if (draft.outline != nullptr) {
    const Tags& tags = *draft.outline->tags;
    const double loss =
        draft.attenuation_db(draft.outline->id, tags)
            .value_or(material_attenuation_db(tag(tags, "building:material")).value_or(kExteriorWall_db));
    for (const Level& level : draft.plan.levels) {
      if (!outline_stands_on(level.level, tags)) continue;
      for (const Segment& side : edges(draft.plan.outline)) walls.add(draft.outline->id, side, level.level, loss, true);
    }
  }
  add_drawn_walls(draft, walls);
}

void add_doors(Draft& draft) {
  for (const auto& [id, node] : draft.file.nodes) {
    if (!is_door(node.tags)) continue;
    const std::set<double> levels = door_levels(draft, id, node);
    if (levels.empty() && draft.ways_of_node.contains(id) && node.tags.contains("level")) {
      draft.warn({'n', id}, "the door has no level that can be read; left out");
    }
    for (double level : levels) {
      add_door(draft,
               {{'n', id},
                draft.at(node),
                level,
                door_width_m(node.tags),
                node.tags.contains("entrance"),
                tag(node.tags, "name"),
                {},
                access_level(draft, {'n', id}, node.tags)},
               node.tags.contains("level"));
    }
  }
  for (const auto& [id, way] : draft.file.ways) {
    if (way.closed() || way.nodes.size() < 2 || !is_door(way.tags)) continue;
    const auto points = draft.points_of(id);
    if (!points) continue;
    const Segment leaf{points->front(), points->back()};
    for (double level : draft.levels_of({'w', id}, way.tags)) {
      add_door(draft,
               {{'w', id},
                (leaf.from + leaf.to) * 0.5,
                level,
                distance_m(leaf.from, leaf.to),
                way.tags.contains("entrance"),
                tag(way.tags, "name"),
                {},
                access_level(draft, {'w', id}, way.tags)},
               true);
    }
  }
}

void cut_doors(Draft& draft) {
  Plan& plan = draft.plan;
  for (const Door& door : plan.doors) {
    draft.work.spend(plan.walls.size() * 2, door.id);
    // Pieces go to the end; they are beside this door's gap, and need not be looked at for it.
    for (std::size_t i = 0, last = plan.walls.size(); i < last; ++i) {
      const Wall wall = plan.walls[i];
      if (wall.level != door.level || !near(door.at, wall.segment, kDoorReach_m)) continue;
      const Point direction = unit(wall.segment.to - wall.segment.from);
      const bool at_door =
          std::abs(dot(direction, door.normal)) < kParallel && distance_m(door.at, wall.segment) < kDoorReach_m;
      if (!at_door) continue;
      const std::vector<Wall> pieces = beside_gap(wall, door.at, door.width_m);
      plan.walls[i].segment.to = plan.walls[i].segment.from;  // nothing is left of it, unless there is a piece
      if (!pieces.empty()) plan.walls[i] = pieces.front();
      if (pieces.size() > 1) plan.walls.push_back(pieces.back());
    }
  }
  std::erase_if(plan.walls, [](const Wall& wall) { return wall.segment.from == wall.segment.to; });
  std::stable_sort(plan.walls.begin(), plan.walls.end(),
                   [](const Wall& a, const Wall& b) { return a.level < b.level; });
}

}  // namespace fiona::building
