// Wrong PDDL: each mistake is told with its text, line and column, and what would have been right.
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "planner.hpp"

namespace fiona::planning {
namespace {

using namespace std::chrono_literals;

const std::string kDomain = R"((define (domain house)
  (:requirements :strips :typing)
  (:types room - object key)
  (:constants hall - room)
  (:predicates (at ?r - room) (has ?k - key))
  (:functions (total-cost) - number (metres ?a ?b - room))
  (:action go
    :parameters (?a ?b - room)
    :precondition (at ?a)
    :effect (and (not (at ?a)) (at ?b) (increase (total-cost) (metres ?a ?b))))
)
)";
const std::string kProblem = R"((define (problem p)
  (:domain house)
  (:objects attic - room k - key)
  (:init (at hall) (= (metres hall attic) 3) (= (metres attic hall) 3)
         (= (metres hall hall) 0) (= (metres attic attic) 0))
  (:goal (at attic))
  (:metric minimize (total-cost)))
)";

const std::string kTakes = "; this planner takes :strips, :typing, :negative-preconditions, :equality, :action-costs";
const std::string kWords = "; take it out: words are of ASCII letters, digits, '-' and '_'";

std::string with(std::string text, const std::string& found, const std::string& instead) {
  const auto at = text.find(found);
  EXPECT_NE(at, std::string::npos) << found;
  return text.replace(at, found.size(), instead);
}

std::string message(const std::string& domain, const std::string& problem) {
  const auto answer = plan({.domain = domain, .problem = problem, .time_bound = 60s});
  EXPECT_EQ(answer.outcome, PlanAnswer::Outcome::BadInput);
  EXPECT_TRUE(answer.fault.has_value());
  return answer.message;
}
std::string domain_message(const std::string& found, const std::string& instead) {
  return message(with(kDomain, found, instead), kProblem);
}
std::string problem_message(const std::string& found, const std::string& instead) {
  return message(kDomain, with(kProblem, found, instead));
}

TEST(Pddl, TheTextsBelowAreRightBeforeTheirMistake) {
  EXPECT_EQ(plan({.domain = kDomain, .problem = kProblem, .time_bound = 60s}).message, "");
}

TEST(Pddl, ARequirementThatIsNotSupportedIsRefusedByName) {
  EXPECT_EQ(domain_message(":strips :typing", ":strips :adl"),
            "domain 2:26: the requirement ':adl' is not supported; this planner takes :strips, :typing, "
            ":negative-preconditions, :equality, :action-costs");
  EXPECT_EQ(problem_message("(:objects", "(:requirements :durative-actions) (:objects").substr(0, 64),
            "problem 3:18: the requirement ':durative-actions' is not support");
}

TEST(Pddl, WhatOtherRequirementsAllowIsRefusedByTheirName) {
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (or (at ?a) (at ?b))"),
            "domain 9:20: 'or' needs :disjunctive-preconditions, which is not supported" + kTakes);
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (forall (?x - room) (at ?x))"),
            "domain 9:20: 'forall' needs :universal-preconditions, which is not supported" + kTakes);
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (exists (?x - room) (at ?x))"),
            "domain 9:20: 'exists' needs :existential-preconditions, which is not supported" + kTakes);
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (not (and (at ?a) (at ?b)))"),
            "domain 9:25: 'not' of 'and' is a disjunction, which needs :disjunctive-preconditions; this planner takes "
            "'not' of one atom");
  EXPECT_EQ(domain_message("(not (at ?a)) (at ?b)", "(when (at ?a) (at ?b))"),
            "domain 10:19: 'when' needs :conditional-effects, which is not supported" + kTakes);
  EXPECT_EQ(domain_message("(increase (total-cost) (metres ?a ?b))", "(decrease (total-cost) 1)"),
            "domain 10:41: 'decrease' needs :numeric-fluents, which is not supported" + kTakes);
  EXPECT_EQ(domain_message("(:action go", "(:durative-action go"),
            "domain 7:4: the section ':durative-action' is not supported: expected one of :requirements, :types, "
            ":constants, :predicates, :functions, :action");
}

