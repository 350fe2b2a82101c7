#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "fiona/building/plan.hpp"

namespace fiona::building {

/// How one gets along an edge of the graph.
enum class Passage : std::uint8_t { Walk, Door, Stairs, Escalator, Ramp, Lift };

/// Paces that turn lengths into costs. A lift is waited for once per ride.
inline constexpr double kWalkPace_mps = 1.3;
inline constexpr double kStairsPace_mps = 0.7;
inline constexpr double kLiftPace_mps = 1.0;
inline constexpr double kLiftWait_s = 15.0;

struct GraphNode {
  Point at{};
  double level = 0.0;
  std::optional<std::size_t> room{};  ///< index into Plan::rooms
};

struct GraphEdge {
  std::size_t from = 0;
  std::size_t to = 0;
  Passage passage = Passage::Walk;
  double length_m = 0.0;  ///< in the plane; height for a lift
  double cost_s = 0.0;
  bool one_way = false;  ///< from `from` to `to` only
  bool outdoors = false;
  int own_access = 0;  ///< of the door, path, stairs or lift itself; a room has its own
  int rise = 0;        ///< of steps on one level: 1 up from `from` to `to`, -1 down; 0: not told
};

/// Where one can walk. Inside a room, nodes that see each other are joined; rooms are joined by doors and by
/// open borders, levels by stairs, ramps, escalators and lifts.
struct Graph {
  std::vector<GraphNode> nodes{};
  std::vector<GraphEdge> edges{};
  std::vector<std::vector<std::size_t>> edges_of_node{};
  std::vector<std::vector<std::size_t>> nodes_of_room{};
};

struct RouteOptions {
  bool stairs = true;  ///< stairs and escalators may be used
  bool lift = true;
  bool outdoors = true;  ///< the building may be left
  /// The walker's authentication level, 0 to 9. One may be in the room where one is.
  int access = 9;
};

struct RoutePoint {
  Point at{};
  double level = 0.0;
  Passage passage = Passage::Walk;    ///< by which this point is reached from the one before
  bool outdoors = false;              ///< whether that was out of the building
  std::optional<std::size_t> room{};  ///< index into Plan::rooms
  int rise = 0;                       ///< of steps on one level: 1 up to this point, -1 down; 0: not told
};

struct Route {
  std::vector<RoutePoint> points{};  ///< first: the start; last: the goal
  double length_m = 0.0;
  double cost_s = 0.0;
};

/// Builds the graph of a plan. Cost: for each room the square of its doors, its corners and those of the rooms in it,
/// times its edges and the walls near a line.
Graph build_graph(const Plan& plan);

/// Nearest node of the graph on the same level, for a start or goal outside of all rooms, is taken up to here: one in
/// sight, if there is any.
inline constexpr double kSnap_m = 5.0;

/// A node that one reaches straight from a place.
struct Approach {
  std::size_t node = 0;
  double length_m = 0.0;
};

/// Whether a wall of the level lies between two points.
bool walls_between(const Plan& plan, Point a, Point b, double level);

/// The nodes of the rooms around a place that are seen from there, else the nearest one on its level.
std::vector<Approach> approaches(const Plan& plan, const Graph& graph, const PathPoint& place);

/// Which edges a walker may take. Where one is already, one may be: else there were no way out.
class Permission {
 public:
  Permission(const Plan& plan, const Graph& graph, const PathPoint& from, const RouteOptions& options);
  /// Whether the edge may be taken towards its end `next`.
  bool takes(const GraphEdge& edge, std::size_t next) const;

 private:
  const Plan& plan_;
  const Graph& graph_;
  const RouteOptions options_;
  const std::optional<std::size_t> own_;
};

/// The way straight to a place in the same room, if nothing is between.
std::optional<Route> straight_route(const Plan& plan, const PathPoint& from, const PathPoint& to);

/// The quickest way through the graph (Dijkstra).
std::optional<Route> find_route(const Plan& plan, const Graph& graph, const PathPoint& from, const PathPoint& to,
                                const RouteOptions& options);

/// The access of an edge: the highest of its element and of the rooms at its ends.
int access_of(const Plan& plan, const Graph& graph, const GraphEdge& edge);

/// Whether one can walk straight from `a` to `b` within the room.
bool sees(const Plan& plan, const Room& room, Point a, Point b);

/// The index of the smallest room around `p`.
std::optional<std::size_t> room_index_at(const Plan& plan, Point p, double level);

}  // namespace fiona::building
