#include "level_plan.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <tuple>
#include <utility>

#include <fiona/building/geometry.hpp>
#include <fiona/error.hpp>

namespace fiona::guidance {
namespace {

using building::Passage;
using building::Point;
using building::RoomKind;
using navigation::MapEdge;
using navigation::MapRoom;

[[noreturn]] void refuse(const navigation::CommLevelMap& map, const std::string& what, const std::string& expected) {
  throw Error(ErrorCode::Failed, {.what = "the map of " + (map.title().empty() ? map.name() : map.title()) + " " + what,
                                  .where = "LevelMap " + map.name(),
                                  .expected = expected,
                                  .next = "correct the building's file, or ask another provider of LevelMap"});
}

RoomKind kind_of(MapRoom::Kind kind) {
  switch (kind) {
    case MapRoom::CORRIDOR: return RoomKind::Corridor;
    case MapRoom::AREA: return RoomKind::Area;
    case MapRoom::STAIRWELL: return RoomKind::Stairs;
    case MapRoom::LIFT_SHAFT: return RoomKind::Lift;
    default: return RoomKind::Room;
  }
}

std::optional<Passage> passage_of(MapEdge::Kind kind) {
  switch (kind) {
    case MapEdge::CORRIDOR:
    case MapEdge::OUTDOORS: return Passage::Walk;
    case MapEdge::DOOR: return Passage::Door;
    case MapEdge::STAIRS: return Passage::Stairs;
    case MapEdge::ESCALATOR: return Passage::Escalator;
    case MapEdge::RAMP: return Passage::Ramp;
    case MapEdge::LIFT: return Passage::Lift;
    default: return std::nullopt;
  }
}

building::Ring ring_of(const navigation::CommLevelMap& map, const MapRoom& room, const navigation::MapRing& from) {
  if (from.x_size() != from.y_size() || from.x_size() < 3) {
    refuse(map, "has a broken outline of room " + room.id(),
           "at least 3 corners, as many y as x; there are " + std::to_string(from.x_size()) + " x and " +
               std::to_string(from.y_size()) + " y");
  }
  building::Ring ring;
  for (int i = 0; i < from.x_size(); ++i) ring.push_back({from.x(i), from.y(i)});
  return ring;
}

class Reader {
 public:
  explicit Reader(const navigation::CommLevelMap& map) : map_(map) {}

  LevelPlan read() {
    if (map_.levels().empty()) refuse(map_, "has no levels", "at least one level");
    made_.name = map_.title().empty() ? map_.name() : map_.title();
    made_.version = map_.version();
    made_.heading_rad = map_.reference().reference_heading() * std::numbers::pi / 180.0;
    made_.reference = reference_of(map_.reference());
    add_levels();
    for (const MapRoom& room : map_.rooms()) add_room(room);
    for (const navigation::MapWall& wall : map_.walls()) {
      made_.plan.walls.push_back({.segment = {{wall.x1(), wall.y1()}, {wall.x2(), wall.y2()}},
                                  .level = wall.level(),
                                  .exterior = wall.exterior()});
    }
    std::stable_sort(made_.plan.walls.begin(), made_.plan.walls.end(),
                     [](const building::Wall& a, const building::Wall& b) { return a.level < b.level; });
    for (const navigation::MapDoor& door : map_.doors()) add_door(door);
    add_graph();
    return std::move(made_);
  }

 private:
  void add_levels() {
    for (const navigation::MapLevel& level : map_.levels()) {
      made_.plan.levels.push_back({level.level(), level.floor(), level.name()});
    }
    std::sort(made_.plan.levels.begin(), made_.plan.levels.end(),
              [](const building::Level& a, const building::Level& b) { return a.level < b.level; });
  }

  void add_room(const MapRoom& room) {
    building::Room added{.kind = kind_of(room.kind()),
                         .level = room.level(),
                         .name = room.name(),
                         .ref = room.ref(),
                         .use = room.use(),
                         .centre = {room.x(), room.y()},
                         .access = room.access()};
    added.polygon.outer = ring_of(map_, room, room.outline());
    for (const navigation::MapRing& hole : room.holes()) added.polygon.holes.push_back(ring_of(map_, room, hole));
    rooms_.try_emplace({room.id(), room.level()}, made_.plan.rooms.size());
    made_.plan.rooms.push_back(std::move(added));
  }

  void add_door(const navigation::MapDoor& door) {
    doors_[{door.x(), door.y(), door.level()}] = made_.plan.doors.size();
    made_.plan.doors.push_back({.at = {door.x(), door.y()},
                                .level = door.level(),
                                .width_m = door.width(),
                                .entrance = door.entrance(),
                                .name = door.name(),
                                .access = door.access()});
  }

  void add_graph() {
    building::Graph& graph = made_.graph;
    graph.nodes_of_room.resize(made_.plan.rooms.size());
    for (const navigation::MapNode& node : map_.nodes()) {
      building::GraphNode added{{node.x(), node.y()}, node.level(), std::nullopt};
      const auto room = rooms_.find({node.room(), node.level()});
      if (room != rooms_.end()) {
        added.room = room->second;
        graph.nodes_of_room[room->second].push_back(graph.nodes.size());
      }
      graph.nodes.push_back(added);
    }
    for (const MapEdge& edge : map_.edges()) add_edge(edge);
    graph.edges_of_node.resize(graph.nodes.size());
    for (std::size_t i = 0; i < graph.edges.size(); ++i) {
      graph.edges_of_node[graph.edges[i].from].push_back(i);
      graph.edges_of_node[graph.edges[i].to].push_back(i);
    }
  }

