// How a person is led through doors, up stairs and to lifts.
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "guide.hpp"
#include "guide_paths.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using hmi::NextTurn;
using world::around_a_corner;
using world::aside_through_a_door;
using world::at;
using world::kDegree;
using world::through_a_door;
using world::up_round_stairs;
using world::walk;

TEST(Guide, APlaceThatLeapsTakesNobodyThroughADoorBeforeTheyHaveReacted) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  for (const auto& [t, y_m] : {std::pair{0.0, 8.0}, std::pair{0.2, 12.5}, std::pair{0.4, 12.5}}) {
    EXPECT_EQ(guide.follow({{{0, y_m}, 0}, 0.0, 1.5}, at(t)).instruction.kind(), Instruction::DOOR) << t;
  }
}

TEST(Guide, WhoIsAboutToGoThroughADoorIsNotTurnedToThePath) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0, 1.0}, at(0));
  EXPECT_EQ(guide.follow({{{0.5, 8.5}, 0}, 70 * kDegree, 1.0}, at(1)).instruction.kind(), Instruction::DOOR);
  EXPECT_EQ(guide.follow({{{0.5, 8.5}, 0}, 70 * kDegree, 1.0}, at(6)).instruction.kind(), Instruction::DOOR);
  guide.follow({{{0.5, 5.5}, 0}, 70 * kDegree, 1.0}, at(9));
  EXPECT_EQ(guide.follow({{{0.5, 5.5}, 0}, 70 * kDegree, 1.0}, at(10.2)).instruction.kind(), Instruction::TURN)
      << "too far from the door to see it";
}

TEST(Guide, WhoHasNotGoneThroughADoorIsToldAgainLaterIfTheirPlaceIsNotSure) {
  const LevelPlan plan;
  for (const auto& [sigma_m, again_s] : {std::pair{0.0, 4.2}, {1.0, 4.2}}) {
    Guide guide(plan, through_a_door(), "Room 7", false, at(0));
    std::vector<double> said_s;
    for (int i = 0; i < 50; ++i) {
      const double t = 0.2 * i, y_m = std::min(9.0, 7.0 + t);
      if (guide.follow({{{0.9, y_m}, 0}, 0.0, sigma_m}, at(t)).is_new) said_s.push_back(t);
    }
    ASSERT_GE(said_s.size(), 2u);
    EXPECT_NEAR(said_s[1] - said_s[0], again_s, 0.5) << sigma_m;
  }
}

TEST(Guide, WhoWalksPastADoorThatTheyWereToldOfIsToldAgainAtOnce) {
  const LevelPlan plan;
  for (const double sigma_m : {0.0, 1.0}) {
    Guide guide(plan, aside_through_a_door(), "Room 7", false, at(0));
    std::vector<double> told_at_m;
    for (double x_m = 0.0; x_m < 13.0; x_m += 0.26) {
      const auto advice = guide.follow({{{x_m, 0}, 0}, 90 * kDegree, sigma_m}, at(x_m / 1.3));
      const bool now =
          advice.is_new && advice.instruction.kind() == Instruction::DOOR && advice.instruction.distance() < 3;
      if (now) told_at_m.push_back(x_m);
    }
    ASSERT_EQ(told_at_m.size(), 2u) << sigma_m;
    EXPECT_NEAR(told_at_m[1], 11.2, 0.4);
  }
}

TEST(Guide, WhoHasWalkedPastADoorIsLedBackToIt) {
  const LevelPlan plan;
  Guide guide(plan, aside_through_a_door(), "Room 7", false, at(0));
  std::vector<NextTurn::TypeOfTurn> hours;
  for (double x_m = 0.0; x_m < 12.0; x_m += 0.26) {
    const auto advice = guide.follow({{{x_m, 0}, 0}, 90 * kDegree, 1.0}, at(x_m / 1.3));
    if (advice.is_new && advice.instruction.kind() == Instruction::DOOR) hours.push_back(advice.instruction.hour());
  }
  EXPECT_EQ(hours.back(), NextTurn::HOUR_6);  // not the ninth, in which the door leads
}

