#include "task_graph.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <numeric>
#include <queue>
#include <set>
#include <utility>

#include <fiona/building/geometry.hpp>
#include <fiona/error.hpp>

namespace fiona::guidance {
namespace {

using building::GraphEdge;
using building::Passage;
using building::PathPoint;
using building::RoutePoint;

struct Kind {
  Passage passage;
  const char* action;
  const char* predicate;
  const char* cost;
};
constexpr std::array<Kind, 6> kKinds{{{Passage::Walk, "walk", "walkway", "walk-time"},
                                      {Passage::Door, "pass", "doorway", "pass-time"},
                                      {Passage::Stairs, "climb", "stairs", "climb-time"},
                                      {Passage::Escalator, "take-escalator", "escalator", "escalator-time"},
                                      {Passage::Ramp, "take-ramp", "ramp", "ramp-time"},
                                      {Passage::Lift, "ride", "lift", "ride-time"}}};

constexpr std::size_t kWalk = 0, kDoor = 1;  // of kKinds
constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
constexpr double kNever = std::numeric_limits<double>::infinity();

std::size_t kind_of(const GraphEdge& edge) { return static_cast<std::size_t>(edge.passage); }

std::string place(std::uint32_t node) { return "n" + std::to_string(node); }

std::string written_domain() {
  std::string predicates = "(at ?p - place)";
  std::string functions = "(total-cost) - number";
  std::string actions;
  for (const Kind& kind : kKinds) {
    const std::string from_to = " ?from ?to";
    predicates += std::string(" (") + kind.predicate + from_to + " - place)";
    functions += std::string(" (") + kind.cost + from_to + " - place) - number";
    actions += std::string("\n  (:action ") + kind.action + " :parameters (?from ?to - place)\n" +
               "    :precondition (and (at ?from) (" + kind.predicate + from_to + "))\n" +
               "    :effect (and (not (at ?from)) (at ?to) (increase (total-cost) (" + kind.cost + from_to + "))))";
  }
  return "(define (domain ways-through-a-building)\n  (:requirements :strips :typing :action-costs)\n"
         "  (:types place)\n  (:predicates " +
         predicates + ")\n  (:functions " + functions + ")" + actions + ")\n";
}

}  // namespace

const std::string& task_domain() {
  static const std::string text = written_domain();
  return text;
}

TaskGraph::TaskGraph(const LevelPlan& plan, const PathPoint& from, const building::RouteOptions& options)
    : plan_(plan),
      options_(options),
      closed_room_(closed_room(from, options)),
      permission_(plan.plan, plan.graph, from, options),
      part_of_(kKinds.size(), std::vector<Index>(plan.graph.nodes.size(), kNone)) {
  join_parts();
  find_gates();
}

std::optional<std::size_t> TaskGraph::closed_room(const PathPoint& from, const building::RouteOptions& options) const {
  const auto room = building::room_index_at(plan_.plan, from.at, from.level);
  return room && plan_.plan.rooms[*room].access > options.access ? room : std::nullopt;
}

bool TaskGraph::suits(const PathPoint& from, const building::RouteOptions& options) const {
  return options.stairs == options_.stairs && options.lift == options_.lift && options.outdoors == options_.outdoors &&
         options.access == options_.access && closed_room(from, options) == closed_room_;
}

bool TaskGraph::takes(std::size_t edge, Index next, bool backwards) const {
  const GraphEdge& one = plan_.graph.edges[edge];
  const std::size_t other = one.from == next ? one.to : one.from;
  return permission_.takes(one, backwards ? other : next);
}

/// Nodes that edges of one kind join are a part: a room with its corridors, a door, a flight of stairs, a lift.
void TaskGraph::join_parts() {
  const building::Graph& graph = plan_.graph;
  Index parts = 0;
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    std::vector<Index> joined(graph.nodes.size());
    std::iota(joined.begin(), joined.end(), 0u);
    const auto root = [&joined](std::size_t node) {
      while (joined[node] != node) node = joined[node] = joined[joined[node]];
      return static_cast<Index>(node);
    };
    std::vector<bool> used(graph.nodes.size());
    for (const GraphEdge& edge : graph.edges) {
      if (kind_of(edge) != kind) continue;
      if (!permission_.takes(edge, edge.to) && !permission_.takes(edge, edge.from)) continue;
      used[edge.from] = used[edge.to] = true;
      joined[root(edge.from)] = root(edge.to);
    }
    std::vector<Index> number(graph.nodes.size(), kNone);
    for (std::size_t node = 0; node < graph.nodes.size(); ++node) {
      if (!used[node]) continue;
      Index& part = number[root(node)];
      if (part == kNone) part = parts++;
      part_of_[kind][node] = part;
    }
  }
  gates_.resize(parts);
}

