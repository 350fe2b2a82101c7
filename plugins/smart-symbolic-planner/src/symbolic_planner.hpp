#pragma once

#include <chrono>
#include <deque>
#include <memory>

#include "fiona/component.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/smart_symbolic_planner/params.pb.h"
#include "planner.hpp"

namespace fiona::planning {

/// Answers planning problems in PDDL. It plans in slices on its strand, for one open request after the other: each is
/// given up as soon as its client has, and under a virtual clock planning takes no time.
class SymbolicPlanner final : public Component {
 public:
  using Component::Component;

 private:
  using Request = navigation::CommPlanRequest;
  using Answer = navigation::CommPlan;

  /// Other work of the strand waits for so long at most, a piece of work that cannot be interrupted aside.
  static constexpr std::chrono::milliseconds kSlice{20};

  struct Open {
    Open(const Request& from, const smart_symbolic_planner::Parameters& granted, Reply<Answer> to);
    const Request request;
    Reply<Answer> reply;
    Planning planning;
  };

  void on_mode(std::string_view mode) override;
  void on_stop() override { open_.clear(); }
  void on_request(const Request& request, Reply<Answer> reply);
  void work();
  void finish(Open& open);

  Params<smart_symbolic_planner::Parameters> params_{*this};
  Provides<navigation::PlanProvider> plan_{
      *this, "plan", &SymbolicPlanner::on_request, {.doc = "plans for problems in PDDL"}};
  Probe<std::int64_t> waiting_{*this, "open", {.doc = "requests that are planned for now"}};
  Probe<std::int64_t> refused_{*this, "refused", {.doc = "requests that were refused because too many were open"}};
  Probe<double> time_{*this, "time", {.unit = "ms", .doc = "time of computation for the newest answer"}};
  Timer next_slice_{*this, &SymbolicPlanner::work};

  std::deque<std::unique_ptr<Open>> open_;  ///< the next slice is the first one's
  std::int64_t refused_count_ = 0;
};

}  // namespace fiona::planning