TEST(Guide, WhoGoesThroughADoorAndTurnsBehindItHasNotMissedIt) {
  const LevelPlan plan;
  building::Route route = aside_through_a_door();
  route.points.back().at = {10, 2};
  route.points.push_back({.at = {20, 2}, .level = 0});
  Guide guide(plan, route, "Room 7", false, at(0));
  int told = 0;
  // Their place stays behind on this side of the wall.
  for (double x_m = 8.5; x_m < 12.0; x_m += 0.26) {
    const auto advice = guide.follow({{{x_m, 0.2}, 0}, 90 * kDegree, 1.0}, at(x_m / 1.3));
    told += advice.is_new && advice.instruction.kind() == Instruction::DOOR;
  }
  EXPECT_EQ(told, 1);
}

TEST(Guide, WhoStandsBeforeADoorIsNotThroughItThoughTheirPlaceDrifts) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  for (double t = 0.0; t < 12.0; t += 0.2) {
    const auto advice = guide.follow({{{0.9, 9.0 + 0.13 * t}, 0}, 0.0, 1.0}, at(t));
    EXPECT_EQ(advice.instruction.kind(), Instruction::DOOR) << t;
  }
}

TEST(Guide, NobodyIsThroughADoorThatTheyWereNotToldOfBecauseTheirPlaceLeaps) {
  const LevelPlan plan;
  building::Route route;
  using building::Passage;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {5, 0}, .level = 0},
                  {.at = {5, 3}, .level = 0},
                  {.at = {5, 4}, .level = 0, .passage = Passage::Door},
                  {.at = {5, 20}, .level = 0}};
  Guide guide(plan, route, "Room 7", false, at(0));
  EXPECT_EQ(guide.follow({{{4, 0}, 0}, 90 * kDegree, 1.0}, at(0)).instruction.kind(), Instruction::TURN);
  for (const double t : {3.0, 3.2}) {
    EXPECT_EQ(guide.follow({{{5, 3.9}, 0}, 0.0, 1.0}, at(t)).instruction.kind(), Instruction::DOOR) << t;
  }
  EXPECT_EQ(guide.follow({{{5, 6}, 0}, 0.0, 1.0}, at(6)).instruction.kind(), Instruction::CONTINUE);
}

TEST(Guide, WhoStandsBesideADoorAndLooksAtTheWallHasNotGoneThroughIt) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0}, at(0));
  EXPECT_EQ(guide.follow({{{0.9, 9.9}, 0}, 0.0}, at(3)).instruction.kind(), Instruction::DOOR);
  EXPECT_EQ(guide.follow({{{0.1, 9.9}, 0}, 0.0}, at(3.2)).instruction.kind(), Instruction::CONTINUE);
}

TEST(Guide, WhoLooksThroughADoorAndGoesOnBesideItIsToldOfItAtOnce) {
  const LevelPlan plan;
  Guide guide(plan, around_a_corner(8), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0}, at(0));
  ASSERT_EQ(guide.follow({{{0.3, 9.9}, 0}, 20 * kDegree}, at(2)).instruction.kind(), Instruction::CONTINUE);
  const auto beside = guide.follow({{{0.8, 9.9}, 0}, 90 * kDegree}, at(2.4)).instruction;
  EXPECT_EQ(beside.kind(), Instruction::DOOR) << beside.text();  // and is not turned into the wall
  EXPECT_EQ(beside.hour(), NextTurn::HOUR_9);
}

TEST(Guide, WhoDoesNotGetOnBehindADoorIsToldOfTheDoorAgain) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  std::vector<std::string> said;
  double y_m = 7;
  for (double t = 0; t < 11; t += 0.2) {
    y_m = std::min(12.0, y_m + 0.26);
    const auto advice = guide.follow({{{0, y_m}, 0}, 0.0, 1.5}, at(t));
    if (advice.is_new) said.push_back(advice.instruction.text());
  }
  EXPECT_THAT(said, ::testing::ElementsAre("Go through the door.", "Go on for 8 m to Room 7.", "Go through the door."));
}

