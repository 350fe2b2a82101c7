#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include "fiona/building/routes.hpp"
#include "wall_tree.hpp"
#include "work.hpp"

namespace fiona::building {
namespace {

/// How far from a door or a corner a person walks, if there is room for it.
constexpr double kClearance_m = 0.6;
constexpr double kBorderStep_m = 0.5;
constexpr double kBorderProbe_m = 0.3;
/// Corners flatter than this (sine) hide nothing.
constexpr double kFlatCorner = 0.05;
/// An end of a line of sight that stands on a border is not behind it.
constexpr double kTouch_m = 0.02;
/// Corners of rooms in halls that are walked around, and edges and work, of what a plan may have, that they leave to
/// what has to be there: beyond that one is led from door to door.
constexpr std::size_t kMostBends = 16'384;
constexpr std::size_t kMostEdgesOfBends = kMostEdges / 2;

double lift_cost_s(double height_m) { return kLiftWait_s + height_m / kLiftPace_mps; }

/// Whether nothing of the room itself is between; walls may be.
bool sees_within(const Room& room, Point a, Point b) {
  const Segment sight{a, b};
  const double length = distance_m(a, b);
  const auto blocks = [&](const Segment& side) {
    const auto at = crossing(sight, side);
    return at && *at * length > kTouch_m && (1.0 - *at) * length > kTouch_m;
  };
  const std::vector<Segment> sides = edges(room.polygon);
  return std::none_of(sides.begin(), sides.end(), blocks) && contains(room.polygon, (a + b) * 0.5);
}

class GraphBuilder {
 public:
  explicit GraphBuilder(const Plan& plan) : plan_(plan), work_(plan.name) {
    for (std::size_t i = 0; i < plan.rooms.size(); ++i) {
      const Polygon& polygon = plan.rooms[i].polygon;
      rooms_of_level_[plan.rooms[i].level].push_back({i, bounds(polygon.outer), area_m2(polygon)});
    }
    for (const Wall& wall : plan.walls) walls_of_level_[wall.level].add(wall.segment);
    for (auto& [level, walls] : walls_of_level_) walls.build();
  }

  Graph build() {
    graph_.nodes_of_room.resize(plan_.rooms.size());
    for (std::size_t room = 0; room < plan_.rooms.size(); ++room) {
      add_node(plan_.rooms[room].centre, plan_.rooms[room].level, room);
      add_corners(room);
    }
    for (const Wall& wall : plan_.walls) {
      if (wall.drawn) add_ends(wall);
    }
    for (const Door& door : plan_.doors) {
      at_ = door.id;
      add_passage(door.at, door.normal, door.level, {.passage = Passage::Door, .access = door.access});
    }
    for (std::size_t room = 0; room < plan_.rooms.size(); ++room) add_open_borders(room);
    for (const Connector& connector : plan_.connectors) add_connector(connector);
    for (const Path& path : plan_.paths) add_path(path);
    first_bend_ = graph_.nodes.size();
    for (const Room& room : plan_.rooms) {
      if (has_walls(room.kind)) add_corners_around(room);
    }
    for (std::size_t room = 0; room < plan_.rooms.size(); ++room) join_room(room);
    graph_.edges_of_node.resize(graph_.nodes.size());
    for (std::size_t i = 0; i < graph_.edges.size(); ++i) {
      graph_.edges_of_node[graph_.edges[i].from].push_back(i);
      graph_.edges_of_node[graph_.edges[i].to].push_back(i);
    }
    return std::move(graph_);
  }

 private:
  std::size_t add_node(Point at, double level, std::optional<std::size_t> room) {
    work_.limit(graph_.nodes.size() + 1, kMostNodes, "places to walk by", at_);
    graph_.nodes.push_back({at, level, room});
    if (room) graph_.nodes_of_room[*room].push_back(graph_.nodes.size() - 1);
    return graph_.nodes.size() - 1;
  }

  /// What an element says of the edges that it becomes.
  struct Way {
    Passage passage = Passage::Walk;
    bool one_way = false;
    bool indoors = true;
    int access = kOpen;
    int rise = 0;
  };

  bool outdoors(const GraphNode& a, const GraphNode& b) const {
    const auto within = [&](const GraphNode& node) {
      return node.room.has_value() || contains(plan_.outline.outer, node.at);
    };
    return !within(a) || !within(b);
  }

