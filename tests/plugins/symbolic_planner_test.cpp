// The planner without FIONA, on small domains: what it answers, that an independent validator agrees, which itself is
// shown broken plans, what the search is guided by, and that nothing that it is given makes it work without bound.
#include <algorithm>
#include <chrono>
#include <random>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "best_first.hpp"
#include "ff_heuristic.hpp"
#include "grounder.hpp"
#include "plan_validator.hpp"
#include "planner.hpp"
#include "planning_domains.hpp"

namespace fiona::planning {
namespace {

using Outcome = PlanAnswer::Outcome;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Optional;
using ::testing::UnorderedElementsAre;
using namespace std::chrono_literals;

/// Long enough for a sanitizer on a busy machine.
constexpr auto kAmpleTime = 60s;

PlanAnswer solve(const std::string& domain, const std::string& problem, bool optimal = false,
                 std::size_t memory = std::size_t{512} << 20) {
  return plan(
      {.domain = domain, .problem = problem, .optimal = optimal, .time_bound = kAmpleTime, .memory_bound = memory});
}

testing::PlanText text_of(const PlanAnswer& answer) {
  testing::PlanText plan;
  for (const PlanStep& step : answer.steps) {
    std::string line = "(" + step.action;
    for (const std::string& argument : step.arguments) line += " " + argument;
    plan.push_back(line + ")");
  }
  return plan;
}

/// A domain with the predicates p, q, r of no arguments, and these actions.
std::string small_domain(const std::string& actions) {
  return "(define (domain small) (:predicates (p) (q) (r) (of ?x)) " + actions + ")";
}
std::string small_problem(const std::string& init, const std::string& goal) {
  return "(define (problem one) (:domain small) (:objects a b) (:init " + init + ") (:goal " + goal + "))";
}

// ---- the validator

/// By stairs and key: the cheapest one.
testing::PlanText plan_by_key() {
  return {"(walk foyer landing-0)",
          "(climb landing-0 landing-1)",
          "(walk landing-1 office)",
          "(take key-7 office)",
          "(walk office landing-1)",
          "(climb landing-1 landing-2)",
          "(unlock key-7 landing-2 laboratory)",
          "(walk landing-2 laboratory)"};
}

testing::Validation validation_of(const testing::PlanText& plan) {
  return testing::validate(testing::kBuildingDomain, testing::kBuildingProblem, plan);
}

/// The plan by key with one step replaced, from 1.
testing::Validation with_step(std::size_t number, const std::string& step) {
  testing::PlanText plan = plan_by_key();
  plan.at(number - 1) = step;
  return validation_of(plan);
}

TEST(PlanValidator, AddsUpWhatTheStepsCost) {
  EXPECT_EQ(validation_of(plan_by_key()).error, "");
  EXPECT_DOUBLE_EQ(validation_of(plan_by_key()).cost, 89);
  testing::PlanText detour = plan_by_key();
  detour.insert(detour.begin() + 1, {"(walk landing-0 foyer)", "(walk foyer landing-0)"});
  EXPECT_EQ(validation_of(detour).error, "");
  EXPECT_DOUBLE_EQ(validation_of(detour).cost, 105);
}

TEST(PlanValidator, FindsAMissingStepWhereTheNextOneNeedsIt) {
  testing::PlanText plan = plan_by_key();
  plan.erase(plan.begin() + 1);
  EXPECT_EQ(validation_of(plan).error, "step 2, (walk landing-1 office): its precondition does not hold");
}

TEST(PlanValidator, RefusesAStepWhosePreconditionIsTakenAwayByTheOneBefore) {
  EXPECT_EQ(with_step(2, "(walk foyer landing-0)").error,
            "step 2, (walk foyer landing-0): its precondition does not hold");
}

TEST(PlanValidator, RefusesAStepThatNeedsThatSomethingIsNotSo) {
  EXPECT_EQ(with_step(7, "(walk landing-2 laboratory)").error,
            "step 7, (walk landing-2 laboratory): its precondition does not hold");
}

TEST(PlanValidator, RefusesAStepBetweenTwoThatAreOneWhereTheyMustDiffer) {
  EXPECT_EQ(
      validation_of({"(walk foyer landing-0)", "(call-lift landing-2 landing-0)", "(call-lift landing-0 landing-0)"})
          .error,
      "step 3, (call-lift landing-0 landing-0): its precondition does not hold");
}

TEST(PlanValidator, RefusesAPlanThatEndsBeforeTheGoal) {
  testing::PlanText plan = plan_by_key();
  plan.pop_back();
  EXPECT_EQ(validation_of(plan).error, "the goal is not reached");
}

TEST(PlanValidator, RefusesAPlanThatReachesAPartOfTheGoal) {
  std::string problem = testing::kBuildingProblem;
  problem.replace(problem.find("(at foyer)"), 10, "(at landing-2) (may staff)");
  const testing::PlanText plan{"(swipe staff landing-2 laboratory)", "(walk landing-2 laboratory)"};
  EXPECT_EQ(testing::validate(testing::kBuildingDomain, problem, plan).error, "the goal is not reached");
}

TEST(PlanValidator, RefusesAnActionThatTheDomainDoesNotHave) {
  EXPECT_EQ(with_step(2, "(fly landing-0 landing-1)").error,
            "step 2, (fly landing-0 landing-1): the domain has no such action");
}

TEST(PlanValidator, RefusesAnArgumentTooFewOrTooMany) {
  for (const std::string step : {"(walk foyer)", "(walk foyer landing-0 landing-1)"})
    EXPECT_EQ(with_step(1, step).error, "step 1, " + step + ": it has not as many arguments as parameters");
}

TEST(PlanValidator, RefusesAnArgumentOfAWrongTypeOrThatIsNoObject) {
  EXPECT_EQ(with_step(4, "(take office office)").error, "step 4, (take office office): office is of a wrong type");
  EXPECT_EQ(with_step(4, "(take key-8 office)").error, "step 4, (take key-8 office): there is no object key-8");
}

// ---- what the search is guided by

/// Two doors and the key to both, which lies in the foyer; there is a lamp, too, and a drain.
enum Fact : Index { InFoyer, HasKey, OfficeOpen, StoreOpen, LampOn, kFacts };
enum Step : Index { Take, OpenOffice, OpenStore, SwitchOn, DropIntoDrain, kSteps };

struct Keys {
  Keys() : task(memory) {
    task.fact_count = kFacts;
    add({InFoyer}, {HasKey}, {});
    add({HasKey}, {OfficeOpen}, {HasKey});
    add({HasKey}, {StoreOpen}, {HasKey});
    add({InFoyer}, {LampOn}, {});
    add({HasKey}, {}, {HasKey, InFoyer});
    task.goal.assign({OfficeOpen, StoreOpen});
  }
  void add(std::initializer_list<Index> needs, std::initializer_list<Index> adds, std::initializer_list<Index> deletes,
           Cost cost = 1) {
    task.needs.add(needs);
    task.adds.add(adds);
    task.deletes.add(deletes);
    task.costs.push_back(cost);
  }
  struct Guess {
    std::optional<Cost> estimate;
    std::vector<Index> preferred;
  };
  Guess guess(std::initializer_list<Index> facts) const {
    std::vector<std::uint64_t> state(1);
    for (const Index fact : facts) set(state, fact);
    Pace pace(kAmpleTime);
    FfHeuristic heuristic(task, task.costs, pace, memory);
    Guess made;
    const auto guessing = [](FfHeuristic& from, State of, std::optional<Cost>& estimate) -> Async<> {
      auto estimating = from.estimate(of);
      estimate = co_await estimating;
    };
    pace.run(guessing(heuristic, state, made.estimate), 1h);
    made.preferred.assign(heuristic.preferred().begin(), heuristic.preferred().end());
    return made;
  }