TEST(Guide, WhoStandsBehindADoorAndTurnsAboutIsToldOfTheDoorAgain) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  bool told_again = false;
  // They seem to be through, and look about, so that they are told this and that.
  for (double t = 0; t < 13; t += 0.2) {
    const bool about = t > 4;
    const double y_m = std::min(12.0, 7 + 1.3 * t);
    const auto advice = guide.follow({{{0, y_m}, 0}, about ? 80 * kDegree * std::sin(1.5 * t) : 0.0, 1.5}, at(t));
    told_again = told_again || (about && advice.is_new && advice.instruction.kind() == Instruction::DOOR);
  }
  EXPECT_TRUE(told_again);
}

TEST(Guide, WhoSeemedToBeThroughADoorAndSurelyIsBeforeItsWallIsLedBackToIt) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  for (const double side : {-1.0, 1.0}) plan.plan.walls.push_back({.segment = {{side * 0.6, 10}, {side * 20, 10}}});
  Guide guide(plan, around_a_corner(1.5), "Room 7", false, at(0));
  double t = 0.0;
  const auto told_at = [&](double x_m, double y_m, double heading) {
    return guide.follow({{{x_m, y_m}, 0}, heading * kDegree, 0.5}, at(t += 0.8)).instruction;
  };
  for (const double y_m : {8.0, 9.0, 10.0, 11.0, 12.0}) told_at(0.4, y_m, 0);
  EXPECT_EQ(told_at(1.5, 12, 90).kind(), Instruction::CONTINUE);
  // They have walked along the wall instead: what is in sight of the path is before the door.
  const Instruction said = told_at(2.5, 8.6, 90);
  EXPECT_EQ(said.hour(), NextTurn::HOUR_7) << said.text();
  EXPECT_EQ(said.distance(), 0.0);
  for (const double y_m : {8.8, 9.0, 9.2}) told_at(0.3, y_m, 0);
  EXPECT_EQ(told_at(0.3, 9.4, 0).kind(), Instruction::DOOR);
}

TEST(Guide, ATurnRightBehindADoorIsToldWithIt) {
  const LevelPlan plan;
  Guide guide(plan, around_a_corner(1.5), "Room 7", false, at(0));
  std::vector<std::string> words;
  for (const Instruction& said : walk(guide).numbered) {
    words.push_back(said.text());
    EXPECT_EQ(said.then_hour(),
              said.kind() == Instruction::DOOR ? NextTurn::HOUR_3 : NextTurn::TYPE_OF_TURN_UNSPECIFIED);
  }
  EXPECT_THAT(words, ::testing::ElementsAre("Go straight on for 10 m.", "In 6 m go through the door, then turn right.",
                                            "Go through the door, then turn right.", "Turn right now.",
                                            "Go on for 20 m to Room 7.", "You have arrived: Room 7."));
}

TEST(Guide, ATurnThatWasToldWithItsDoorIsNotToldBeforeADoubtfulPlaceIsClearOfTheDoor) {
  const LevelPlan plan;
  Guide guide(plan, around_a_corner(1.5), "Room 7", false, at(0));
  double t = 0.0;
  const auto told_at = [&](double y_m) {
    return guide.follow({{{0, y_m}, 0}, 0.0, 1.5}, at(t += 1.0)).instruction.kind();
  };
  for (const double y_m : {8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 11.0, 11.4})
    EXPECT_EQ(told_at(y_m), Instruction::DOOR) << y_m;
  EXPECT_EQ(told_at(11.7), Instruction::TURN);
}

TEST(Guide, WhoWaitsBeforeADoorIsNotSentOnBehindItBecauseTheirPlaceIsALittleAhead) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0, 0.6}, at(0));
  EXPECT_EQ(guide.follow({{{0, 10.4}, 0}, 0.0, 0.6}, at(2)).instruction.kind(), Instruction::DOOR);
  EXPECT_EQ(guide.follow({{{0, 10.8}, 0}, 0.0, 0.6}, at(2.4)).instruction.kind(), Instruction::DOOR);
  EXPECT_EQ(guide.follow({{{0, 11.3}, 0}, 0.0, 0.6}, at(2.8)).instruction.kind(), Instruction::CONTINUE);
}