  void add_edge(std::size_t from, std::size_t to, const Way& way) {
    work_.limit(graph_.edges.size() + 1, kMostEdges, "ways to walk", at_);
    const GraphNode& a = graph_.nodes[from];
    const GraphNode& b = graph_.nodes[to];
    const double rise_m = std::abs(plan_.heights.floor_m(a.level) - plan_.heights.floor_m(b.level));
    if (way.passage == Passage::Lift) {
      graph_.edges.push_back({from, to, way.passage, rise_m, lift_cost_s(rise_m), false, false, way.access});
      return;
    }
    const double length = distance_m(a.at, b.at);
    const bool climbs = way.passage == Passage::Stairs || way.passage == Passage::Escalator;
    // Steps that are drawn as a point still have to be climbed.
    const double cost = climbs ? std::max(length, rise_m) / kStairsPace_mps : length / kWalkPace_mps;
    const bool out = !way.indoors && outdoors(a, b);
    graph_.edges.push_back({from, to, way.passage, length, cost, way.one_way, out, way.access, way.rise});
  }

  /// Convex corners of obstacles are where shortest ways bend.
  void add_corners(std::size_t room) {
    const Polygon& polygon = plan_.rooms[room].polygon;
    add_corners(room, polygon.outer);
    for (const Ring& hole : polygon.holes) add_corners(room, hole);
  }

  void add_corners(std::size_t index, const Ring& ring) {
    const Room& room = plan_.rooms[index];
    at_ = room.id;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Point corner = ring[i];
      const Point arriving = unit(corner - ring[(i + ring.size() - 1) % ring.size()]);
      const Point leaving = unit(ring[(i + 1) % ring.size()] - corner);
      if (cross(arriving, leaving) > -kFlatCorner) continue;
      const Point inwards = unit(left_of(arriving) + left_of(leaving));
      for (double reach : {kClearance_m * 1.4, kClearance_m, kClearance_m / 3}) {
        const Point p = corner + inwards * reach;
        if (!contains(room.polygon, p) || !in_sight(room, corner + inwards * 0.05, p)) continue;
        add_node(p, room.level, index);
        break;
      }
    }
  }

  /// A room that stands in another one, which need not have a hole there, is walked around.
  void add_corners_around(const Room& room) {
    constexpr double kBeside_m = 0.05;
    const Ring& ring = room.polygon.outer;
    at_ = room.id;
    for (std::size_t i = 0; i < ring.size() && graph_.nodes.size() < first_bend_ + kMostBends; ++i) {
      const Point corner = ring[i];
      const Point arriving = unit(corner - ring[(i + ring.size() - 1) % ring.size()]);
      const Point leaving = unit(ring[(i + 1) % ring.size()] - corner);
      if (cross(arriving, leaving) < kFlatCorner) continue;
      const Point outwards = unit(left_of(arriving) + left_of(leaving)) * -1.0;
      const auto around = room_at(corner + outwards * kBeside_m, room.level);
      if (!around || !contains(plan_.rooms[*around].polygon, corner - outwards * kBeside_m)) continue;
      // With what stands beside it the room may have no corner there: its sides go on.
      const auto goes_on = [&](Point along, Point inwards) {
        const auto there = room_at(corner + (along + inwards * kFlatCorner) * kBeside_m, room.level);
        return !there || (there != around && has_walls(plan_.rooms[*there].kind));
      };
      if (goes_on(arriving, left_of(arriving)) || goes_on(leaving * -1.0, left_of(leaving))) continue;
      for (double reach : {kClearance_m * 1.4, kClearance_m, kClearance_m / 3}) {
        const Point p = corner + outwards * reach;
        if (room_at(p, room.level) != around || !in_sight(plan_.rooms[*around], corner + outwards * kBeside_m, p)) {
          continue;
        }
        add_node(p, room.level, around);
        break;
      }
    }
  }

  /// A wall that ends within a room is walked around there.
  void add_ends(const Wall& wall) {
    const Point along = unit(wall.segment.to - wall.segment.from);
    for (const auto& [end, outwards] :
         {std::pair(wall.segment.to, along), std::pair(wall.segment.from, along * -1.0)}) {
      for (double reach : {kClearance_m, kClearance_m / 3}) {
        const Point p = end + outwards * reach;
        const auto room = room_at(p, wall.level);
        if (!room || wall_between(end + outwards * 0.05, p, wall.level)) continue;
        at_ = plan_.rooms[*room].id;
        add_node(p, wall.level, room);
        break;
      }
    }
  }

  /// A point on one side of a door, within a room and reached straight through the door.
  std::optional<std::size_t> threshold(Point at, Point side, double level) {
    for (double reach : {kClearance_m, kClearance_m / 2, kClearance_m / 4}) {
      const Point p = at + side * reach;
      const auto room = room_at(p, level);
      if (room && !wall_between(at, p, level)) return add_node(p, level, room);
    }
    return std::nullopt;
  }

  void add_passage(Point at, Point normal, double level, const Way& way) {
    const std::size_t middle = add_node(at, level, std::nullopt);
    by_place_[{at.x_m, at.y_m, level}] = middle;
    for (const Point side : {normal, normal * -1.0}) {
      if (const auto inside = threshold(at, side, level)) add_edge(middle, *inside, way);
    }
  }