TEST(Pddl, ANameThatIsNotDeclaredIsToldWithThoseThatResembleIt) {
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (att ?a)"),
            "domain 9:20: the predicate 'att' is not declared; did you mean 'at'");
  EXPECT_EQ(problem_message("(:goal (at attic))", "(:goal (at atic))"),
            "problem 6:14: the object 'atic' is not declared; did you mean 'attic'");
  EXPECT_EQ(problem_message("attic - room", "attic - rom"),
            "problem 3:21: the type 'rom' is not declared; did you mean 'room'");
  EXPECT_EQ(domain_message("(metres ?a ?b))))", "(meters ?a ?b))))"),
            "domain 10:64: the function 'meters' is not declared; did you mean 'metres'");
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (at hal)"),
            "domain 9:23: the constant 'hal' is not declared; did you mean 'hall'");
}

TEST(Pddl, AVariableThatIsNoParameterIsNamed) {
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (at ?c)"),
            "domain 9:23: the variable '?c' is no parameter of the action 'go'; declare it in :parameters, or name one "
            "of those");
  EXPECT_EQ(problem_message("(:goal (at attic))", "(:goal (at ?x))"),
            "problem 6:14: a variable has no place here, '?x'; name an object");
}

TEST(Pddl, ArgumentsAreCountedAndTyped) {
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (at ?a ?b)"),
            "domain 9:26: 'at' takes 1 argument, and here is one more; take it out");
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (at)"),
            "domain 9:20: 'at' takes 1 argument, and here are 0; add what is missing");
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition (has ?a)"),
            "domain 9:24: '?a' is a 'room', which argument 1 of 'has' cannot be; name one that fits, or declare that "
            "argument of another type");
  EXPECT_EQ(problem_message("(:init (at hall)", "(:init (at k)"),
            "problem 4:14: 'k' is a 'key', which argument 1 of 'at' cannot be; name one that fits, or declare that "
            "argument of another type");
}

TEST(Pddl, WhatIsDeclaredTwiceIsToldWhereItIsAgain) {
  EXPECT_EQ(problem_message("attic - room", "attic attic - room"),
            "problem 3:19: the object 'attic' is declared twice; take one out, or give it another name");
  EXPECT_EQ(problem_message("attic - room", "hall - room"),
            "problem 3:13: the object 'hall' is declared twice; take one out, or give it another name");
  EXPECT_EQ(domain_message("(has ?k - key)", "(at ?k - key)"),
            "domain 5:32: the predicate 'at' is declared twice; take one out, or give it another name");
  EXPECT_EQ(domain_message("(?a ?b - room)", "(?a ?a - room)"),
            "domain 8:21: the parameter '?a' is declared twice; give one of them another name");
  EXPECT_EQ(domain_message("    :precondition (at ?a)", "    :precondition (at ?a) :precondition (at ?b)"),
            "domain 9:27: a second ':precondition' of the action 'go'; take one out, or make one of both with 'and'");
  EXPECT_EQ(problem_message("  (:goal (at attic))", "  (:goal (at attic)) (:goal (at hall))"),
            "problem 6:23: a second section ':goal'; make one of both");
}

TEST(Pddl, AMissingParenthesisIsToldWhereTheNextSectionBegins) {
  EXPECT_EQ(
      domain_message("(at ?r - room) (has ?k - key))", "(at ?r - room) (has ?k - key)"),
      "domain 6:3: the section ':functions' begins inside the one of domain 5:3: a ')' is missing before it; add it");
  EXPECT_EQ(message(kDomain.substr(0, kDomain.size() - 3), kProblem),
            "domain 1:1: this '(' is never closed; add the ')' that is missing");
  EXPECT_EQ(message(kDomain.substr(0, 200), kProblem),
            "domain 6:3: this '(' is never closed; add the ')' that is missing");
}

TEST(Pddl, TextBehindTheEndIsRefused) {
  EXPECT_EQ(message(kDomain + ")", kProblem), "domain 12:1: ')' has no place here: expected the end of the text");
}

TEST(Pddl, WhatIsNoPddlAtAllIsToldAtItsFirstWord) {
  EXPECT_EQ(message("hello", kProblem), "domain 1:1: 'hello' has no place here: expected '(define (domain NAME) ...)'");
  EXPECT_EQ(message("", kProblem), "domain 1:1: the text ends too early: expected '(define (domain NAME) ...)'");
  EXPECT_EQ(message(kDomain, kDomain), "problem 1:10: 'domain' has no place here: expected 'problem'");
  EXPECT_EQ(problem_message("(at hall)", "(at h\xc3\xa4ll)"),
            "problem 4:15: the byte 0xc3 has no place in PDDL" + kWords);
  EXPECT_EQ(problem_message("(at hall)", std::string("(at \0)", 6)),
            "problem 4:14: the byte 0x00 has no place in PDDL" + kWords);
}

