#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <fiona/navigation.pb.h>
#include <fiona/building/routes.hpp>

#include "level_plan.hpp"

namespace fiona::guidance {

/// A walking graph as tasks: walk through a room or corridor, pass a door, climb stairs, ride a lift. A task leads from
/// one place where its kind changes to another, and costs what the quickest way along edges of its kind costs. So a
/// sequence of tasks that costs least costs as much as the quickest way through the graph.
///
/// Made for one walker's permission; what it has found out is kept for later requests. Not for several threads.
class TaskGraph {
 public:
  /// `plan` must outlive it.
  TaskGraph(const LevelPlan& plan, const building::PathPoint& from, const building::RouteOptions& options);

  /// Whether it can answer for who starts there: another start in a room that is closed to the walker opens that room.
  bool suits(const building::PathPoint& from, const building::RouteOptions& options) const;

  /// A way from one place to another as a planning problem, and back from its solution.
  class Request {
   public:
    /// Throws fiona::Error (Failed) when a plan is not one of this request, and names the step: nobody is guided along
    /// what another has made up.
    building::Route route(const navigation::CommPlan& plan) const;
    const std::string& problem() const { return problem_; }
    std::size_t tasks() const { return tasks_.size(); }

   private:
    friend class TaskGraph;
    struct Task {
      double cost_s = 0.0;
      double length_m = 0.0;
      std::vector<building::RoutePoint> points;  ///< after where it begins, as far as its end
    };
    using Name = std::string;  ///< as in a plan: the action and its arguments
    building::RoutePoint start_{};
    std::map<Name, Task> tasks_;
    std::string problem_;
  };
  Request request(const building::PathPoint& from, const building::PathPoint& to);

 private:
  using Index = std::uint32_t;

  /// The quickest way along edges of one kind.
  struct Way {
    Index to = 0;              ///< a node
    double cost_s = 0.0;       ///< with what led to the node where it begins
    std::vector<Index> edges;  ///< in order
  };
  struct Source {
    Index node = 0;
    double cost_s = 0.0;
  };
  class Draft;

  std::optional<std::size_t> closed_room(const building::PathPoint& from, const building::RouteOptions& options) const;
  void join_parts();
  void find_gates();
  bool takes(std::size_t edge, Index next, bool backwards) const;
  std::vector<Way> ways(std::size_t kind, const std::vector<Source>& from, const std::vector<Index>& to,
                        bool backwards) const;
  const std::vector<Way>& ways_from(std::size_t kind, Index gate);

  const LevelPlan& plan_;
  const building::RouteOptions options_;
  const std::optional<std::size_t> closed_room_;  ///< that is open because the walker starts in it
  const building::Permission permission_;
  std::vector<std::vector<Index>> part_of_;  ///< by kind, of each node; none where no edge of that kind may be taken
  std::vector<std::vector<Index>> gates_;    ///< of each part: the nodes where one goes on by another kind
  std::map<std::pair<std::size_t, Index>, std::vector<Way>> known_;
};

/// The tasks as a PDDL domain: an action for each kind of passage, none of which a problem needs to have.
const std::string& task_domain();

}  // namespace fiona::guidance