void TaskGraph::find_gates() {
  for (Index node = 0; node < plan_.graph.nodes.size(); ++node) {
    std::vector<Index> parts;
    for (const auto& of_kind : part_of_) {
      if (of_kind[node] != kNone) parts.push_back(of_kind[node]);
    }
    if (parts.size() < 2) continue;
    for (const Index part : parts) gates_[part].push_back(node);
  }
}

/// Dijkstra's algorithm along edges of one kind, from all sources at once; backwards: towards them.
std::vector<TaskGraph::Way> TaskGraph::ways(std::size_t kind, const std::vector<Source>& from,
                                            const std::vector<Index>& to, bool backwards) const {
  const building::Graph& graph = plan_.graph;
  std::vector<double> cost(graph.nodes.size(), kNever);
  std::vector<Index> by(graph.nodes.size(), kNone);
  using Entry = std::pair<double, Index>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  for (const Source& source : from) {
    if (source.cost_s < cost[source.node]) open.emplace(cost[source.node] = source.cost_s, source.node);
  }
  while (!open.empty()) {
    const auto [reached, node] = open.top();
    open.pop();
    if (reached > cost[node]) continue;
    for (const std::size_t index : graph.edges_of_node[node]) {
      const GraphEdge& edge = graph.edges[index];
      const auto next = static_cast<Index>(edge.from == node ? edge.to : edge.from);
      if (kind_of(edge) != kind || reached + edge.cost_s >= cost[next] || !takes(index, next, backwards)) continue;
      by[next] = static_cast<Index>(index);
      open.emplace(cost[next] = reached + edge.cost_s, next);
    }
  }
  std::vector<Way> found;
  for (const Index end : to) {
    if (cost[end] == kNever) continue;
    Way way{end, cost[end], {}};
    for (Index node = end; by[node] != kNone;) {
      const GraphEdge& edge = graph.edges[by[node]];
      way.edges.push_back(by[node]);
      node = static_cast<Index>(edge.from == node ? edge.to : edge.from);
    }
    if (!backwards) std::reverse(way.edges.begin(), way.edges.end());
    found.push_back(std::move(way));
  }
  return found;
}

const std::vector<TaskGraph::Way>& TaskGraph::ways_from(std::size_t kind, Index gate) {
  const auto [known, added] = known_.try_emplace({kind, gate});
  if (added) known->second = ways(kind, {{gate, 0.0}}, gates_[part_of_[kind][gate]], false);
  return known->second;
}

/// Puts one request together.
class TaskGraph::Draft {
 public:
  Draft(TaskGraph& of, const PathPoint& from, const PathPoint& to)
      : of_(of), graph_(of.plan_.graph), from_(point_of(from)), to_(point_of(to)) {
    for (const building::Approach& end : building::approaches(of.plan_.plan, graph_, from)) add(start_, end);
    for (const building::Approach& end : building::approaches(of.plan_.plan, graph_, to)) add(goal_, end);
    made_.start_ = from_;
    find_living();
    leave_out_detours();
  }

