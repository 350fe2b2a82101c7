// Stairs, escalators, ramps, lifts and walkable lines.

#include <algorithm>
#include <cmath>
#include <limits>

#include "draft.hpp"

namespace fiona::building {
namespace {

/// Levels on which the elements at a node lie for certain: its own tag, or ways on a single level.
std::set<double> levels_at_node(Draft& draft, std::int64_t node) {
  std::set<double> levels;
  const auto add_single = [&](const Tags& tags) {
    const auto parsed = parse_levels(tag(tags, "level"));
    if (parsed && parsed->size() == 1) levels.insert(parsed->front());
  };
  add_single(draft.file.nodes.at(node).tags);
  if (!levels.empty()) return levels;
  const std::vector<std::int64_t>& ways = draft.ways_of_node[node];
  draft.work.spend(100 * ways.size(), {'n', node});
  for (std::int64_t way : ways) add_single(draft.file.ways.at(way).tags);
  return levels;
}

std::optional<double> end_level(Draft& draft, std::int64_t node, double low, double high) {
  const std::set<double> levels = levels_at_node(draft, node);
  const bool at_low = levels.contains(low);
  if (at_low == levels.contains(high)) return std::nullopt;
  return at_low ? low : high;
}

/// By `incline`: 1 up along the way, -1 down; 0: it does not say.
int rise_of(const Tags& tags) {
  const std::string& incline = tag(tags, "incline");
  if (incline.empty()) return 0;
  return incline == "down" || incline.starts_with('-') ? -1 : 1;
}

/// Which end is up: by the levels that meet the ends, else by `incline`, else by the order in the level tag.
bool starts_low(Draft& draft, const OsmWay& way, const std::vector<double>& levels, double low, double high) {
  if (const auto start = end_level(draft, way.nodes.front(), low, high)) return *start == low;
  if (const auto end = end_level(draft, way.nodes.back(), low, high)) return *end == high;
  if (const int rise = rise_of(way.tags)) return rise > 0;
  return levels.front() == low;
}

/// The level of a node on the way: its own tag, else that of the ways which lead away from it.
std::optional<double> landing_level(Draft& draft, std::int64_t node, double from, double to) {
  const std::set<double> levels = levels_at_node(draft, node);
  if (levels.size() != 1) return std::nullopt;
  const double level = *levels.begin();
  const double beyond = (level - from) * (level - to);
  if (beyond < 0.0) return level;
  // A wall or a platform of an end's level may meet the steps anywhere; only the node itself tells that they are flat.
  const auto own = parse_levels(tag(draft.file.nodes.at(node).tags, "level"));
  return beyond == 0.0 && own && own->size() == 1 ? std::optional(level) : std::nullopt;
}

/// Levels along a way: as its landings say, in between by length.
std::vector<PathPoint> climb(Draft& draft, const OsmWay& way, const std::vector<Point>& points, double from,
                             double to) {
  std::vector<std::pair<std::size_t, double>> known{{0, from}};
  for (std::size_t i = 1; i + 1 < points.size(); ++i) {
    if (const auto level = landing_level(draft, way.nodes[i], from, to)) known.push_back({i, *level});
  }
  known.push_back({points.size() - 1, to});
  std::vector<PathPoint> path{{points.front(), from}};
  for (std::size_t k = 1; k < known.size(); ++k) {
    const auto [first, low] = known[k - 1];
    const auto [last, high] = known[k];
    double total = 0.0, walked = 0.0;
    for (std::size_t i = first; i < last; ++i) total += distance_m(points[i], points[i + 1]);
    for (std::size_t i = first + 1; i <= last; ++i) {
      walked += distance_m(points[i - 1], points[i]);
      path.push_back({points[i], i == last ? high : low + (high - low) * (total > 0.0 ? walked / total : 1.0)});
    }
  }
  return path;
}

bool is_indoors(const Tags& tags) {
  const std::string& tunnel = tag(tags, "tunnel");
  return (tags.contains("indoor") && tag(tags, "indoor") != "no") || tag(tags, "highway") == "corridor" ||
         (!tunnel.empty() && tunnel != "no") || tag(tags, "location") == "underground" ||
         tag(tags, "location") == "indoor" || tag(tags, "level").starts_with('-');
}

ConnectorKind kind_of(const Tags& tags) {
  const std::string& conveying = tag(tags, "conveying");
  if (!conveying.empty() && conveying != "no") return ConnectorKind::Escalator;
  return tag(tags, "highway") == "steps" ? ConnectorKind::Stairs : ConnectorKind::Ramp;
}

/// How many storeys `level` is above `base`; levels that the building skips are none.
double storeys_between(const std::set<double>& absent, double base, double level) {
  const auto skipped = std::distance(absent.upper_bound(base), absent.upper_bound(level));
  return level - base - static_cast<double>(skipped);
}

double level_above(const std::set<double>& absent, double base, double storeys) {
  double level = base + storeys;
  for (auto skipped = absent.upper_bound(base); skipped != absent.end() && *skipped <= level; ++skipped) level += 1.0;
  return std::round(level * 1e6) / 1e6;  // as it would be read: levels are the same or not
}

/// The same climb from another level.
Connector repeated(const Connector& mapped, const std::set<double>& absent, double base) {
  const double lowest = mapped.levels.front();
  const auto moved = [&](double level) { return level_above(absent, base, storeys_between(absent, lowest, level)); };
  Connector copy = mapped;
  for (double& level : copy.levels) level = moved(level);
  for (PathPoint& p : copy.path) p.level = moved(p.level);
  return copy;
}

/// `bases`: from where else. The wiki (Key:repeat_on) leaves open which of several levels is found again on those that
/// it names. Here the lowest: level=0-1 repeat_on=1-2 are three flights, one above the other.
void add_climb(Draft& draft, std::int64_t id, const OsmWay& way, const std::vector<double>& levels,
               const std::vector<Point>& points, const std::vector<double>& bases = {}) {
  const auto [low, high] = std::minmax_element(levels.begin(), levels.end());
  const bool up = starts_low(draft, way, levels, *low, *high);
  Connector connector{{'w', id}, kind_of(way.tags), tag(way.tags, "name"), levels, {}, false};
  connector.access = access_level(draft, connector.id, way.tags);
  connector.indoors = is_indoors(way.tags);
  std::sort(connector.levels.begin(), connector.levels.end());
  connector.path = climb(draft, way, points, up ? *low : *high, up ? *high : *low);
  const std::string& conveying = tag(way.tags, "conveying");
  connector.one_way = conveying == "forward" || conveying == "backward";
  if (conveying == "backward") std::reverse(connector.path.begin(), connector.path.end());
  draft.plan.connectors.push_back(connector);
  draft.work.spend(bases.size() * connector.path.size() * (100 + 10 * draft.absent_levels.size()), connector.id);
  for (double base : bases) {
    if (base != *low) draft.plan.connectors.push_back(repeated(connector, draft.absent_levels, base));
  }
}

/// As Draft::levels_of, of one tag and without a warning.
std::vector<double> levels_in(const Draft& draft, const std::string& value) {
  std::vector<double> levels = parse_levels(value).value_or(std::vector<double>{});
  std::erase_if(levels, [&](double level) { return draft.absent_levels.contains(level); });
  return levels;
}

/// Along the way, or where it runs one way along that.
Path path_of(Draft& draft, std::int64_t id, const OsmWay& way, const std::vector<Point>& points, double level) {
  const std::string& conveying = tag(way.tags, "conveying");
  Path path{{'w', id}, {}, tag(way.tags, "highway") == "steps"};
  path.conveys = !conveying.empty() && conveying != "no";
  path.one_way = conveying == "forward" || conveying == "backward";
  path.indoors = is_indoors(way.tags);
  path.access = access_level(draft, path.id, way.tags);
  path.rise = rise_of(way.tags);
  for (Point p : points) path.points.push_back({p, level});
  if (conveying == "backward") {
    std::reverse(path.points.begin(), path.points.end());
    path.rise = -path.rise;
  }
  return path;
}

void add_line(Draft& draft, std::int64_t id, const OsmWay& way) {
  const ElementId element{'w', id};
  const std::vector<double> levels = draft.levels_of(element, way.tags);
  const auto points = levels.empty() ? std::nullopt : draft.points_of(id);
  if (!points || points->size() < 2) return;
  const std::vector<double> own = levels_in(draft, tag(way.tags, "level"));
  if (own.size() > 1) return add_climb(draft, id, way, own, *points, levels_in(draft, tag(way.tags, "repeat_on")));
  for (double level : levels) draft.plan.paths.push_back(path_of(draft, id, way, *points, level));
}

bool is_walkable_line(const Tags& tags) {
  static const std::set<std::string> kKinds = {"footway", "corridor", "steps", "path", "pedestrian", "service"};
  return kKinds.contains(tag(tags, "highway")) && tag(tags, "area") != "yes";
}

/// The level of what is mapped at an end of a line without a level, if there is exactly one; else the ground.
double meeting_level(Draft& draft, std::int64_t node) {
  const std::set<double> levels = levels_at_node(draft, node);
  return levels.size() == 1 ? *levels.begin() : 0.0;
}

/// A line without a level: around the building, or from one of its levels to another.
void add_line_around(Draft& draft, std::int64_t id, const OsmWay& way) {
  const auto points = draft.points_of(id);
  if (!points || points->size() < 2) return;
  const double from = meeting_level(draft, way.nodes.front());
  const double to = meeting_level(draft, way.nodes.back());
  if (from != to) return add_climb(draft, id, way, {from, to}, *points);
  draft.plan.paths.push_back(path_of(draft, id, way, *points, from));
  draft.plan.paths.back().around = true;
}

void add_lift(Draft& draft, ElementId id, const Tags& tags, Point at, std::vector<double> levels) {
  std::sort(levels.begin(), levels.end());
  Connector lift{id, ConnectorKind::Lift, tag(tags, "name"), levels, {}, false};
  lift.access = access_level(draft, id, tags);
  lift.indoors = true;
  for (double level : levels) lift.path.push_back({at, level});
  draft.plan.connectors.push_back(std::move(lift));
}

void add_lift_nodes(Draft& draft) {
  for (const auto& [id, node] : draft.file.nodes) {
    if (tag(node.tags, "highway") != "elevator") continue;
    std::vector<double> levels = draft.levels_of({'n', id}, node.tags);
    if (levels.empty()) {
      for (std::int64_t way : draft.ways_of_node[id]) {
        for (double level : draft.levels_of({'w', way}, draft.file.ways.at(way).tags)) {
          if (std::find(levels.begin(), levels.end(), level) == levels.end()) levels.push_back(level);
        }
      }
    }
    if (levels.size() > 1) {
      if (const auto at = draft.place_of({'n', id}, id)) add_lift(draft, {'n', id}, node.tags, *at, std::move(levels));
    } else {
      draft.warn({'n', id}, "the lift joins no two levels; left out");
    }
  }
}

/// A climb for a stairs room without a steps way: up one long side and down the other half of the room.
std::vector<PathPoint> climb_in(const Room& room, double low, double high) {
  const Box box = bounds(room.polygon.outer);
  const bool along_x = box.high.x_m - box.low.x_m > box.high.y_m - box.low.y_m;
  Point reach = along_x ? Point{(box.high.x_m - box.low.x_m) / 4, 0.0} : Point{0.0, (box.high.y_m - box.low.y_m) / 4};
  if (!contains(room.polygon, room.centre - reach) || !contains(room.polygon, room.centre + reach)) reach = {};
  return {{room.centre - reach, low}, {room.centre + reach, (low + high) / 2}, {room.centre - reach, high}};
}

bool serves(const Connector& connector, const Room& room, ConnectorKind kind) {
  if (connector.kind != kind) return false;
  return std::any_of(connector.path.begin(), connector.path.end(),
                     [&](const PathPoint& p) { return p.level == room.level && contains(room.polygon, p.at); });
}

/// Areas of one element above each other, from the lowest up.
using Shaft = std::vector<const Room*>;
using Flight = std::pair<const Room*, const Room*>;  // below, above

bool above_each_other(const Room& a, const Room& b) {
  return a.polygon.outer == b.polygon.outer || contains(a.polygon, b.centre) || contains(b.polygon, a.centre);
}

bool stops_at(const Shaft& shaft, double level) {
  return std::any_of(shaft.begin(), shaft.end(), [&](const Room* room) { return room->level == level; });
}

/// Of stairs rooms and lift shafts in which nothing is drawn.
std::vector<Shaft> shafts_of(Draft& draft) {
  std::vector<Shaft> shafts;
  for (const Room& room : draft.plan.rooms) {
    if (room.kind != RoomKind::Stairs && room.kind != RoomKind::Lift) continue;
    const ConnectorKind kind = room.kind == RoomKind::Lift ? ConnectorKind::Lift : ConnectorKind::Stairs;
    const auto& drawn = draft.plan.connectors;
    if (std::any_of(drawn.begin(), drawn.end(), [&](const Connector& c) { return serves(c, room, kind); })) continue;
    draft.work.spend(shafts.size(), room.id);
    const auto same = std::find_if(shafts.begin(), shafts.end(), [&](const Shaft& shaft) {
      if (shaft.front()->id != room.id || stops_at(shaft, room.level)) return false;
      draft.work.spend(20 * room.polygon.outer.size(), room.id);
      return above_each_other(*shaft.front(), room);
    });
    same == shafts.end() ? shafts.push_back({&room}) : same->push_back(&room);
  }
  for (Shaft& shaft : shafts) {
    std::sort(shaft.begin(), shaft.end(), [](const Room* a, const Room* b) { return a->level < b->level; });
  }
  return shafts;
}

/// The areas of other elements above or below `room`, on the next level: no storey of the building lies between.
std::vector<const Room*> next_to(Draft& draft, const std::vector<Shaft>& shafts, const std::set<double>& storeys,
                                 const Room& room, bool up) {
  std::vector<const Room*> found;
  draft.work.spend(4 * shafts.size(), room.id);
  for (const Shaft& shaft : shafts) {
    if (shaft.front()->kind != room.kind || stops_at(shaft, room.level)) continue;
    const auto above = std::find_if(shaft.begin(), shaft.end(), [&](const Room* r) { return r->level > room.level; });
    if (up ? above == shaft.end() : above == shaft.begin()) continue;
    const Room* next = up ? *above : *(above - 1);
    const auto [low, high] = std::minmax(room.level, next->level);
    const auto between = storeys.upper_bound(low);
    const double nearest = found.empty() ? next->level : found.front()->level;
    if ((between != storeys.end() && *between < high) || (up ? next->level > nearest : next->level < nearest)) continue;
    draft.work.spend(20 * (room.polygon.outer.size() + next->polygon.outer.size()), room.id);
    if (!above_each_other(room, *next)) continue;
    if (next->level != nearest) found.clear();
    found.push_back(next);
  }
  return found;
}

/// An element on several levels tells itself which of them it joins; an area on one level goes on in others.
std::vector<Flight> flights_of(Draft& draft, const std::vector<Shaft>& shafts) {
  std::vector<Flight> flights;
  for (const Shaft& shaft : shafts) {
    for (std::size_t i = 1; i < shaft.size(); ++i) flights.emplace_back(shaft[i - 1], shaft[i]);
  }
  std::set<double> storeys;
  for (const Room& room : draft.plan.rooms) {
    if (room.level == std::floor(room.level)) storeys.insert(room.level);
  }
  std::set<Flight> between;
  for (const Shaft& shaft : shafts) {
    if (shaft.size() > 1) continue;
    const Room* room = shaft.front();
    for (const Room* below : next_to(draft, shafts, storeys, *room, false)) between.emplace(below, room);
    for (const Room* above : next_to(draft, shafts, storeys, *room, true)) between.emplace(room, above);
  }
  flights.insert(flights.end(), between.begin(), between.end());
  return flights;
}

void add_flight(Draft& draft, const Room& below, const Room& above) {
  std::vector<PathPoint> climb = climb_in(below, below.level, above.level);
  if (!contains(above.polygon, climb.back().at)) climb.back().at = above.centre;
  draft.plan.connectors.push_back({below.id,
                                   ConnectorKind::Stairs,
                                   below.name,
                                   {below.level, above.level},
                                   std::move(climb),
                                   false,
                                   std::max(below.access, above.access),
                                   true});
}

/// Straight up, where the areas allow it.
void add_lift_in(Draft& draft, const Shaft& stops) {
  const Room& lowest = *stops.front();
  const Room* narrowest = *std::min_element(stops.begin(), stops.end(), [](const Room* a, const Room* b) {
    return area_m2(a->polygon) < area_m2(b->polygon);
  });
  Connector lift{lowest.id, ConnectorKind::Lift, lowest.name, {}, {}, false, kOpen, true};
  std::vector<int> access;
  for (const Room* stop : stops) {
    const bool straight = contains(stop->polygon, narrowest->centre);
    lift.levels.push_back(stop->level);
    lift.path.push_back({straight ? narrowest->centre : stop->centre, stop->level});
    access.push_back(stop->access);
  }
  // Who may be at two stops may ride between them; the others are closed by their rooms.
  std::nth_element(access.begin(), access.begin() + 1, access.end());
  lift.access = access[1];
  draft.plan.connectors.push_back(std::move(lift));
}

/// Flights one above the other are one lift; where an area has two above or below it, the second is a lift of its own.
void add_lifts(Draft& draft, const std::vector<Flight>& flights) {
  std::map<const Room*, const Room*> above_of;
  std::set<const Room*> reached;
  for (const auto& [below, above] : flights) {
    if (above_of.contains(below) || reached.contains(above)) {
      add_lift_in(draft, {below, above});
      continue;
    }
    above_of[below] = above;
    reached.insert(above);
  }
  for (const auto& [lowest, unused] : above_of) {
    if (reached.contains(lowest)) continue;
    Shaft stops{lowest};
    for (auto next = above_of.find(lowest); next != above_of.end(); next = above_of.find(next->second)) {
      stops.push_back(next->second);
    }
    add_lift_in(draft, stops);
  }
}

/// Stairs rooms and lift shafts in which nothing is drawn join their levels all the same.
void add_shafts(Draft& draft) {
  const std::vector<Shaft> shafts = shafts_of(draft);
  std::vector<Flight> lifts;
  std::set<const Room*> joined;
  for (const auto& [below, above] : flights_of(draft, shafts)) {
    joined.insert({below, above});
    if (below->kind == RoomKind::Lift) {
      lifts.emplace_back(below, above);
    } else {
      add_flight(draft, *below, *above);
    }
  }
  add_lifts(draft, lifts);
  for (const Shaft& shaft : shafts) {
    const Room& room = *shaft.front();
    if (joined.contains(&room)) continue;
    const bool is_lift = room.kind == RoomKind::Lift;
    draft.warn(room.id, std::string(is_lift ? "the lift joins" : "the stairs join") + " no two levels; left out");
  }
}

}  // namespace

void add_connectors(Draft& draft) {
  for (const auto& [id, way] : draft.file.ways) {
    if (!is_walkable_line(way.tags)) continue;
    way.tags.contains("level") ? add_line(draft, id, way) : add_line_around(draft, id, way);
  }
  add_lift_nodes(draft);
  add_shafts(draft);
}

}  // namespace fiona::building