  std::pmr::memory_resource* memory = std::pmr::new_delete_resource();
  GroundTask task;
};

TEST(FfHeuristic, CountsEachStepOfAPlanWithoutDeletesOnce) {
  const Keys keys;
  EXPECT_THAT(keys.guess({InFoyer}).estimate, Optional(3)) << "the key is taken for both doors";
  EXPECT_THAT(keys.guess({InFoyer, HasKey}).estimate, Optional(2));
  EXPECT_THAT(keys.guess({HasKey, OfficeOpen}).estimate, Optional(1));
  EXPECT_THAT(keys.guess({OfficeOpen, StoreOpen, LampOn}).estimate, Optional(0));
}

TEST(FfHeuristic, IsInfiniteWhereNothingLeadsToTheGoal) {
  const Keys keys;
  EXPECT_EQ(keys.guess({OfficeOpen, LampOn}).estimate, std::nullopt) << "the key is in the drain";
  EXPECT_THAT(keys.guess({OfficeOpen, LampOn}).preferred, IsEmpty());
}

TEST(FfHeuristic, TakesTheCheapestOfSeveralWaysAndAddsUpItsCosts) {
  Keys keys;
  keys.task.costs.assign({9, 1, 1, 3, 1});
  EXPECT_THAT(keys.guess({InFoyer}).estimate, Optional(11));
  keys.add({LampOn}, {HasKey}, {}, 4);  // by light the key is found sooner
  EXPECT_THAT(keys.guess({InFoyer}).estimate, Optional(9));
}

TEST(FfHeuristic, PrefersTheStepsOfThatPlanThatCanBeTakenAtOnce) {
  const Keys keys;
  EXPECT_THAT(keys.guess({InFoyer}).preferred, ElementsAre(Take)) << "not the lamp, and no door before the key";
  EXPECT_THAT(keys.guess({InFoyer, HasKey}).preferred, UnorderedElementsAre(OpenOffice, OpenStore));
  EXPECT_THAT(keys.guess({InFoyer, HasKey, StoreOpen}).preferred, ElementsAre(OpenOffice));
  EXPECT_THAT(keys.guess({OfficeOpen, StoreOpen}).preferred, IsEmpty());
}

/// 40 rooms in a row, and ten niches beside each, which are told of before the next room is.
std::string row_with_niches() {
  std::string objects, init;
  const auto join = [&](const std::string& a, const std::string& b) {
    for (const std::string& pair : {a + " " + b, b + " " + a})
      init += "(door " + pair + ") (= (metres " + pair + ") 3) ";
  };
  for (int i = 0; i < 40; ++i) {
    const std::string room = "r" + std::to_string(i);
    for (int k = 0; k < 10; ++k) {
      const std::string niche = room + "-" + std::to_string(k);
      objects += niche + " ";
      join(room, niche);
    }
    objects += room + " ";
    if (i > 0) join("r" + std::to_string(i - 1), room);
  }
  return "(define (problem row) (:domain building) (:objects " + objects + "- room) (:init (at r0) " + init +
         ") (:goal (at r39)) (:metric minimize (total-cost)))";
}

Async<> search_greedily(const std::string& problem, Pace& pace, Statistics& statistics) {
  std::pmr::memory_resource* memory = std::pmr::new_delete_resource();
  LiftedTask lifted(memory);
  read_domain(lifted, testing::kBuildingDomain, pace);
  auto reading = read_problem(lifted, problem, pace);
  co_await reading;
  GroundTask task(memory);
  auto grounding = ground(lifted, task, pace);
  co_await grounding;
  BestFirst search(task, {.counts_costs = false}, pace, statistics, memory);
  auto running = search.run();
  const BestFirst::End end = co_await running;
  EXPECT_EQ(end, BestFirst::End::Found);
}

TEST(BestFirst, PreferredOperatorsLeadPastWhatIsBesideTheWay) {
  Pace pace(kAmpleTime);
  Statistics statistics;
  pace.run(search_greedily(row_with_niches(), pace, statistics), 1h);
  EXPECT_GT(statistics.generated, 400u) << "each step is one of eleven or twelve";
  EXPECT_LT(statistics.expanded, 80u) << "without them a room's niches are looked into before the next room";
}

// ---- plans

TEST(SymbolicPlanner, ThePlanThroughABuildingIsValidAndCostsWhatItSays) {
  const auto answer = solve(testing::kBuildingDomain, testing::kBuildingProblem);
  ASSERT_EQ(answer.outcome, Outcome::Solved) << answer.message;
  const auto validation = testing::validate(testing::kBuildingDomain, testing::kBuildingProblem, text_of(answer));
  EXPECT_EQ(validation.error, "");
  EXPECT_DOUBLE_EQ(validation.cost, answer.cost);
}

TEST(SymbolicPlanner, TheOptimalPlanFetchesTheKeyOnTheWayUpTheStairs) {
  const auto answer = solve(testing::kBuildingDomain, testing::kBuildingProblem, true);
  EXPECT_THAT(text_of(answer),
              ElementsAre("(walk foyer landing-0)", "(climb landing-0 landing-1)", "(walk landing-1 office)",
                          "(take key-7 office)", "(walk office landing-1)", "(climb landing-1 landing-2)",
                          "(unlock key-7 landing-2 laboratory)", "(walk landing-2 laboratory)"));
  EXPECT_DOUBLE_EQ(answer.cost, 89);
  EXPECT_TRUE(answer.is_optimal);
}

TEST(SymbolicPlanner, CostsOfTheStepsAddUpToThatOfThePlan) {
  const auto answer = solve(testing::kBuildingDomain, testing::kBuildingProblem);
  double sum = 0;
  for (const PlanStep& step : answer.steps) sum += step.cost;
  EXPECT_DOUBLE_EQ(sum, answer.cost);
}

TEST(SymbolicPlanner, AnAccessLevelOpensADoorWhereAKeyWouldCostMore) {
  std::string problem = testing::kBuildingProblem;
  problem.replace(problem.find("(and (at laboratory) (not (lies key-7 office)))"), 47, "(at laboratory)");
  problem.replace(problem.find("(at foyer)"), 10, "(at foyer) (may staff)");
  const auto answer = solve(testing::kBuildingDomain, problem, true);
  EXPECT_THAT(text_of(answer), ElementsAre("(walk foyer landing-0)", "(call-lift landing-2 landing-0)",
                                           "(enter landing-0)", "(ride landing-0 landing-2)", "(leave landing-2)",
                                           "(swipe staff landing-2 laboratory)", "(walk landing-2 laboratory)"));
  EXPECT_DOUBLE_EQ(answer.cost, 59);
}

TEST(SymbolicPlanner, ABlockedPlaceIsNotEntered) {
  std::string problem = testing::kBuildingProblem;
  problem.replace(problem.find("(at foyer)"), 10, "(at foyer) (blocked office)");
  const auto answer = solve(testing::kBuildingDomain, problem);
  EXPECT_EQ(answer.outcome, Outcome::Unsolvable);
  EXPECT_EQ(answer.message, "no sequence of actions reaches the goal");
}

TEST(SymbolicPlanner, WithoutMetricEachStepCostsOne) {
  std::string problem = testing::kBuildingProblem;
  problem.replace(problem.find("(:metric minimize (total-cost))"), 31, "");
  const auto answer = solve(testing::kBuildingDomain, problem, true);
  EXPECT_DOUBLE_EQ(answer.cost, static_cast<double>(answer.steps.size()));
}

TEST(SymbolicPlanner, AGoalThatHoldsAlreadyNeedsNoStep) {
  for (const bool optimal : {false, true}) {
    const auto answer = solve(small_domain(""), small_problem("(p)", "(p)"), optimal);
    EXPECT_EQ(answer.outcome, Outcome::Solved);
    EXPECT_THAT(answer.steps, IsEmpty());
    EXPECT_TRUE(answer.is_optimal);
  }
}

TEST(SymbolicPlanner, WhatNoActionCanReachIsUnsolvable) {
  const auto domain = small_domain("(:action a :precondition (q) :effect (r))");
  EXPECT_EQ(solve(domain, small_problem("(p)", "(r)")).outcome, Outcome::Unsolvable);
}

TEST(SymbolicPlanner, WhatOnlyTheDeletesForbidIsUnsolvable) {
  const auto domain = small_domain(
      "(:action a :precondition (p) :effect (and (q) (not (p)))) "
      "(:action b :precondition (p) :effect (and (r) (not (p))))");
  for (const bool optimal : {false, true})
    EXPECT_EQ(solve(domain, small_problem("(p)", "(and (q) (r))"), optimal).outcome, Outcome::Unsolvable);
}

TEST(SymbolicPlanner, WhatIsAddedAndDeletedAtOnceHoldsAfterwards) {
  const auto domain = small_domain("(:action a :precondition (p) :effect (and (not (q)) (q) (not (p))))");
  EXPECT_EQ(solve(domain, small_problem("(p)", "(q)")).steps.size(), 1u);
}

TEST(SymbolicPlanner, ANegativeGoalIsReachedByADelete) {
  const auto domain = small_domain("(:action a :parameters (?x) :precondition (of ?x) :effect (not (of ?x)))");
  const auto answer = solve(domain, small_problem("(of a) (of b)", "(not (of b))"));
  EXPECT_THAT(text_of(answer), ElementsAre("(a b)"));
}

TEST(SymbolicPlanner, EqualityBindsAndSeparates) {
  const std::string domain =
      "(define (domain small) (:constants b) (:predicates (of ?x) (r)) "
      "(:action a :parameters (?x ?y) :precondition (and (of ?x) (not (= ?x ?y))) :effect (of ?y))"
      "(:action b :parameters (?x ?y) :precondition (and (of ?x) (= ?x ?y) (= ?y b)) :effect (r)))";
  const auto answer =
      solve(domain, "(define (problem p) (:domain small) (:objects a) (:init (of a)) (:goal (r)))", true);
  EXPECT_THAT(text_of(answer), ElementsAre("(a a b)", "(b b b)"));
}

TEST(SymbolicPlanner, AnActionMayHaveParametersThatNothingBinds) {
  const auto domain = small_domain("(:action a :parameters (?x ?y) :effect (of ?y))");
  EXPECT_EQ(solve(domain, small_problem("", "(and (of a) (of b))")).steps.size(), 2u);
}

TEST(SymbolicPlanner, AVariableTwiceInAConditionIsOneObject) {
  const std::string domain =
      "(define (domain small) (:predicates (near ?x ?y) (of ?x)) "
      "(:action a :parameters (?x) :precondition (near ?x ?x) :effect (of ?x)))";
  const auto problem = [](const std::string& goal) { return small_problem("(near a b) (near b b)", goal); };
  EXPECT_EQ(solve(domain, problem("(of b)")).outcome, Outcome::Solved);
  EXPECT_EQ(solve(domain, problem("(of a)")).outcome, Outcome::Unsolvable);
}

TEST(SymbolicPlanner, TypesMayBeNamedAfterTheirKindsAndAreKept) {
  const std::string domain =
      "(define (domain small) (:types car - vehicle vehicle dog - thing) (:predicates (moved ?x - thing)) "
      "(:action move :parameters (?x - vehicle) :effect (moved ?x)))";
  const auto problem = [](const std::string& goal) {
    return "(define (problem p) (:domain small) (:objects c - car d - dog) (:init) (:goal (moved " + goal + ")))";
  };
  EXPECT_EQ(solve(domain, problem("c")).outcome, Outcome::Solved);
  EXPECT_EQ(solve(domain, problem("d")).outcome, Outcome::Unsolvable);
}

TEST(SymbolicPlanner, UpperAndLowerCaseAreTheSame) {
  const auto answer =
      solve("(DEFINE (Domain Small) (:PREDICATES (Of ?X)) (:Action A :parameters (?x) :EFFECT (OF ?X)))",
            small_problem("", "(oF B)"));
  EXPECT_THAT(text_of(answer), ElementsAre("(a b)"));
}

TEST(SymbolicPlanner, StepsThatCostNothingAreNotTakenForNothing) {
  const std::string domain =
      "(define (domain small) (:predicates (of ?x)) (:functions (total-cost) - number) "
      "(:action free :parameters (?x) :effect (of ?x)))";
  std::string problem = small_problem("", "(of a)");
  problem.insert(problem.size() - 1, "(:metric minimize (total-cost))");
  for (const bool optimal : {false, true}) {
    const auto answer = solve(domain, problem, optimal);
    EXPECT_EQ(answer.steps.size(), 1u);
    EXPECT_EQ(answer.cost, 0);
  }
}

/// A graph of rooms with random doors; keys lie about, and some doors need one.
std::string random_problem(std::mt19937& random) {
  const auto below = [&](unsigned end) { return static_cast<unsigned>(random() % end); };
  std::string init, objects;
  for (int room = 0; room < 7; ++room) objects += " r" + std::to_string(room);
  objects += " - room k0 k1 - key";
  for (unsigned i = 0; i < 9; ++i) {
    const std::string a = "r" + std::to_string(below(7)), b = "r" + std::to_string(below(7));
    if (a == b) continue;
    const auto metres = std::to_string(1 + below(9)) + "." + std::to_string(below(10));
    for (const auto& [from, to] : {std::pair(a, b), std::pair(b, a)}) {
      init += "(door " + from + " " + to + ")";
      if (init.find("(= (metres " + from + " " + to + ")") == std::string::npos)
        init += "(= (metres " + from + " " + to + ") " + metres + ")";
    }
    if (below(3) == 0) {
      const std::string key = below(2) == 0 ? "k0" : "k1";
      init += "(locked " + a + " " + b + ")(locked " + b + " " + a + ")(opens " + key + " " + a + " " + b + ")";
    }
  }
  for (const char* key : {"k0", "k1"}) init += std::string("(lies ") + key + " r" + std::to_string(below(7)) + ")";
  return "(define (problem random) (:domain building) (:objects" + objects + ") (:init (at r0) " + init +
         ") (:goal (and (at r6) (has k1))) (:metric minimize (total-cost)))";
}

TEST(SymbolicPlanner, OfRandomBuildingsEveryPlanIsValidAndNoneIsCheaperThanTheOptimalOne) {
  std::mt19937 random(7);
  int solved = 0;
  for (int i = 0; i < 60; ++i) {
    const std::string problem = random_problem(random);
    const auto soon = solve(testing::kBuildingDomain, problem);
    const auto best = solve(testing::kBuildingDomain, problem, true);
    ASSERT_EQ(soon.outcome, best.outcome) << problem;
    if (best.outcome != Outcome::Solved) continue;
    ++solved;
    for (const auto* answer : {&soon, &best}) {
      const auto validation = testing::validate(testing::kBuildingDomain, problem, text_of(*answer));
      EXPECT_EQ(validation.error, "") << problem;
      EXPECT_NEAR(validation.cost, answer->cost, 1e-9) << problem;
    }
    EXPECT_LE(best.cost, soon.cost + 1e-9) << problem;
    EXPECT_LE(soon.cost, 2 * best.cost + 1e-9) << problem;
    if (soon.is_optimal) {
      EXPECT_NEAR(soon.cost, best.cost, 1e-9) << problem;
    }
  }
  EXPECT_GT(solved, 15);
}

TEST(SymbolicPlanner, ItWorksInSlicesAndAnswersTheSame) {
  const PlanRequest request{.domain = testing::kBuildingDomain, .problem = testing::kBuildingProblem};
  Planning planning(request);
  int slices = 1;
  while (!planning.advance(0ns)) ++slices;
  EXPECT_GT(slices, 10);
  EXPECT_EQ(text_of(planning.answer()), text_of(plan(request)));
}

TEST(SymbolicPlanner, APlanningThatIsDroppedHalfWayLeavesNothingBehind) {
  Planning planning({.domain = testing::kBuildingDomain, .problem = testing::kBuildingProblem});
  for (int i = 0; i < 5; ++i) ASSERT_FALSE(planning.advance(0ns));
}

/// n counters in a row of bits: a plan has 2^n steps.
std::string counter_domain(int bits) {
  std::string actions;
  for (int bit = 0; bit < bits; ++bit) {
    std::string needs = "(not (b" + std::to_string(bit) + "))", effect = "(b" + std::to_string(bit) + ")";
    for (int lower = 0; lower < bit; ++lower) {
      needs += " (b" + std::to_string(lower) + ")";
      effect += " (not (b" + std::to_string(lower) + "))";
    }
    actions += "(:action up" + std::to_string(bit) + " :precondition (and " + needs + ") :effect (and " + effect + "))";
  }
  std::string predicates;
  for (int bit = 0; bit < bits; ++bit) predicates += "(b" + std::to_string(bit) + ")";
  return "(define (domain counter) (:predicates " + predicates + ") " + actions + ")";
}
std::string counter_problem(int bits) {
  std::string goal;
  for (int bit = 0; bit < bits; ++bit) goal += "(b" + std::to_string(bit) + ")";
  return "(define (problem c) (:domain counter) (:init) (:goal (and " + goal + ")))";
}

TEST(SymbolicPlanner, ASearchWithoutEndEndsAtItsTimeBound) {
  for (const bool optimal : {false, true}) {
    const std::string domain = counter_domain(60), problem = counter_problem(60);
    // A busy machine may need longer until the search itself begins.
    for (auto bound = 300ms; bound < 10s; bound *= 3) {
      const auto answer = plan({.domain = domain, .problem = problem, .optimal = optimal, .time_bound = bound});
      EXPECT_EQ(answer.outcome, Outcome::OutOfTime);
      EXPECT_EQ(answer.message, "no plan was found within the time bound of " + std::to_string(bound.count()) + " ms");
      if (answer.statistics.expanded > 0) break;
      EXPECT_LT(bound, 8s) << "nothing was searched";
    }
  }
}

TEST(SymbolicPlanner, ASearchWithoutEndEndsAtItsMemoryBound) {
  for (const bool optimal : {false, true}) {
    const auto answer = solve(counter_domain(60), counter_problem(60), optimal, std::size_t{1} << 20);
    EXPECT_EQ(answer.outcome, Outcome::OutOfMemory);
    EXPECT_EQ(answer.message, "no plan was found within the memory bound of 1 MiB");
    EXPECT_LE(answer.memory, std::size_t{1} << 20);
  }
}

TEST(SymbolicPlanner, APlanLongerThanAnAnswerIsNotGiven) {
  const auto answer = solve(counter_domain(17), counter_problem(17));
  EXPECT_EQ(answer.outcome, Outcome::OutOfMemory);
  EXPECT_EQ(answer.message, "the plan has 131071 steps, more than the 65536 that an answer may have");
}

TEST(SymbolicPlanner, ManyParametersAndObjectsAreGroundedWithinBounds) {
  std::string parameters, conditions, objects;
  for (int i = 0; i < 12; ++i) parameters += " ?x" + std::to_string(i);
  for (int i = 0; i < 2000; ++i) objects += " o" + std::to_string(i);
  const std::string domain = "(define (domain wide) (:predicates (p) (of ?x)) (:action a :parameters (" + parameters +
                             ") :effect (and (p) (of ?x0) (of ?x11))))";
  const std::string problem =
      "(define (problem p) (:domain wide) (:objects" + objects + ") (:init) (:goal (and (p) (of o7))))";
  const auto memory = solve(domain, problem, false, std::size_t{16} << 20);
  EXPECT_EQ(memory.outcome, Outcome::OutOfMemory);
  const auto time =
      plan({.domain = domain, .problem = problem, .time_bound = 20ms, .memory_bound = std::size_t{4} << 30});
  EXPECT_EQ(time.outcome, Outcome::OutOfTime);
}

TEST(SymbolicPlanner, AJoinThatFindsNothingEndsAtItsTimeBound) {
  std::string parameters, tests, objects;
  for (int i = 0; i < 12; ++i) parameters += " ?x" + std::to_string(i);
  for (int i = 0; i < 500; ++i) objects += " o" + std::to_string(i);
  const std::string domain = "(define (domain wide) (:predicates (p) (of ?x)) (:action a :parameters (" + parameters +
                             ") :precondition (and (not (= ?x11 ?x11))) :effect (p)))";
  const std::string problem = "(define (problem p) (:domain wide) (:objects" + objects + ") (:init) (:goal (p)))";
  EXPECT_EQ(plan({.domain = domain, .problem = problem, .time_bound = 50ms}).outcome, Outcome::OutOfTime);
}

TEST(SymbolicPlanner, TenMillionObjectsAreMoreThanTheMemoryBound) {
  std::string objects;
  objects.reserve(90'000'000);
  for (int i = 0; i < 10'000'000; ++i) objects += " o" + std::to_string(i);
  const std::string problem = "(define (problem p) (:domain small) (:objects" + objects + ") (:init) (:goal (p)))";
  const auto answer = solve(small_domain(""), problem, false, std::size_t{128} << 20);
  EXPECT_EQ(answer.outcome, Outcome::OutOfMemory);
  EXPECT_LE(answer.memory, std::size_t{128} << 20);
}

TEST(SymbolicPlanner, ALargeBuildingIsGroundedByWhatCanBeReached) {
  // 1500 rooms in a row: 2.25 million pairs, of which 3000 have a door.
  std::string objects, init;
  for (int i = 0; i < 1500; ++i) objects += " r" + std::to_string(i);
  for (int i = 0; i + 1 < 1500; ++i) {
    for (const auto& [from, to] : {std::pair(i, i + 1), std::pair(i + 1, i)}) {
      const std::string pair = "r" + std::to_string(from) + " r" + std::to_string(to) + ")";
      init += "(door " + pair + "(= (metres " + pair + " 3)";
    }
  }
  const std::string problem = "(define (problem row) (:domain building) (:objects" + objects +
                              " - room) (:init (at r0) " + init + ") (:goal (at r40)) (:metric minimize (total-cost)))";
  const auto answer = solve(testing::kBuildingDomain, problem, true);
  EXPECT_EQ(answer.steps.size(), 40u);
  EXPECT_LT(answer.memory, std::size_t{32} << 20);
}

}  // namespace
}  // namespace fiona::planning