  /// Corridors and areas are open towards each other: one passage in the middle of each common border.
  void add_open_borders(std::size_t index) {
    const Room& room = plan_.rooms[index];
    at_ = room.id;
    if (has_walls(room.kind)) return;
    for (const Segment& side : edges(room.polygon)) {
      const double length = distance_m(side.from, side.to);
      const int steps = std::max(1, static_cast<int>(length / kBorderStep_m));
      int first = 0;
      std::optional<std::size_t> before = neighbour(index, side, 0.5 / steps);
      for (int step = 1; step <= steps; ++step) {
        const auto here = step < steps ? neighbour(index, side, (step + 0.5) / steps) : std::nullopt;
        if (step < steps && here == before) continue;
        if (before) add_border(index, *before, side, (first + step) / (2.0 * steps));
        first = step;
        before = here;
      }
    }
  }

  /// The room beyond an edge at a share of its length, if nothing stands between.
  std::optional<std::size_t> neighbour(std::size_t index, const Segment& side, double share) {
    const Point at = side.from + (side.to - side.from) * share;
    const Point inwards = left_of(unit(side.to - side.from)) * kBorderProbe_m;
    const double level = plan_.rooms[index].level;
    const auto beyond = room_at(at - inwards, level);
    if (!beyond || *beyond == index || at_door(at, level)) return std::nullopt;
    if (wall_between(at + inwards, at - inwards, level)) return std::nullopt;
    return beyond;
  }

  /// The gap of a door is no open border: it has its passage already.
  bool at_door(Point at, double level) {
    work_.spend(plan_.doors.size(), at_);
    return std::any_of(plan_.doors.begin(), plan_.doors.end(), [&](const Door& door) {
      return door.level == level && distance_m(door.at, at) < door.width_m / 2 + 0.1;
    });
  }

  void add_border(std::size_t index, std::size_t beyond, const Segment& side, double share) {
    const bool both_open = !has_walls(plan_.rooms[beyond].kind);
    const Point at = side.from + (side.to - side.from) * share;
    // The same border is met again from the other side; the corridor with the lower index draws it.
    const bool shared = both_open && distance_to_edges(plan_.rooms[beyond], at) < 0.1;
    if (shared && beyond < index) return;
    add_passage(at, left_of(unit(side.to - side.from)), plan_.rooms[index].level, {});
  }

  double distance_to_edges(const Room& room, Point p) {
    double nearest = std::numeric_limits<double>::max();
    work_.spend(8 * room.polygon.outer.size(), at_);
    for (const Segment& side : edges(room.polygon)) nearest = std::min(nearest, distance_m(p, side));
    return nearest;
  }

  /// One node for one place: lines that share a node of the file, or end at a door, are joined there.
  std::size_t node_at(const PathPoint& p) {
    const auto [known, added] = by_place_.try_emplace({p.at.x_m, p.at.y_m, p.level}, 0);
    if (added) known->second = add_node(p.at, p.level, room_at(p.at, p.level));
    return known->second;
  }

  void add_connector(const Connector& connector) {
    at_ = connector.id;
    std::vector<std::size_t> nodes;
    for (const PathPoint& p : connector.path) nodes.push_back(node_at(p));
    if (connector.kind == ConnectorKind::Lift) {
      for (std::size_t i = 0; i < nodes.size(); ++i) {
        for (std::size_t j = i + 1; j < nodes.size(); ++j)
          add_edge(nodes[i], nodes[j], {.passage = Passage::Lift, .access = connector.access});
      }
      return;
    }
    const Passage passage = connector.kind == ConnectorKind::Stairs      ? Passage::Stairs
                            : connector.kind == ConnectorKind::Escalator ? Passage::Escalator
                                                                         : Passage::Ramp;
    for (std::size_t i = 1; i < nodes.size(); ++i) {
      add_edge(nodes[i - 1], nodes[i], {passage, connector.one_way, connector.indoors, connector.access});
    }
    attach_end(nodes.front(), connector.path[0].at - connector.path[1].at);
    attach_end(nodes.back(), connector.path.back().at - connector.path[connector.path.size() - 2].at);
  }

  /// Stairs often end on the border of a room: the room beyond the last step is the one they lead to.
  void attach_end(std::size_t node, Point outwards) {
    GraphNode& end = graph_.nodes[node];
    if (end.room) return;
    end.room = room_at(end.at + unit(outwards) * kBorderProbe_m, end.level);
    if (end.room) graph_.nodes_of_room[*end.room].push_back(node);
  }