  Request make(const PathPoint& from, const PathPoint& to) {
    if (auto route = building::straight_route(of_.plan_.plan, from, to)) {
      gates_.clear();
      add_task(0, "start", "goal", {route->cost_s, route->length_m, {to_}});
      write();
      return std::move(made_);
    }
    for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
      add_from_start(kind);
      add_to_goal(kind);
    }
    for (const Index gate : gates_) add_between(gate);
    write();
    return std::move(made_);
  }

 private:
  using Task = Request::Task;

  RoutePoint point_of(const PathPoint& at) const {
    return {at.at, at.level, Passage::Walk, false, building::room_index_at(of_.plan_.plan, at.at, at.level)};
  }

  static void add(std::vector<Source>& to, const building::Approach& end) {
    to.push_back({static_cast<Index>(end.node), end.length_m / building::kWalkPace_mps});
  }

  /// The ends from which one goes on by this kind: on foot, unless one stands where nobody walks, as on stairs.
  std::vector<Source> of_kind(const std::vector<Source>& ends, std::size_t kind) const {
    std::vector<Source> found;
    for (const Source& end : ends) {
      const bool walks = of_.part_of_[0][end.node] != kNone;
      if (of_.part_of_[kind][end.node] != kNone && (kind == 0 || !walks)) found.push_back(end);
    }
    return found;
  }

  std::vector<Index> parts_of(Index node) const {
    std::vector<Index> parts;
    for (const auto& kind : of_.part_of_) {
      if (kind[node] != kNone) parts.push_back(kind[node]);
    }
    return parts;
  }

  /// What no way to the goal leads through is left out: a part that has one way in and is neither start nor goal, and
  /// gates between parts that are left out.
  void find_living() {
    std::vector<std::size_t> doors(of_.gates_.size());
    for (std::size_t part = 0; part < doors.size(); ++part) doors[part] = of_.gates_[part].size();
    for (const auto* ends : {&start_, &goal_}) {
      std::set<Index> touched;
      for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
        for (const Source& end : of_kind(*ends, kind)) touched.insert(of_.part_of_[kind][end.node]);
      }
      for (const Index part : touched) ++doors[part];
    }
    std::vector<bool> dead_part(doors.size()), dead_gate(graph_.nodes.size());
    std::vector<std::size_t> dead;
    for (std::size_t part = 0; part < doors.size(); ++part) {
      if (doors[part] < 2) dead_part[part] = true, dead.push_back(part);
    }
    while (!dead.empty()) {
      const std::size_t part = dead.back();
      dead.pop_back();
      for (const Index gate : of_.gates_[part]) {
        if (dead_gate[gate]) continue;
        const std::vector<Index> around = parts_of(gate);
        if (std::count_if(around.begin(), around.end(), [&](Index other) { return !dead_part[other]; }) > 1) continue;
        dead_gate[gate] = true;
        for (const Index other : around) {
          if (!dead_part[other] && --doors[other] < 2) dead_part[other] = true, dead.push_back(other);
        }
      }
    }
    for (std::size_t part = 0; part < of_.gates_.size(); ++part) {
      if (dead_part[part]) continue;
      for (const Index gate : of_.gates_[part]) {
        if (!dead_gate[gate]) gates_.insert(gate);
      }
    }
  }

  double cost_s(std::size_t kind, Index from, Index to) {
    for (const Way& way : of_.ways_from(kind, from)) {
      if (way.to == to) return way.cost_s;
    }
    return kNever;
  }

  /// A door of a room, by its two sides.
  struct Leaf {
    Index inside = 0, outside = 0;
  };
  std::optional<Leaf> leaf_of(Index gate) const {
    const Index door = of_.part_of_[kDoor][gate];
    if (door == kNone || parts_of(gate).size() != 2 || of_.gates_[door].size() != 2) return std::nullopt;
    const Index other = of_.gates_[door][of_.gates_[door].front() == gate ? 1 : 0];
    if (of_.part_of_[kWalk][other] == kNone || parts_of(other).size() != 2) return std::nullopt;
    return Leaf{gate, other};
  }

  /// Whether nobody gains by walking in by one of these doors and out by another: around it is as quick.
  bool is_detour(const std::vector<Leaf>& doors) {
    for (const Leaf& in : doors) {
      for (const Leaf& out : doors) {
        if (in.inside == out.inside) continue;
        const double through_s = cost_s(kDoor, in.outside, in.inside) + cost_s(kWalk, in.inside, out.inside) +
                                 cost_s(kDoor, out.inside, out.outside);
        if (through_s < cost_s(kWalk, in.outside, out.outside)) return false;
      }
    }
    return true;
  }

  /// What the quickest way never leads through is left out, too: a room with several doors to the same corridor, say,
  /// which would each be a task to each other one.
  void leave_out_detours() {
    std::set<Index> ends;  // the parts that one begins or ends in: a room, or a doorway
    for (const auto* of : {&start_, &goal_}) {
      for (const Source& end : *of) {
        for (const Index part : parts_of(end.node)) ends.insert(part);
      }
    }
    std::map<Index, std::vector<Index>> living;  // by part on foot
    for (const Index gate : gates_) {
      if (of_.part_of_[kWalk][gate] != kNone) living[of_.part_of_[kWalk][gate]].push_back(gate);
    }
    for (const auto& [part, gates] : living) {
      if (ends.contains(part)) continue;
      std::vector<Leaf> doors;
      for (const Index gate : gates) {
        const auto door = leaf_of(gate);
        if (door && !ends.contains(of_.part_of_[kDoor][gate])) doors.push_back(*door);
      }
      const auto leads_to = [&](const Leaf& door) { return of_.part_of_[kWalk][door.outside]; };
      const bool to_one = doors.size() == gates.size() && leads_to(doors.front()) != part &&
                          std::all_of(doors.begin(), doors.end(),
                                      [&](const Leaf& door) { return leads_to(door) == leads_to(doors.front()); });
      if (!to_one || !is_detour(doors)) continue;
      for (const Leaf& door : doors) gates_.erase(door.inside), gates_.erase(door.outside);
    }
  }

  /// The living gates of the parts that these nodes are in.
  std::vector<Index> gates_around(const std::vector<Source>& ends, std::size_t kind) const {
    std::set<Index> parts;
    for (const Source& end : ends) parts.insert(of_.part_of_[kind][end.node]);
    std::vector<Index> found;
    for (const Index part : parts) {
      for (const Index gate : of_.gates_[part]) {
        if (gates_.contains(gate)) found.push_back(gate);
      }
    }
    return found;
  }

  RoutePoint point_of(Index node, Passage passage, bool outdoors, int rise = 0) const {
    return {graph_.nodes[node].at, graph_.nodes[node].level, passage, outdoors, graph_.nodes[node].room, rise};
  }

  /// Along the edges from a node; the node itself is not in it.
  void follow(Task& task, Index node, const std::vector<Index>& edges) const {
    for (const Index index : edges) {
      const GraphEdge& edge = graph_.edges[index];
      const bool forwards = edge.from == node;
      node = static_cast<Index>(forwards ? edge.to : edge.from);
      task.length_m += edge.length_m;
      task.points.push_back(point_of(node, edge.passage, edge.outdoors, forwards ? edge.rise : -edge.rise));
    }
  }

  /// The other end of a way, of which one end is known.
  Index far_end(Index node, const std::vector<Index>& edges, bool from_its_end) const {
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const GraphEdge& edge = graph_.edges[from_its_end ? edges[edges.size() - 1 - i] : edges[i]];
      node = static_cast<Index>(edge.from == node ? edge.to : edge.from);
    }
    return node;
  }

  Task from_start(const Way& way) const {
    const Index first = far_end(way.to, way.edges, true);
    Task task{way.cost_s, building::distance_m(from_.at, graph_.nodes[first].at), {}};
    task.points.push_back(point_of(first, Passage::Walk, false));
    follow(task, first, way.edges);
    return task;
  }

  void add_from_start(std::size_t kind) {
    const auto starts = of_kind(start_, kind);
    if (starts.empty()) return;
    for (const Way& way : of_.ways(kind, starts, gates_around(starts, kind), false)) {
      add_task(kind, "start", place(way.to), from_start(way));
    }
    const auto goals = of_kind(goal_, kind);
    std::vector<Index> ends;
    for (const Source& goal : goals) ends.push_back(goal.node);
    std::optional<Task> best;
    for (const Way& way : of_.ways(kind, starts, ends, false)) {
      Task task = from_start(way);
      for (const Source& goal : goals) {
        if (goal.node != way.to || (best && best->cost_s <= way.cost_s + goal.cost_s)) continue;
        best = task;
        best->cost_s = way.cost_s + goal.cost_s;
        best->length_m += building::distance_m(graph_.nodes[way.to].at, to_.at);
        best->points.push_back(to_);
      }
    }
    if (best) add_task(kind, "start", "goal", std::move(*best));
  }

  void add_to_goal(std::size_t kind) {
    const auto goals = of_kind(goal_, kind);
    if (goals.empty()) return;
    for (const Way& way : of_.ways(kind, goals, gates_around(goals, kind), true)) {
      Task task{way.cost_s, 0.0, {}};
      follow(task, way.to, way.edges);
      const Index last = far_end(way.to, way.edges, false);
      task.length_m += building::distance_m(graph_.nodes[last].at, to_.at);
      task.points.push_back(to_);
      add_task(kind, place(way.to), "goal", std::move(task));
    }
  }

  void add_between(Index gate) {
    for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
      if (of_.part_of_[kind][gate] == kNone) continue;
      for (const Way& way : of_.ways_from(kind, gate)) {
        if (way.to == gate || !gates_.contains(way.to)) continue;
        Task task{way.cost_s, 0.0, {}};
        follow(task, gate, way.edges);
        add_task(kind, place(gate), place(way.to), std::move(task));
      }
    }
  }

  /// Of two between the same places the quicker one.
  void add_task(std::size_t kind, const std::string& from, const std::string& to, Task task) {
    const std::string arguments = " " + from + " " + to;
    const auto [known, added] = made_.tasks_.try_emplace(kKinds[kind].action + arguments, task);
    if (!added && known->second.cost_s <= task.cost_s) return;
    char cost[64];
    std::snprintf(cost, sizeof cost, "%.6f", task.cost_s);
    facts_[kKinds[kind].action + arguments] = std::string("(") + kKinds[kind].predicate + arguments + ") (= (" +
                                              kKinds[kind].cost + arguments + ") " + cost + ")";
    known->second = std::move(task);
  }

  void write() {
    std::string& text = made_.problem_;
    text = "(define (problem way) (:domain ways-through-a-building)\n  (:objects start goal";
    for (const Index gate : gates_) text += " " + place(gate);
    text += " - place)\n  (:init (at start) (= (total-cost) 0)";
    for (const auto& [task, fact] : facts_) text += "\n    " + fact;
    text += ")\n  (:goal (at goal))\n  (:metric minimize (total-cost)))\n";
  }

  TaskGraph& of_;
  const building::Graph& graph_;
  const RoutePoint from_;
  const RoutePoint to_;
  std::vector<Source> start_, goal_;
  std::set<Index> gates_;
  std::map<std::string, std::string> facts_;
  Request made_;
};

