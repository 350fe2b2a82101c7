// The outline, the reference, the rooms, the levels and the landmarks of a plan.

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fiona/error.hpp>

#include "draft.hpp"

namespace fiona::building {
namespace {

std::optional<Ring> degrees_of(const OsmFile& file, const std::vector<std::int64_t>& nodes) {
  Ring ring;
  for (std::int64_t id : nodes) {
    const auto node = file.nodes.find(id);
    if (node == file.nodes.end()) return std::nullopt;
    ring.push_back({node->second.longitude_deg, node->second.latitude_deg});
  }
  return ring;
}

/// The places (x longitude, y latitude, degrees) of all that is tagged as lying on a level.
std::vector<Point> indoor_places(const OsmFile& file) {
  std::vector<Point> places;
  const auto add = [&](const OsmNode& node) { places.push_back({node.longitude_deg, node.latitude_deg}); };
  for (const auto& [id, node] : file.nodes) {
    if (node.tags.contains("level")) add(node);
  }
  for (const auto& [id, way] : file.ways) {
    if (!way.tags.contains("level")) continue;
    for (std::int64_t corner : way.nodes) {
      if (const auto node = file.nodes.find(corner); node != file.nodes.end()) add(node->second);
    }
  }
  return places;
}

double median(std::vector<Point> points, double Point::*coordinate) {
  const auto middle = points.begin() + static_cast<std::ptrdiff_t>(points.size() / 2);
  std::nth_element(points.begin(), middle, points.end(),
                   [&](const Point& a, const Point& b) { return a.*coordinate < b.*coordinate; });
  return (*middle).*coordinate;
}

bool is_outline(const Area& area) {
  const std::string& building = tag(*area.tags, "building");
  const bool has_walls = building != "roof" && building != "carport" && tag(*area.tags, "wall") != "no";
  return !building.empty() && building != "no" && has_walls && !area.outers.empty();
}

double heading_rad(const OsmFile& file, std::int64_t id, const OsmNode& node) {
  const std::string& value = tag(node.tags, "fiona:heading");
  if (value.empty()) return 0.0;
  const auto degrees = parse_metres(value);
  if (!degrees || std::abs(*degrees) > 360.0) {
    throw Error(ErrorCode::Failed, {.what = "the heading of the reference of " + file.name + " cannot be read",
                                    .where = file.name + ", node " + std::to_string(id),
                                    .expected = "fiona:heading in degrees from true north, clockwise, -360 to 360",
                                    .found = "fiona:heading=" + value,
                                    .next = "correct the tag, or remove it for 0"});
  }
  return *degrees * std::numbers::pi / 180.0;
}

std::optional<Reference> tagged_reference(const OsmFile& file) {
  std::optional<Reference> found;
  std::int64_t first = 0;
  for (const auto& [id, node] : file.nodes) {
    if (tag(node.tags, "fiona:reference") != "yes") continue;
    if (found) {
      throw Error(ErrorCode::Failed, {.what = "the building file " + file.name + " has two references",
                                      .where = file.name,
                                      .expected = "fiona:reference=yes on one node",
                                      .found = "node " + std::to_string(first) + " and node " + std::to_string(id),
                                      .next = "remove the tag from one of them"});
    }
    first = id;
    found = Reference{node.latitude_deg, node.longitude_deg, heading_rad(file, id, node), true};
  }
  return found;
}

RoomKind kind_of(const Tags& tags) {
  const std::string& room = tag(tags, "room");
  if (room == "stairs" || room == "steps" || tag(tags, "stairs") == "yes") return RoomKind::Stairs;
  if (room == "elevator" || tag(tags, "elevator") == "yes" || tag(tags, "highway") == "elevator") {
    return RoomKind::Lift;
  }
  if (tag(tags, "indoor") == "corridor") return RoomKind::Corridor;
  if (tag(tags, "indoor") == "area" || tag(tags, "area") == "yes") return RoomKind::Area;
  return RoomKind::Room;
}

std::optional<Ring> ring_of(Draft& draft, ElementId id, const std::vector<std::int64_t>& nodes) {
  Ring ring;
  for (std::int64_t number : nodes) {
    const std::optional<Point> corner = draft.place_of(id, number);
    if (!corner) return std::nullopt;
    ring.push_back(*corner);
  }
  return ring;
}

std::vector<Polygon> polygons_of(Draft& draft, const Area& area) {
  std::vector<Polygon> polygons;
  std::size_t corners = 0;
  for (const auto* rings : {&area.outers, &area.inners}) {
    for (const auto& ring : *rings) corners += ring.size();
  }
  draft.work.limit(corners, kMostCorners, "corners", area.id);
  draft.work.spend(corners * (2000 + area.outers.size() * area.inners.size()), area.id);  // where its middle is
  if (area.outers.empty()) {
    draft.warn(area.id, "its ways do not close to a ring; left out");
  } else if (!area.is_whole) {
    draft.warn(area.id, "some of its ways are not in the file, or do not close to a ring: only the others are used");
  }
  for (const auto& nodes : area.outers) {
    if (auto ring = ring_of(draft, area.id, nodes)) polygons.push_back({std::move(*ring), {}});
  }
  for (const auto& nodes : area.inners) {
    auto ring = ring_of(draft, area.id, nodes);
    if (!ring) continue;
    for (Polygon& polygon : polygons) {
      if (contains(polygon.outer, inner_point({*ring, {}}))) polygon.holes.push_back(*ring);
    }
  }
  for (Polygon& polygon : polygons) normalise(polygon);
  std::erase_if(polygons, [&](const Polygon& polygon) {
    const bool empty = polygon.outer.size() < 3 || area_m2(polygon) < 0.01;
    if (empty) draft.warn(area.id, "it has no area; left out");
    return empty;
  });
  return polygons;
}

void add_room(Draft& draft, const Area& area) {
  const Tags& tags = *area.tags;
  if (!tags.contains("level") && !tags.contains("repeat_on")) {
    draft.warn(area.id, "it has no level; left out (add level=0 for the ground floor)");
    return;
  }
  const std::vector<double> levels = draft.levels_of(area.id, tags);
  if (levels.empty()) return;
  const int access = access_level(draft, area.id, tags);
  for (const Polygon& polygon : polygons_of(draft, area)) {
    const std::string& use = tags.contains("room") ? tag(tags, "room") : tag(tags, "amenity");
    const Point centre = inner_point(polygon);
    draft.work.limit(draft.plan.rooms.size() + levels.size(), kMostRooms, "rooms", area.id);
    draft.work.spend(levels.size() * polygon.outer.size() * 100, area.id);  // a copy for each level
    for (double level : levels) {
      draft.plan.rooms.push_back(
          {area.id, kind_of(tags), level, tag(tags, "name"), tag(tags, "ref"), use, polygon, centre, access});
    }
  }
  for (std::int64_t way : area.ways) draft.levels_of_way[way].insert(levels.begin(), levels.end());
  if (const auto loss = draft.attenuation_db(area.id, tags)) draft.attenuation_of_room[area.id] = *loss;
}

/// Who is led to a hall is not led into the kiosk in its middle.
void keep_centres_free(Draft& draft) {
  struct Placed {
    Room* room;
    Box box;
    double area_m2;
  };
  std::map<double, std::vector<Placed>> rooms_of_level;
  for (Room& room : draft.plan.rooms) {
    rooms_of_level[room.level].push_back({&room, bounds(room.polygon.outer), area_m2(room.polygon)});
  }
  for (const auto& [level, rooms] : rooms_of_level) {
    for (const auto& [room, box, size_m2] : rooms) {
      std::vector<const Room*> within;
      bool is_taken = false;
      draft.work.spend(4 * rooms.size(), room->id);
      for (const Placed& other : rooms) {
        if (other.area_m2 >= size_m2 || !has_walls(other.room->kind)) continue;
        const Point corner = other.room->polygon.outer.front();
        if (corner.x_m < box.low.x_m || corner.x_m > box.high.x_m || corner.y_m < box.low.y_m ||
            corner.y_m > box.high.y_m) {
          continue;
        }
        draft.work.spend(8 * other.room->polygon.outer.size(), room->id);
        within.push_back(other.room);
        is_taken = is_taken || contains(other.room->polygon, room->centre);
      }
      if (!is_taken) continue;
      Polygon free = room->polygon;
      for (const Room* other : within) free.holes.push_back(other->polygon.outer);
      std::size_t corners = free.outer.size();
      for (const Ring& hole : free.holes) corners += hole.size();
      draft.work.spend(2000 * corners, room->id);
      const Point centre = inner_point(free);
      if (centre != free.outer.front()) room->centre = centre;  // else nothing of it is free
    }
  }
}

/// Storey heights by indoor=level, and names of levels.
void read_level_elements(Draft& draft, std::map<int, double>& storeys, std::map<double, std::string>& names) {
  const auto read = [&](ElementId id, const Tags& tags) {
    if (tag(tags, "indoor") != "level") return;
    const std::string& height = tag(tags, "height");
    const auto metres = parse_metres(height);
    const bool usable = metres && *metres >= 0.5 && *metres <= 100.0;
    if (!height.empty() && !usable) draft.warn(id, "height=" + height + " is not a storey of 0.5 to 100 m; not used");
    for (double level : draft.levels_of(id, tags)) {
      names.emplace(level, tag(tags, "name"));
      if (usable && level == std::floor(level)) storeys[static_cast<int>(level)] = *metres;
    }
  };
  for (const auto& [id, node] : draft.file.nodes) read({'n', id}, node.tags);
  for (const auto& [id, way] : draft.file.ways) read({'w', id}, way.tags);
  for (const auto& [id, relation] : draft.file.relations) read({'r', id}, relation.tags);
}

double default_storey_m(const Area* outline) {
  if (outline == nullptr) return Heights::kDefaultStorey_m;
  const auto height = parse_metres(tag(*outline->tags, "height"));
  const auto levels = parse_metres(tag(*outline->tags, "building:levels"));
  const double storey = height && levels && *levels >= 1.0 ? *height / *levels : 0.0;
  return storey >= 2.0 && storey <= 20.0 ? storey : Heights::kDefaultStorey_m;
}

std::set<double> used_levels(const Plan& plan) {
  std::set<double> used;
  for (const Room& room : plan.rooms) used.insert(room.level);
  for (const Connector& connector : plan.connectors) used.insert(connector.levels.begin(), connector.levels.end());
  for (const Path& path : plan.paths) {
    if (!path.around) used.insert(path.points.front().level);
  }
  return used;
}

}  // namespace

const Area* find_outline(const OsmFile& file, const std::vector<Area>& areas) {
  std::vector<Point> places = indoor_places(file);
  std::sort(places.begin(), places.end(), [](Point a, Point b) { return a.x_m < b.x_m; });
  Work work(file.name);
  const Area* best = nullptr;
  std::ptrdiff_t most = -1;
  for (const Area& area : areas) {
    if (!is_outline(area)) continue;
    std::ptrdiff_t inside = 0;
    for (const auto& nodes : area.outers) {
      const auto ring = degrees_of(file, nodes);
      if (!ring) continue;
      const Box box = bounds(*ring);
      const auto first = std::lower_bound(places.begin(), places.end(), box.low.x_m,
                                          [](Point p, double west) { return p.x_m < west; });
      const auto last =
          std::upper_bound(first, places.end(), box.high.x_m, [](double east, Point p) { return east < p.x_m; });
      work.spend(static_cast<std::size_t>(last - first), area.id);
      inside += std::count_if(first, last, [&](Point p) {
        if (p.y_m < box.low.y_m || p.y_m > box.high.y_m) return false;
        work.spend(4 * ring->size(), area.id);
        return contains(*ring, p);
      });
    }
    if (inside > most) best = &area, most = inside;
  }
  return most > 0 ? best : nullptr;
}

Reference find_reference(const OsmFile& file, const Area* outline) {
  if (const auto tagged = tagged_reference(file)) return *tagged;
  if (outline != nullptr) {
    if (const auto ring = degrees_of(file, outline->outers.front())) {
      const Point middle = centroid(*ring);
      return {middle.y_m, middle.x_m, 0.0, false};
    }
  }
  const std::vector<Point> places = indoor_places(file);
  if (places.empty()) {
    throw Error(ErrorCode::Failed, {.what = "the building file " + file.name + " has nothing on a level",
                                    .where = file.name,
                                    .expected = "rooms, corridors or ways with a tag such as level=0",
                                    .found = std::to_string(file.nodes.size()) + " nodes and " +
                                             std::to_string(file.ways.size()) + " ways without a level",
                                    .next = "tag them: https://wiki.openstreetmap.org/wiki/Simple_Indoor_Tagging"});
  }
  // Not the mean: one node with a wrong digit would carry the reference to another town.
  return {median(places, &Point::y_m), median(places, &Point::x_m), 0.0, false};
}

void add_rooms(Draft& draft, const std::vector<Area>& areas) {
  for (const Area& area : areas) {
    if (is_indoor_area(*area.tags) && !is_outline(area)) add_room(draft, area);
  }
  keep_centres_free(draft);
}

void add_levels(Draft& draft) {
  if (draft.outline != nullptr) {
    draft.plan.name = tag(*draft.outline->tags, "name");
    if (auto polygons = polygons_of(draft, *draft.outline); !polygons.empty()) draft.plan.outline = polygons.front();
  }
  std::map<int, double> storeys;
  std::map<double, std::string> names;
  read_level_elements(draft, storeys, names);
  for (double absent : draft.absent_levels) storeys[static_cast<int>(absent)] = 0.0;
  draft.plan.heights = Heights(default_storey_m(draft.outline), std::move(storeys));
  for (double level : used_levels(draft.plan)) {
    const auto name = names.find(level);
    const bool named = name != names.end() && !name->second.empty();
    draft.plan.levels.push_back(
        {level, draft.plan.heights.floor_m(level), named ? name->second : "Level " + level_text(level)});
  }
}

void add_landmarks(Draft& draft) {
  for (const auto& [id, node] : draft.file.nodes) {
    const auto own = [](const auto& tag) { return tag.first.starts_with("fiona:"); };
    if (tag(node.tags, "fiona:reference") == "yes" || std::none_of(node.tags.begin(), node.tags.end(), own)) {
      continue;
    }
    const std::vector<double> levels = draft.levels_of({'n', id}, node.tags);
    if (levels.empty()) {
      draft.warn({'n', id}, "it has a fiona: tag and no level; left out");
      continue;
    }
    const double height_m = parse_metres(tag(node.tags, "height")).value_or(0.0);
    draft.plan.landmarks.push_back({{'n', id}, draft.at(node), levels.front(), height_m, node.tags});
  }
}

}  // namespace fiona::building