TEST(Pddl, AProblemOfAnotherDomainIsRefused) {
  EXPECT_EQ(problem_message("(:domain house)", "(:domain horse)"),
            "problem 2:12: the problem is one of the domain 'horse', and the domain given is 'house'; give the domain "
            "that it is one of, or correct its (:domain ...)");
}

TEST(Pddl, AProblemWithoutInitOrGoalIsRefused) {
  EXPECT_EQ(problem_message("(:goal (at attic))", ""), "problem 1:1: the problem has no section '(:goal ...)'; add it");
}

TEST(Pddl, CostsAreNumbersThatAreNotNegative) {
  EXPECT_EQ(problem_message("(metres hall attic) 3)", "(metres hall attic) -3)"),
            "problem 4:43: '-3' has no place here: expected a number that is not negative, such as 12 or 2.5");
  EXPECT_EQ(problem_message("(metres hall attic) 3)", "(metres hall attic) 1e3)"),
            "problem 4:43: '1e3' has no place here: expected a number that is not negative, such as 12 or 2.5");
  EXPECT_EQ(problem_message("(metres hall attic) 3)", "(metres hall attic) 99999999999)"),
            "problem 4:43: the number '99999999999' is above 1e9; give all costs in a larger unit");
}

TEST(Pddl, ACostWithoutAValueIsToldWithTheStepThatNeedsIt) {
  EXPECT_EQ(
      problem_message("(= (metres hall attic) 3)", ""),
      "domain 10:64: the cost of (go hall attic) is (metres hall attic), which has no value in the problem; add it "
      "to :init, (= (metres hall attic) NUMBER)");
}

TEST(Pddl, OnlyTheTotalCostIsMinimized) {
  EXPECT_EQ(problem_message("minimize (total-cost)", "maximize (total-cost)"),
            "problem 7:12: 'maximize' has no place here: expected 'minimize'");
  EXPECT_EQ(problem_message("minimize (total-cost)", "minimize (total-time)"),
            "problem 7:22: 'total-time' has no place here: expected '(total-cost)': the only metric that is supported");
}

TEST(Pddl, TypesThatAreKindsOfEachOtherAreRefused) {
  EXPECT_EQ(domain_message("room - object key", "room - key key - room"),
            "domain 3:10: the type 'room' is a kind of itself, by way of its parents; take one of the parents on that "
            "way out");
  EXPECT_EQ(domain_message("room - object key", "room - room key"),
            "domain 3:11: the type 'room' is its own parent; take the parent away, or name another one");
}

TEST(Pddl, DeepNestingIsRefused) {
  std::string deep;
  for (int i = 0; i < 100'000; ++i) deep += "(and ";
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition " + deep),
            "domain 7:3: this '(' is never closed; add the ')' that is missing");
  EXPECT_EQ(domain_message(":precondition (at ?a)", ":precondition " + deep + std::string(100'000, ')')),
            "domain 9:525: conditions are nested more than 100 deep; write the inner 'and' as a part of the outer one");
}

TEST(Pddl, ALongWordIsCutWhereItIsNamed) {
  EXPECT_LT(problem_message("(:goal (at attic))", "(:goal (" + std::string(1'000'000, 'x') + " attic))").size(), 200u);
}

TEST(Pddl, TooManyParametersTypesAndConditionsAreRefused) {
  std::string parameters, types, conditions;
  for (int i = 0; i < 65; ++i) parameters += " ?x" + std::to_string(i);
  for (int i = 0; i < 4094; ++i) types += " t" + std::to_string(i);
  for (int i = 0; i < 600; ++i) conditions += "(at ?a)";
  EXPECT_EQ(domain_message("(?a ?b - room)", "(" + parameters + ")"),
            "domain 8:329: 'go' has more than 64 parameters; make two of it");
  EXPECT_EQ(plan({.domain = with(kDomain, "room - object key", "room - object key" + types),
                  .problem = kProblem,
                  .time_bound = 60s})
                .message,
            "")
      << "4096, and object";
  EXPECT_THAT(domain_message("room - object key", "room - object key one-more" + types),
              ::testing::EndsWith(": a domain has at most 4096 types; leave out those that no parameter has"));
  EXPECT_THAT(domain_message(":precondition (at ?a)", ":precondition (and " + conditions + ")"),
              ::testing::EndsWith(": an action has at most 512 conditions; make two actions of it"));
}

}  // namespace
}  // namespace fiona::planning