TEST(Guide, OfTwoDoorsTheSecondIsToldOnceTheFirstIsBehind) {
  using building::Passage;
  const LevelPlan plan;
  building::Route route = through_a_door();
  route.points.back() = {.at = {0, 12.3}, .level = 0};
  route.points.push_back({.at = {0, 13.3}, .level = 0, .passage = Passage::Door});
  route.points.push_back({.at = {0, 20}, .level = 0});
  Guide guide(plan, route, "Room 7", false, at(0));
  EXPECT_TRUE(guide.follow({{{0, 8}, 0}, 0.0, 0.6}, at(0)).is_new);
  for (const auto& [t, y_m] : {std::pair{2.0, 9.6}, std::pair{2.4, 10.4}, std::pair{2.8, 10.9}})
    EXPECT_FALSE(guide.follow({{{0, y_m}, 0}, 0.0, 0.6}, at(t)).is_new) << y_m;
  const auto second = guide.follow({{{0, 11.2}, 0}, 0.0, 0.6}, at(3.2));
  EXPECT_TRUE(second.is_new);
  EXPECT_EQ(second.instruction.kind(), Instruction::DOOR);
  EXPECT_NEAR(second.instruction.distance(), 1.1, 0.3);
}

TEST(Guide, WhoGoesStraightOnBehindADoorWhereThePathTurnsAtOnceIsThroughIt) {
  const LevelPlan plan;
  Guide guide(plan, around_a_corner(0), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0, 0.5}, at(0));
  EXPECT_EQ(guide.follow({{{0, 10.7}, 0}, 0.0, 0.5}, at(2)).instruction.kind(), Instruction::DOOR);
  const auto beyond = guide.follow({{{0, 11.3}, 0}, 0.0, 0.5}, at(3)).instruction;
  EXPECT_EQ(beyond.kind(), Instruction::TURN) << beyond.text();
  EXPECT_EQ(beyond.hour(), NextTurn::HOUR_3);
}

TEST(Guide, ADoorThatSomebodyHasGoneAwayFromIsNoneToGoThroughNow) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 90 * kDegree, 1.0}, at(0));
  EXPECT_EQ(guide.follow({{{2.5, 8}, 0}, 90 * kDegree, 1.0}, at(1)).instruction.kind(), Instruction::DOOR);
  EXPECT_EQ(guide.follow({{{5.5, 8}, 0}, 90 * kDegree, 1.0}, at(3)).instruction.kind(), Instruction::TURN);
}

TEST(Guide, ATurnFurtherBehindADoorIsToldByItself) {
  const LevelPlan plan;
  Guide guide(plan, around_a_corner(5), "Room 7", false, at(0));
  for (const Instruction& said : walk(guide).numbered) {
    EXPECT_EQ(said.then_hour(), NextTurn::TYPE_OF_TURN_UNSPECIFIED) << said.text();
  }
}

TEST(Guide, AtTheFootOfStairsTheDirectionIsThatInWhichTheyBegin) {
  const LevelPlan plan;
  Guide guide(plan, up_round_stairs(), "Room 7", false, at(0));
  const auto advice = guide.follow({{{4.9, 0}, 0}, 90 * kDegree, 1.0}, at(0));
  EXPECT_EQ(advice.instruction.text(), "Turn left and take the stairs up to level 1.");
  EXPECT_EQ(advice.instruction.hour(), NextTurn::HOUR_9);
  // Who has walked on over the floor looks north by now: the foot is behind them.
  const auto beside = guide.follow({{{7.5, 1}, 0}, 0.0, 1.0}, at(1));
  EXPECT_EQ(beside.instruction.hour(), NextTurn::HOUR_8);
}

TEST(Guide, WhoGetsAwayFromStairsThatTheyWereToldToTakeIsToldAgain) {
  const LevelPlan plan;
  Guide guide(plan, up_round_stairs(), "Room 7", false, at(0));
  std::vector<double> told_at_m;
  for (double x_m = 3.5; x_m < 9.0; x_m += 0.26) {
    if (guide.follow({{{x_m, 0}, 0}, 90 * kDegree, 1.0}, at(x_m / 1.3)).is_new) told_at_m.push_back(x_m);
  }
  ASSERT_GE(told_at_m.size(), 2u);
  EXPECT_NEAR(told_at_m[1], 6.3, 0.4);
}

TEST(Guide, WhoSeemsToBeUpAlreadyIsNotToldToClimbDown) {
  const LevelPlan plan;
  Guide guide(plan, up_round_stairs(), "Room 7", false, at(0));
  EXPECT_EQ(guide.follow({{{8, 2}, 1}, {}, 0.0}, at(0)).instruction.text(), "Take the stairs up to level 1.");
}

