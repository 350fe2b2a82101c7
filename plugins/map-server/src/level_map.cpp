#include "level_map.hpp"

#include <cmath>
#include <numbers>

#include "map_name.hpp"

namespace fiona::map_server {
namespace {

using building::Building;
using navigation::MapEdge;
using navigation::MapRoom;

MapRoom::Kind kind_of(building::RoomKind kind) {
  switch (kind) {
    case building::RoomKind::Room: return MapRoom::ROOM;
    case building::RoomKind::Corridor: return MapRoom::CORRIDOR;
    case building::RoomKind::Area: return MapRoom::AREA;
    case building::RoomKind::Stairs: return MapRoom::STAIRWELL;
    case building::RoomKind::Lift: return MapRoom::LIFT_SHAFT;
  }
  return MapRoom::KIND_UNSPECIFIED;
}

MapEdge::Kind kind_of(const building::GraphEdge& edge) {
  switch (edge.passage) {
    case building::Passage::Walk: return edge.outdoors ? MapEdge::OUTDOORS : MapEdge::CORRIDOR;
    case building::Passage::Door: return MapEdge::DOOR;
    case building::Passage::Stairs: return MapEdge::STAIRS;
    case building::Passage::Escalator: return MapEdge::ESCALATOR;
    case building::Passage::Ramp: return MapEdge::RAMP;
    case building::Passage::Lift: return MapEdge::LIFT;
  }
  return MapEdge::KIND_UNSPECIFIED;
}

void fill(navigation::MapRing& to, const building::Ring& ring) {
  for (const building::Point& corner : ring) {
    to.add_x(corner.x_m);
    to.add_y(corner.y_m);
  }
}

void fill(MapRoom& to, const building::Room& room) {
  to.set_id(building::text(room.id));
  to.set_kind(kind_of(room.kind));
  to.set_level(room.level);
  to.set_name(room.name);
  to.set_ref(room.ref);
  to.set_use(room.use);
  fill(*to.mutable_outline(), room.polygon.outer);
  for (const building::Ring& hole : room.polygon.holes) fill(*to.add_holes(), hole);
  to.set_x(room.centre.x_m);
  to.set_y(room.centre.y_m);
  to.set_access(room.access);
}

void fill(navigation::MapWall& to, const building::Wall& wall) {
  to.set_x1(wall.segment.from.x_m);
  to.set_y1(wall.segment.from.y_m);
  to.set_x2(wall.segment.to.x_m);
  to.set_y2(wall.segment.to.y_m);
  to.set_level(wall.level);
  to.set_exterior(wall.exterior);
}

void fill(navigation::MapDoor& to, const building::Door& door) {
  to.set_id(building::text(door.id));
  to.set_name(door.name);
  to.set_x(door.at.x_m);
  to.set_y(door.at.y_m);
  to.set_level(door.level);
  to.set_width(door.width_m);
  to.set_entrance(door.entrance);
  to.set_access(door.access);
}

void add_graph(navigation::CommLevelMap& to, const Building& building) {
  const building::Graph& graph = building.graph();
  for (const building::GraphNode& node : graph.nodes) {
    navigation::MapNode& added = *to.add_nodes();
    added.set_x(node.at.x_m);
    added.set_y(node.at.y_m);
    added.set_level(node.level);
    if (node.room) added.set_room(building::text(building.rooms()[*node.room].id));
  }
  for (const building::GraphEdge& edge : graph.edges) {
    MapEdge& added = *to.add_edges();
    added.set_from(static_cast<std::uint32_t>(edge.from));
    added.set_to(static_cast<std::uint32_t>(edge.to));
    added.set_kind(kind_of(edge));
    added.set_length(edge.length_m);
    added.set_cost(edge.cost_s);
    added.set_one_way(edge.one_way);
    added.set_outdoors(edge.outdoors);
    added.set_rise(edge.rise > 0 ? MapEdge::UP : edge.rise < 0 ? MapEdge::DOWN : MapEdge::RISE_UNSPECIFIED);
    added.set_access(building::access_of(building.plan(), graph, edge));
  }
}

}  // namespace

localisation::CommPosition position_of(const building::Reference& reference, building::Point at, double level) {
  localisation::CommPosition position;
  position.set_x(at.x_m);
  position.set_y(at.y_m);
  position.set_z(level);
  position.set_reference_lat(reference.latitude_deg);
  position.set_reference_long(reference.longitude_deg);
  const double heading_deg = std::fmod(reference.heading_rad * 180.0 / std::numbers::pi + 360.0, 360.0);
  position.set_reference_heading(heading_deg);
  position.set_is_valid(true);
  return position;
}

navigation::CommLevelMap level_map_of(const Building& building, const std::string& name,
                                      const std::set<double>& levels) {
  navigation::CommLevelMap map;
  map.set_name(name);
  map.set_title(building.name());
  *map.mutable_reference() = position_of(building.reference(), {}, 0.0);
  for (const building::Level& level : building.levels()) {
    navigation::MapLevel& added = *map.add_levels();
    added.set_level(level.level);
    added.set_name(level.name);
    added.set_map_name(MapName{name, level.level}.text());
    added.set_floor(level.floor_m);
  }
  const auto wanted = [&](double level) { return levels.empty() || levels.contains(level); };
  for (const building::Room& room : building.rooms()) {
    if (wanted(room.level)) fill(*map.add_rooms(), room);
  }
  for (const building::Wall& wall : building.walls()) {
    if (wanted(wall.level)) fill(*map.add_walls(), wall);
  }
  for (const building::Door& door : building.doors()) {
    if (wanted(door.level)) fill(*map.add_doors(), door);
  }
  add_graph(map, building);
  return map;
}

}  // namespace fiona::map_server