  void add_path(const Path& path) {
    at_ = path.id;
    const Passage steps = path.conveys ? Passage::Escalator : Passage::Stairs;
    const Way way{path.steps ? steps : Passage::Walk, path.one_way, path.indoors, path.access,
                  path.steps ? path.rise : 0};
    for (std::size_t i = 1; i < path.points.size(); ++i) {
      add_edge(node_at(path.points[i - 1]), node_at(path.points[i]), way);
    }
  }

  void join_room(std::size_t index) {
    const std::vector<std::size_t>& nodes = graph_.nodes_of_room[index];
    at_ = plan_.rooms[index].id;
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      for (std::size_t j = i + 1; j < nodes.size(); ++j) {
        const bool all_bends = nodes[j] >= first_bend_;  // from here on
        if (all_bends && (graph_.edges.size() >= kMostEdgesOfBends || work_.is_half_spent())) break;
        if (in_sight(plan_.rooms[index], graph_.nodes[nodes[i]].at, graph_.nodes[nodes[j]].at)) {
          add_edge(nodes[i], nodes[j], {});
        }
      }
    }
  }

  struct PlacedRoom {
    std::size_t index = 0;
    Box box{};
    double area_m2 = 0.0;
  };

  /// As room_index_at, with the rooms of a level at hand.
  std::optional<std::size_t> room_at(Point p, double level) {
    const auto rooms = rooms_of_level_.find(level);
    if (rooms == rooms_of_level_.end()) return std::nullopt;
    const PlacedRoom* best = nullptr;
    work_.spend(rooms->second.size(), at_);
    for (const PlacedRoom& room : rooms->second) {
      if (p.x_m < room.box.low.x_m || p.x_m > room.box.high.x_m || p.y_m < room.box.low.y_m ||
          p.y_m > room.box.high.y_m || (best != nullptr && room.area_m2 >= best->area_m2)) {
        continue;
      }
      work_.spend(4 * plan_.rooms[room.index].polygon.outer.size(), at_);
      if (contains(plan_.rooms[room.index].polygon, p)) best = &room;
    }
    return best == nullptr ? std::nullopt : std::optional(best->index);
  }

  bool wall_between(Point a, Point b, double level) {
    const auto walls = walls_of_level_.find(level);
    if (walls == walls_of_level_.end()) return false;
    std::size_t steps = 0;
    const bool between = walls->second.meets({a, b}, steps);
    work_.spend(10 * steps, at_);
    return between;
  }

  /// As sees(), with the walls of a level at hand.
  bool in_sight(const Room& room, Point a, Point b) {
    work_.spend(8 * room.polygon.outer.size(), at_);
    if (distance_m(a, b) < kTouch_m) return true;
    const Point inwards = unit(b - a) * kTouch_m;
    return sees_within(room, a, b) && !wall_between(a + inwards, b - inwards, room.level);
  }

  const Plan& plan_;
  Work work_;
  ElementId at_{};  ///< the element that is worked on, for errors
  std::map<double, std::vector<PlacedRoom>> rooms_of_level_{};
  std::map<double, WallTree> walls_of_level_{};
  Graph graph_{};
  std::size_t first_bend_ = 0;  ///< from this node on, all are at corners of rooms in halls
  std::map<std::tuple<double, double, double>, std::size_t> by_place_{};
};

}  // namespace

bool walls_between(const Plan& plan, Point a, Point b, double level) {
  const auto on_level = std::equal_range(plan.walls.begin(), plan.walls.end(), Wall{{}, level, 0.0, false},
                                         [](const Wall& left, const Wall& right) { return left.level < right.level; });
  return std::any_of(on_level.first, on_level.second, [&](const Wall& wall) {
    return !apart({a, b}, wall.segment) && crossing({a, b}, wall.segment).has_value();
  });
}

bool sees(const Plan& plan, const Room& room, Point a, Point b) {
  if (distance_m(a, b) < kTouch_m) return true;
  const Point inwards = unit(b - a) * kTouch_m;
  return sees_within(room, a, b) && !walls_between(plan, a + inwards, b - inwards, room.level);
}

std::optional<std::size_t> room_index_at(const Plan& plan, Point p, double level) {
  std::optional<std::size_t> best;
  double smallest_m2 = std::numeric_limits<double>::max();
  for (std::size_t i = 0; i < plan.rooms.size(); ++i) {
    const Room& room = plan.rooms[i];
    if (room.level != level || !contains(room.polygon, p)) continue;
    const double area = area_m2(room.polygon);
    if (area < smallest_m2) best = i, smallest_m2 = area;
  }
  return best;
}

int access_of(const Plan& plan, const Graph& graph, const GraphEdge& edge) {
  int access = edge.own_access;
  for (const std::size_t node : {edge.from, edge.to}) {
    if (const auto room = graph.nodes[node].room) access = std::max(access, plan.rooms[*room].access);
  }
  return access;
}

Graph build_graph(const Plan& plan) { return GraphBuilder(plan).build(); }

}  // namespace fiona::building
