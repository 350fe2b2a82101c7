// The planner's component on the bench.
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/testing/bench.hpp"
#include "planning_domains.hpp"
#include "symbolic_planner.hpp"

namespace fiona::planning {
namespace {

using navigation::CommPlan;
using navigation::CommPlanRequest;
using navigation::PlanProvider;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

using Planner = testing::Bench<SymbolicPlanner>;

CommPlanRequest building_request() {
  CommPlanRequest request;
  request.set_domain(testing::kBuildingDomain);
  request.set_problem(testing::kBuildingProblem);
  return request;
}

/// One that no search ends.
CommPlanRequest endless_request() {
  std::string predicates, actions, goal;
  for (int bit = 0; bit < 60; ++bit) {
    const std::string name = "(b" + std::to_string(bit) + ")";
    std::string needs = "(not " + name + ")", effect = name;
    for (int lower = 0; lower < bit; ++lower) {
      needs += " (b" + std::to_string(lower) + ")";
      effect += " (not (b" + std::to_string(lower) + "))";
    }
    predicates += name;
    goal += name;
    actions += "(:action up" + std::to_string(bit) + " :precondition (and " + needs + ") :effect (and " + effect + "))";
  }
  CommPlanRequest request;
  request.set_domain("(define (domain counter) (:predicates " + predicates + ") " + actions + ")");
  request.set_problem("(define (problem c) (:domain counter) (:init) (:goal (and " + goal + ")))");
  return request;
}

/// A request that is put by hand, so that several can be open and a client can give up.
struct Asked final : ReplySink {
  void answer(Outcome how, std::string why, std::shared_ptr<const Object> what) override {
    ++answers;
    if (on_answer) on_answer();
    outcome = how;
    reason = std::move(why);
    plan = std::dynamic_pointer_cast<const CommPlan>(what);
  }
  int answers = 0;
  std::function<void()> on_answer;
  Outcome outcome = Outcome::NoData;
  std::string reason;
  std::shared_ptr<const CommPlan> plan;
};

std::shared_ptr<Asked> put(Planner& planner, CommPlanRequest request) {
  auto asked = std::make_shared<Asked>();
  auto object = std::make_shared<const CommPlanRequest>(std::move(request));
  planner.hull().find_port("plan")->inbox()->push({Envelope{object, 1, planner.now(), 0}, asked});
  return asked;
}

TEST(SymbolicPlannerComponent, AnswersWithStepsCostAndFigures) {
  Planner planner("planner");
  planner.start();
  CommPlanRequest request = building_request();
  request.set_search(CommPlanRequest::OPTIMAL);
  const auto plan = planner.ask<PlanProvider>("plan", request);
  ASSERT_TRUE(plan);
  EXPECT_EQ((*plan)->outcome(), CommPlan::SOLVED);
  EXPECT_EQ((*plan)->steps_size(), 8);
  EXPECT_EQ((*plan)->steps(3).action(), "take");
  EXPECT_EQ((*plan)->steps(3).arguments(1), "office");
  EXPECT_DOUBLE_EQ((*plan)->cost(), 89);
  EXPECT_TRUE((*plan)->is_optimal());
  EXPECT_GT((*plan)->expanded(), 0u);
  EXPECT_GT((*plan)->generated(), 0u);
  EXPECT_GT((*plan)->time(), 0);
  EXPECT_GT((*plan)->memory(), 0);
}

TEST(SymbolicPlannerComponent, TakesNoTimeOfAVirtualClock) {
  Planner planner("planner");
  planner.start();
  const TimePoint before = planner.now();
  const auto asked = put(planner, building_request());
  planner.advance(0ms);
  EXPECT_EQ(asked->answers, 1);
  EXPECT_EQ(planner.now(), before);
}

TEST(SymbolicPlannerComponent, NamesThePlaceOfAFault) {
  Planner planner("planner");
  planner.start();
  CommPlanRequest request = building_request();
  request.set_problem("(define (problem p)\n  (:domain bilding))");
  const auto plan = planner.ask<PlanProvider>("plan", request);
  ASSERT_TRUE(plan);
  EXPECT_EQ((*plan)->outcome(), CommPlan::BAD_INPUT);
  EXPECT_EQ((*plan)->fault_in(), CommPlan::PROBLEM_TEXT);
  EXPECT_EQ((*plan)->line(), 2u);
  EXPECT_EQ((*plan)->column(), 12u);
  EXPECT_EQ((*plan)->message(),
            "problem 2:12: the problem is one of the domain 'bilding', and the domain given is 'building'; give the "
            "domain that it is one of, or correct its (:domain ...)");
}

TEST(SymbolicPlannerComponent, GrantsNoMoreTimeThanItsParameter) {
  Planner planner("planner");
  planner.set("time_bound", 30);
  planner.start();
  CommPlanRequest request = endless_request();
  request.set_time_bound(3'000'000);
  const auto plan = planner.ask<PlanProvider>("plan", request);
  ASSERT_TRUE(plan);
  EXPECT_EQ((*plan)->outcome(), CommPlan::OUT_OF_TIME);
  EXPECT_EQ((*plan)->message(), "no plan was found within the time bound of 30 ms");
}

TEST(SymbolicPlannerComponent, KeepsToTheRequestsOwnBounds) {
  Planner planner("planner");
  planner.start();
  CommPlanRequest request = endless_request();
  request.set_memory_bound(2);
  const auto plan = planner.ask<PlanProvider>("plan", request);
  ASSERT_TRUE(plan);
  EXPECT_EQ((*plan)->outcome(), CommPlan::OUT_OF_MEMORY);
  EXPECT_LE((*plan)->memory(), 2.0);
}

TEST(SymbolicPlannerComponent, OneRequestTooManyIsRefusedAtOnce) {
  Planner planner("planner");
  planner.set("open_requests", 2);
  planner.set("time_bound", 100);
  planner.start();
  const auto first = put(planner, endless_request());
  const auto second = put(planner, endless_request());
  const auto third = put(planner, building_request());
  planner.advance(0ms);
  EXPECT_EQ(third->outcome, Outcome::Rejected);
  EXPECT_EQ(third->reason, "2 requests are being planned for already: try again later, or set planner open_requests");
  EXPECT_EQ(planner.probe<std::int64_t>("refused"), 1);
  EXPECT_EQ(first->outcome, Outcome::Ok);
  EXPECT_EQ(second->outcome, Outcome::Ok);
}

TEST(SymbolicPlannerComponent, AShortPlanDoesNotWaitForTheEndOfALongOne) {
  Planner planner("planner");
  planner.set("time_bound", 1000);
  planner.start();
  const auto endless = put(planner, endless_request());
  const auto quick = put(planner, building_request());
  int answers_before = -1;
  quick->on_answer = [&] { answers_before = endless->answers; };
  planner.advance(0ms);
  EXPECT_EQ(answers_before, 0);
  EXPECT_EQ(endless->answers, 1);
}

TEST(SymbolicPlannerComponent, ARequestThatItsClientGaveUpIsGivenUp) {
  Planner planner("planner");
  planner.set("time_bound", 3600000);
  planner.start();
  const auto endless = put(planner, endless_request());
  const auto quick = put(planner, building_request());
  quick->on_answer = [&] { endless->abandon(); };
  planner.advance(0ms);  // returns before an hour has gone
  EXPECT_EQ(quick->outcome, Outcome::Ok);
  EXPECT_EQ(planner.probe<std::int64_t>("open"), 0);
}

TEST(SymbolicPlannerComponent, BadBoundsAreRefused) {
  Planner planner("planner");
  try {
    planner.set("open_requests", 0);
    ADD_FAILURE() << "nothing was refused";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("open_requests is 0, below 1"));
  }
}

}  // namespace
}  // namespace fiona::planning