TaskGraph::Request TaskGraph::request(const PathPoint& from, const PathPoint& to) {
  return Draft(*this, from, to).make(from, to);
}

building::Route TaskGraph::Request::route(const navigation::CommPlan& plan) const {
  building::Route route{{start_}, 0.0, 0.0};
  std::string at = "start";
  const auto refuse = [](const std::string& what) {
    throw Error(ErrorCode::Failed, {.what = "the plan is none of this building: " + what,
                                    .expected = "the actions of the domain that was sent, one after the other",
                                    .next = "use another provider of PlanProvider"});
  };
  for (const navigation::CommPlanStep& step : plan.steps()) {
    std::string name = step.action();
    for (const std::string& argument : step.arguments()) name += " " + argument;
    const auto task = tasks_.find(name);
    if (task == tasks_.end()) refuse("there is no task '" + name + "'");
    if (step.arguments(0) != at) refuse("'" + name + "' begins where the task before does not end, at " + at);
    at = step.arguments(1);
    route.length_m += task->second.length_m;
    route.cost_s += task->second.cost_s;
    for (const RoutePoint& point : task->second.points) {
      const RoutePoint& last = route.points.back();
      if (last.at == point.at && last.level == point.level) continue;
      route.points.push_back(point);
    }
  }
  if (at != "goal") refuse("it ends at " + at);
  return route;
}

}  // namespace fiona::guidance