/// As a barometer tells it.
TEST(Guide, WhoIsAlmostOnTheLevelThatStairsLeadToIsOffThem) {
  const LevelPlan plan;
  Guide guide(plan, up_round_stairs(), "Room 7", false, at(0));
  guide.follow({{{5, 3}, 0.4}, 0.0, 0.5}, at(0));
  guide.follow({{{8, 2}, 0.8}, 180 * kDegree, 0.5}, at(4));
  Guide::Advice advice;
  for (double t = 5; t < 8; t += 0.2) advice = guide.follow({{{8, -2 - (t - 5)}, 1.07}, 180 * kDegree, 0.5}, at(t));
  EXPECT_FALSE(advice.off_path);
  EXPECT_THAT(advice.instruction.text(), ::testing::HasSubstr("Room 7"));
}

TEST(Guide, WhoWaitsInALiftIsNotToldOfItsDoorAgain) {
  using building::Passage;
  const LevelPlan plan;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {0, 9.5}, .level = 0},
                  {.at = {0, 10.5}, .level = 0, .passage = Passage::Door},
                  {.at = {0, 11.8}, .level = 0},
                  {.at = {0, 11.8}, .level = 1, .passage = Passage::Lift},
                  {.at = {0, 0}, .level = 1}};
  Guide guide(plan, route, "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0, 0.6}, at(0));
  ASSERT_EQ(guide.follow({{{0, 11.2}, 0}, 0.0, 0.6}, at(3)).instruction.kind(), Instruction::LIFT);
  for (double t = 3.2; t < 30; t += 0.2) {
    const auto advice = guide.follow({{{0, 11.0}, 0}, 0.0, 0.6}, at(t));
    EXPECT_FALSE(advice.is_new) << t << " s: " << advice.instruction.text();
  }
}

TEST(Guide, AWrongLevelAtALiftPlansNoOtherPathWhileTheyStandUnlessThePlaceIsSure) {
  const LevelPlan plan;
  for (const auto& [sigma_m, off_s] : {std::pair{0.0, 2.0}, {1.0, 26.0}}) {
    building::Route route;
    using building::Passage;
    route.points = {{.at = {0, 0}, .level = 0},
                    {.at = {0, 5}, .level = 0},
                    {.at = {0, 5}, .level = 1, .passage = Passage::Lift},
                    {.at = {0, 0}, .level = 1}};
    Guide guide(plan, route, "Room 7", false, at(0));
    guide.follow({{{0, 5}, 0}, 0.0, sigma_m}, at(0));
    double t = 0.2, y_m = 5.0;
    for (; t < 40; t += 0.2) {
      // They stand for 20 s, and walk up and down before it then.
      if (t > 20) y_m = 4.0 + std::cos(t - 20);
      if (guide.follow({{{0, y_m}, 2}, 0.0, sigma_m}, at(t)).off_path) break;
    }
    EXPECT_NEAR(t, off_s, 1.5) << sigma_m;
  }
}

TEST(Guide, WhoHasClimbedAndWalksBackBesideTheStairsIsOffThePathAndNotOnThem) {
  const LevelPlan plan;
  building::Route route;
  using building::Passage;
  route.points = {
      {.at = {0, 0}, .level = 0}, {.at = {8, 0}, .level = 1, .passage = Passage::Stairs}, {.at = {16, 0}, .level = 1}};
  Guide guide(plan, route, "Room 7", false, at(0));
  for (const double x_m : {0.0, 4.0, 8.0, 9.0}) guide.follow({{{x_m, 0}, x_m < 8 ? x_m / 8 : 1.0}, {}, 0.0}, at(x_m));
  EXPECT_FALSE(guide.follow({{{4, 1}, 1}, {}, 0.0}, at(14)).off_path);
  const auto advice = guide.follow({{{4, 1}, 1}, {}, 0.0}, at(16.2));
  EXPECT_TRUE(advice.off_path);
  EXPECT_NE(advice.instruction.kind(), Instruction::STAIRS);
}

}  // namespace
}  // namespace fiona::guidance
