#include "fiona/building/routes.hpp"

#include <algorithm>
#include <limits>
#include <queue>

namespace fiona::building {
namespace {

constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr std::size_t kStart = std::numeric_limits<std::size_t>::max();

bool allowed(const GraphEdge& edge, const RouteOptions& options) {
  if (edge.outdoors && !options.outdoors) return false;
  if (edge.passage == Passage::Lift) return options.lift;
  return options.stairs || (edge.passage != Passage::Stairs && edge.passage != Passage::Escalator);
}

struct Search {
  std::vector<double> cost_s;
  std::vector<std::size_t> edge;  ///< by which a node was reached; kStart: from the start
};

Search search(const Graph& graph, const std::vector<Approach>& starts, const Permission& permission) {
  Search found{std::vector<double>(graph.nodes.size(), kNever), std::vector<std::size_t>(graph.nodes.size(), kStart)};
  using Entry = std::pair<double, std::size_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  for (const Approach& start : starts) {
    const double cost = start.length_m / kWalkPace_mps;
    if (cost < found.cost_s[start.node]) open.emplace(found.cost_s[start.node] = cost, start.node);
  }
  while (!open.empty()) {
    const auto [cost, node] = open.top();
    open.pop();
    if (cost > found.cost_s[node]) continue;
    for (std::size_t index : graph.edges_of_node[node]) {
      const GraphEdge& edge = graph.edges[index];
      const std::size_t next = edge.from == node ? edge.to : edge.from;
      if (!permission.takes(edge, next)) continue;
      const double reached = cost + edge.cost_s;
      if (reached >= found.cost_s[next]) continue;
      found.cost_s[next] = reached;
      found.edge[next] = index;
      open.emplace(reached, next);
    }
  }
  return found;
}

void add_point(Route& route, const RoutePoint& point) {
  const bool same =
      !route.points.empty() && route.points.back().at == point.at && route.points.back().level == point.level;
  if (!same) route.points.push_back(point);
}

}  // namespace

std::vector<Approach> approaches(const Plan& plan, const Graph& graph, const PathPoint& place) {
  std::vector<Approach> found;
  for (std::size_t i = 0; i < plan.rooms.size(); ++i) {
    const Room& room = plan.rooms[i];
    if (room.level != place.level || !contains(room.polygon, place.at)) continue;
    for (std::size_t node : graph.nodes_of_room[i]) {
      const Point at = graph.nodes[node].at;
      if (sees(plan, room, place.at, at)) found.push_back({node, distance_m(place.at, at)});
    }
  }
  if (!found.empty()) return found;
  for (std::size_t i = 0; i < graph.nodes.size(); ++i) {
    const double length = distance_m(graph.nodes[i].at, place.at);
    if (graph.nodes[i].level == place.level && length <= kSnap_m) found.push_back({i, length});
  }
  if (found.empty()) return found;
  // Who is beside a building does not begin through its wall; but a place may err, and be taken for one outside.
  const auto in_sight = [&](const Approach& one) {
    return !walls_between(plan, place.at, graph.nodes[one.node].at, place.level);
  };
  const auto hidden = std::partition(found.begin(), found.end(), in_sight);
  const auto end = hidden == found.begin() ? found.end() : hidden;
  return {*std::min_element(found.begin(), end, [](const auto& a, const auto& b) { return a.length_m < b.length_m; })};
}

Permission::Permission(const Plan& plan, const Graph& graph, const PathPoint& from, const RouteOptions& options)
    : plan_(plan), graph_(graph), options_(options), own_(room_index_at(plan, from.at, from.level)) {}

bool Permission::takes(const GraphEdge& edge, std::size_t next) const {
  if (edge.one_way && edge.from == next) return false;
  if (!allowed(edge, options_) || edge.own_access > options_.access) return false;
  const auto room = graph_.nodes[next].room;
  return !room || room == own_ || plan_.rooms[*room].access <= options_.access;
}

std::optional<Route> straight_route(const Plan& plan, const PathPoint& from, const PathPoint& to) {
  if (from.level != to.level) return std::nullopt;
  for (std::size_t i = 0; i < plan.rooms.size(); ++i) {
    const Room& room = plan.rooms[i];
    if (room.level != from.level || !contains(room.polygon, from.at) || !contains(room.polygon, to.at)) continue;
    if (!sees(plan, room, from.at, to.at)) continue;
    const double length = distance_m(from.at, to.at);
    return Route{{{from.at, from.level, Passage::Walk, false, i}, {to.at, to.level, Passage::Walk, false, i}},
                 length,
                 length / kWalkPace_mps};
  }
  return std::nullopt;
}

std::optional<Route> find_route(const Plan& plan, const Graph& graph, const PathPoint& from, const PathPoint& to,
                                const RouteOptions& options) {
  // No detour over the nodes of the room.
  if (auto direct = straight_route(plan, from, to)) return direct;
  const Search found = search(graph, approaches(plan, graph, from), Permission(plan, graph, from, options));
  Approach goal{kStart, 0.0};
  double best_s = kNever;
  for (const Approach& end : approaches(plan, graph, to)) {
    const double cost = found.cost_s[end.node] + end.length_m / kWalkPace_mps;
    if (cost < best_s) goal = end, best_s = cost;
  }
  if (goal.node == kStart) return std::nullopt;

  std::vector<RoutePoint> backwards{{to.at, to.level, Passage::Walk, false, room_index_at(plan, to.at, to.level)}};
  double length = goal.length_m;
  for (std::size_t node = goal.node;;) {
    const GraphNode& at = graph.nodes[node];
    const std::size_t index = found.edge[node];
    const bool first = index == kStart;
    if (first) {
      backwards.push_back({at.at, at.level, Passage::Walk, false, at.room});
      break;
    }
    const GraphEdge& edge = graph.edges[index];
    backwards.push_back(
        {at.at, at.level, edge.passage, edge.outdoors, at.room, edge.to == node ? edge.rise : -edge.rise});
    length += edge.length_m;
    node = edge.from == node ? edge.to : edge.from;
  }
  length += distance_m(from.at, backwards.back().at);
  Route route{{}, length, best_s};
  add_point(route, {from.at, from.level, Passage::Walk, false, room_index_at(plan, from.at, from.level)});
  for (auto point = backwards.rbegin(); point != backwards.rend(); ++point) add_point(route, *point);
  return route;
}

}  // namespace fiona::building
