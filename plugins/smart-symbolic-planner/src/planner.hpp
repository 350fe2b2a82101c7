#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "pddl_error.hpp"
#include "search.hpp"

namespace fiona::planning {

struct PlanRequest {
  std::string_view domain;
  std::string_view problem;
  bool optimal = false;
  std::chrono::nanoseconds time_bound{std::chrono::seconds(5)};
  std::size_t memory_bound = std::size_t{512} << 20;
};

struct PlanStep {
  std::string action;
  std::vector<std::string> arguments;
  double cost = 0;
};

struct PlanAnswer {
  enum class Outcome : std::uint8_t { Solved, Unsolvable, OutOfTime, OutOfMemory, BadInput };
  Outcome outcome = Outcome::OutOfTime;
  std::vector<PlanStep> steps;
  double cost = 0;
  bool is_optimal = false;
  Statistics statistics{};
  std::chrono::nanoseconds time{};
  std::size_t memory = 0;        ///< the most bytes that were held at once
  std::string message;           ///< why there is no plan
  std::optional<Place> fault{};  ///< of bad input
};

/// Most steps of a plan.
inline constexpr std::size_t kMostSteps = 65536;

/// One planning, done in slices. The texts of its request must outlive it; destroyed before its end, it is given up.
class Planning {
 public:
  explicit Planning(const PlanRequest& request);
  Planning(const Planning&) = delete;
  Planning& operator=(const Planning&) = delete;

  /// Works for about so long. True: the answer is there.
  bool advance(std::chrono::nanoseconds slice);
  const PlanAnswer& answer() const { return answer_; }

 private:
  Async<> run();
  Async<> solve();
  void take(const struct LiftedTask& lifted, const GroundTask& task, const SearchResult& result);

  const PlanRequest request_;
  Memory memory_;
  Pace pace_;
  PlanAnswer answer_;
  Async<> work_;
};

/// The same at one go.
PlanAnswer plan(const PlanRequest& request);

}  // namespace fiona::planning