  void add_edge(const MapEdge& edge) {
    building::Graph& graph = made_.graph;
    if (edge.from() >= graph.nodes.size() || edge.to() >= graph.nodes.size()) {
      refuse(map_, "has an edge between nodes " + std::to_string(edge.from()) + " and " + std::to_string(edge.to()),
             "nodes from 0 to " + std::to_string(graph.nodes.size()) + ", the last one not included");
    }
    const auto passage = passage_of(edge.kind());
    if (!passage) return;
    if (*passage == building::Passage::Door)
      note_direction(edge.from(), edge.to()), note_direction(edge.to(), edge.from());
    graph.edges.push_back({.from = edge.from(),
                           .to = edge.to(),
                           .passage = *passage,
                           .length_m = edge.length(),
                           .cost_s = edge.cost(),
                           .one_way = edge.one_way(),
                           .outdoors = edge.outdoors(),
                           .own_access = own_access(edge),
                           .rise = edge.rise() == MapEdge::UP     ? 1
                                   : edge.rise() == MapEdge::DOWN ? -1
                                                                  : 0});
  }

  /// The map tells the highest of the element and the rooms at its ends. A room's part counts only on the way in: who
  /// is in it may leave.
  int own_access(const MapEdge& edge) {
    int of_rooms = 0;
    int of_door = 0;
    for (const std::uint32_t end : {edge.from(), edge.to()}) {
      const building::GraphNode& node = made_.graph.nodes[end];
      if (node.room) of_rooms = std::max(of_rooms, made_.plan.rooms[*node.room].access);
      const building::Door* door = edge.kind() == MapEdge::DOOR ? door_at(node) : nullptr;
      if (door) of_door = std::max(of_door, door->access);
    }
    return edge.access() > of_rooms ? edge.access() : of_door;
  }

  building::Door* door_at(const building::GraphNode& node) {
    const auto door = doors_.find({node.at.x_m, node.at.y_m, node.level});
    return door == doors_.end() ? nullptr : &made_.plan.doors[door->second];
  }

  /// The map does not tell where a door leads: its edges do.
  void note_direction(std::uint32_t from, std::uint32_t to) {
    const building::GraphNode& a = made_.graph.nodes[from];
    building::Door* door = door_at(a);
    if (door && a.at != made_.graph.nodes[to].at) door->normal = building::unit(made_.graph.nodes[to].at - a.at);
  }

  const navigation::CommLevelMap& map_;
  LevelPlan made_{};
  std::map<std::pair<std::string, double>, std::size_t> rooms_{};
  std::map<std::tuple<double, double, double>, std::size_t> doors_{};  ///< of the plan, by x, y, level
};

}  // namespace

std::optional<building::Reference> reference_of(const localisation::CommPosition& place) {
  if (!place.has_reference_lat() || !place.has_reference_long()) return std::nullopt;
  return building::Reference{place.reference_lat(), place.reference_long(),
                             place.reference_heading() * std::numbers::pi / 180.0, true};
}

MapEdge::Kind kind_of(const building::RoutePoint& point) {
  switch (point.passage) {
    case Passage::Walk: return point.outdoors ? MapEdge::OUTDOORS : MapEdge::CORRIDOR;
    case Passage::Door: return MapEdge::DOOR;
    case Passage::Stairs: return MapEdge::STAIRS;
    case Passage::Escalator: return MapEdge::ESCALATOR;
    case Passage::Ramp: return MapEdge::RAMP;
    case Passage::Lift: return MapEdge::LIFT;
  }
  return MapEdge::KIND_UNSPECIFIED;
}

std::optional<double> LevelPlan::level_near(double level, double reach) const {
  std::optional<double> nearest;
  for (const building::Level& one : plan.levels) {
    const double off = std::abs(one.level - level);
    if (off <= reach && (!nearest || off < std::abs(*nearest - level))) nearest = one.level;
  }
  return nearest;
}

bool LevelPlan::walled(Point a, Point b, double level) const {
  const auto from = std::lower_bound(plan.walls.begin(), plan.walls.end(), level,
                                     [](const building::Wall& wall, double at) { return wall.level < at; });
  for (auto wall = from; wall != plan.walls.end() && wall->level == level; ++wall) {
    if (building::crossing({a, b}, wall->segment)) return true;
  }
  return false;
}

bool LevelPlan::behind_door(Point a, Point b, double level) const {
  return std::any_of(plan.doors.begin(), plan.doors.end(), [&](const building::Door& door) {
    const Point half = building::left_of(door.normal) * (door.width_m / 2.0);
    return door.level == level && building::crossing({a, b}, {door.at - half, door.at + half});
  });
}

std::optional<std::string> LevelPlan::room_name(const building::PathPoint& place) const {
  const auto index = building::room_index_at(plan, place.at, place.level);
  if (!index) return std::nullopt;
  const building::Room& room = plan.rooms[*index];
  if (room.name.empty()) return room.ref;
  // "Office 1.09" has its number already.
  return room.name.find(room.ref) != std::string::npos ? room.name : room.name + " (" + room.ref + ")";
}

LevelPlan read_level_plan(const navigation::CommLevelMap& map) { return Reader(map).read(); }

}  // namespace fiona::guidance
