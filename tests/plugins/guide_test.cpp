// How a person is led along a path, told five times a second where they are.
#include <cmath>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "guide.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using hmi::NextTurn;
using world::at;

constexpr double kDegree = std::numbers::pi / 180.0;

building::Route corner() {
  building::Route route;
  for (const building::Point point : {building::Point{0, 0}, {0, 20}, {20, 20}}) route.points.push_back({point, 0.0});
  route.length_m = 40;
  return route;
}

struct Heard {
  std::vector<Guide::Advice> all;
  std::vector<Instruction> numbered;
};

/// Walks along the path at 1.3 m/s, told five times a second; `heading_off` from the path's direction.
Heard walk(Guide& guide, double heading_off_rad = 0.0) {
  Heard heard;
  double along_m = 0.0;
  for (double t = 0.0; along_m < guide.path().end_m(); t += 0.2, along_m += 0.26) {
    const auto direction = guide.path().direction(along_m);
    const Walker walker{guide.path().place(along_m), std::atan2(direction.x_m, direction.y_m) + heading_off_rad, 0.0};
    heard.all.push_back(guide.follow(walker, at(t)));
    if (heard.all.back().is_new) heard.numbered.push_back(heard.all.back().instruction);
    if (heard.all.back().arrived) break;
  }
  return heard;
}

TEST(Guide, ATurnIsAnnouncedSixMetresBeforeAndAgainAtTwo) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", true, at(0));
  std::vector<double> turns_m;
  for (const Instruction& said : walk(guide).numbered) {
    if (said.kind() != Instruction::TURN) continue;
    turns_m.push_back(said.distance());
    EXPECT_EQ(said.hour(), NextTurn::HOUR_3);
  }
  ASSERT_EQ(turns_m.size(), 2u);
  EXPECT_NEAR(turns_m[0], 6.0, 0.3);
  EXPECT_NEAR(turns_m[1], 2.0, 0.3);
}

TEST(Guide, SaysInOrderStartOnTurnOnArrive) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", true, at(0));
  std::vector<std::string> words;
  for (const Instruction& said : walk(guide).numbered) words.push_back(said.text());
  EXPECT_THAT(words, ::testing::ElementsAre("To Room 7, 40 m: go straight on.", "Go straight on for 19 m.",
                                            "In 6 m turn right.", "Turn right now.", "Go on for 20 m to Room 7.",
                                            "You have arrived: Room 7."));
}

TEST(Guide, HoursAreThoseInFrontOfTheWalkerNow) {
  const LevelPlan plan;
  for (const auto& [looks_rad, hour] :
       {std::pair{0.0, NextTurn::HOUR_12}, std::pair{90 * kDegree, NextTurn::HOUR_9},
        std::pair{180 * kDegree, NextTurn::HOUR_6}, std::pair{-90 * kDegree, NextTurn::HOUR_3}}) {
    Guide guide(plan, corner(), "Room 7", true, at(0));
    const auto advice = guide.follow({{{0, 0}, 0}, looks_rad, 0}, at(0));
    EXPECT_EQ(advice.instruction.kind(), Instruction::START);
    EXPECT_EQ(advice.instruction.hour(), hour);
    EXPECT_EQ(advice.turn.distance_to_turn(), 0u);
  }
}

TEST(Guide, WhoLooksElsewhereIsTurnedToThePathFirst) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  const auto astray = guide.follow({{{0, 8}, 0}, 180 * kDegree, 0}, at(0));
  EXPECT_EQ(astray.instruction.kind(), Instruction::TURN);
  EXPECT_EQ(astray.instruction.text(), "Turn around.");
  const auto along = guide.follow({{{0, 8}, 0}, 10 * kDegree, 0}, at(1));
  EXPECT_EQ(along.instruction.kind(), Instruction::CONTINUE);
}

TEST(Guide, TheNextTurnIsInMillimetresAndByTheCurrentHeading) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  const auto advice = guide.follow({{{0, 10}, 0}, 30 * kDegree, 0}, at(0));
  EXPECT_EQ(advice.turn.distance_to_turn(), 10000u);
  EXPECT_EQ(advice.turn.type_of_turn(), NextTurn::HOUR_2);
}

/// The document's UInt16 ends at 65.535 m: there 90 m would read as 24.464 m.
TEST(Guide, ATurnThatIsFurtherThanSixteenBitsOfMillimetresIsToldWithItsWholeDistance) {
  const LevelPlan plan;
  building::Route route;
  for (const building::Point point : {building::Point{0, 0}, {0, 100}, {20, 100}}) route.points.push_back({point, 0.0});
  route.length_m = 120;
  Guide guide(plan, route, "Room 7", false, at(0));
  const auto advice = guide.follow({{{0, 10}, 0}, 0.0, 0}, at(0));
  EXPECT_EQ(advice.turn.distance_to_turn(), 90000u);
  EXPECT_EQ(advice.turn.type_of_turn(), NextTurn::HOUR_3);
}

TEST(Guide, WithoutHeadingTheHourIsThatOfThePath) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  EXPECT_EQ(guide.follow({{{0, 10}, 0}, std::nullopt, 0}, at(0)).turn.type_of_turn(), NextTurn::HOUR_3);
}

TEST(Guide, WhoGoesOnBeyondTheTurnIsOffThePathAfterTwoSeconds) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  double off_at_m = 0;
  for (double t = 0, y = 15; t < 12 && off_at_m == 0; t += 0.2, y += 0.26) {
    if (guide.follow({{{0, y}, 0}, 0.0, 0}, at(t)).off_path) off_at_m = y;
  }
  EXPECT_NEAR(off_at_m, 20 + 2.5 + 2 * 1.3, 0.6);
}

TEST(Guide, ALocalisationThatIsLessSureIsFollowedLonger) {
  const LevelPlan plan;
  for (const auto& [sigma_m, off] : {std::pair{0.5, true}, std::pair{3.0, false}}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    guide.follow({{{4, 10}, 0}, 0.0, sigma_m}, at(0));
    EXPECT_EQ(guide.follow({{{4, 10}, 0}, 0.0, sigma_m}, at(2.1)).off_path, off);
  }
}

TEST(Guide, BehindAWallIsOffThePath) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.walls.push_back({.segment = {{0.5, 0}, {0.5, 19}}, .level = 0.0});
  Guide guide(plan, corner(), "Room 7", false, at(0));
  guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(0));
  EXPECT_TRUE(guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(2.1)).off_path);
}

TEST(Guide, InTheRoomBesideThePathIsOffIt) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.doors.push_back({.at = {0.5, 10}, .level = 0.0, .normal = {1, 0}});
  Guide guide(plan, corner(), "Room 7", false, at(0));
  guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(0));
  EXPECT_TRUE(guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(2.1)).off_path);
}

TEST(Guide, WhoStandsIsToldAgainUnderAnotherNumber) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  const Walker stands{{{0, 10}, 0}, 0.0, 0};
  EXPECT_TRUE(guide.follow(stands, at(0)).is_new);
  EXPECT_FALSE(guide.follow(stands, at(4.8)).is_new);
  EXPECT_TRUE(guide.follow(stands, at(5.2)).is_new);
}

/// North for 10 m to a door, through it, and on for 10 m.
building::Route through_a_door() {
  using building::Passage;
  building::Route route;
  for (const auto& [y_m, passage] : {std::pair{0.0, Passage::Walk}, std::pair{9.5, Passage::Walk},
                                     std::pair{10.5, Passage::Door}, std::pair{20.0, Passage::Walk}}) {
    route.points.push_back({.at = {0, y_m}, .level = 0, .passage = passage});
  }
  route.length_m = 20;
  return route;
}

/// North through a door, and east `behind_m` behind it.
building::Route around_a_corner(double behind_m) {
  building::Route route = through_a_door();
  route.points.back().at.y_m = 10.5 + behind_m;
  route.points.push_back({.at = {20, 10.5 + behind_m}, .level = 0});
  return route;
}

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

/// East for 10 m along a corridor, and north through a door in its wall.
building::Route aside_through_a_door() {
  using building::Passage;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {10, 0}, .level = 0},
                  {.at = {10, 1}, .level = 0, .passage = Passage::Door},
                  {.at = {10, 8}, .level = 0}};
  route.length_m = 18;
  return route;
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

/// East to stairs that lead north, east and back south to level 1, and on to the south.
building::Route up_round_stairs() {
  using building::Passage;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {5, 0}, .level = 0},
                  {.at = {5, 4}, .level = 0.5, .passage = Passage::Stairs},
                  {.at = {8, 4}, .level = 0.5, .passage = Passage::Stairs},
                  {.at = {8, 0}, .level = 1, .passage = Passage::Stairs},
                  {.at = {8, -12}, .level = 1}};
  route.length_m = 28;
  return route;
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

TEST(Guide, WhoWalksAboutAlongThePathTurnsByAsMuchAsItDoes) {
  const LevelPlan plan;
  for (const double compass_off : {-22.0, 22.0}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    const auto hour_at = [&](double y_m, double heading, double t) {
      return guide.follow({{{0, y_m}, 0}, (heading + compass_off) * kDegree, 1.0}, at(t)).instruction.hour();
    };
    EXPECT_EQ(hour_at(14.5, 0.0, 0), NextTurn::HOUR_3);
    EXPECT_EQ(hour_at(18.2, 0.0, 3), NextTurn::HOUR_3);
    EXPECT_EQ(hour_at(19.5, 0.0, 4), NextTurn::HOUR_3);
    EXPECT_EQ(hour_at(19.5, 60.0, 4.6), compass_off < 0 ? NextTurn::HOUR_1 : NextTurn::HOUR_12)
        << "they have turned a part of it";
  }
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

/// An hour is 30 degrees: who is turned by one for a metre that a place errs walks past what they are led to.
TEST(Guide, WhoMayBeOnThePathIsLedAsIfTheyWere) {
  const LevelPlan plan;
  for (const auto& [sigma_m, hour] : {std::pair(0.7, NextTurn::HOUR_12), std::pair(0.35, NextTurn::HOUR_11)}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    EXPECT_EQ(guide.follow({{{1.2, 1.0}, 0}, 0.0, sigma_m}, at(0)).instruction.hour(), hour) << sigma_m;
  }
}

/// Who has not moved their head has missed the word; who turns, though the wrong way, is left some more time for it.
TEST(Guide, WhoWalksOnBesideThePathIsToldToTurnAgain) {
  const LevelPlan plan;
  for (const auto& [turned_to, after_s] : {std::pair(80, 2.6), std::pair(120, 4.2)}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    std::vector<double> told_s;
    for (int i = 0; i < 40; ++i) {
      const double looks_rad = (i < 5 ? 80 : turned_to) * kDegree;
      const auto advice = guide.follow({{{0.5, 1.0 + 0.05 * i}, 0}, looks_rad, 0.0}, at(0.2 * i));
      if (advice.is_new && advice.instruction.kind() == Instruction::TURN) told_s.push_back(0.2 * i);
    }
    ASSERT_GE(told_s.size(), 2u);
    EXPECT_NEAR(told_s[1] - told_s[0], after_s, 0.3) << turned_to;
  }
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

TEST(Guide, NobodyHasArrivedWhoMayBeElsewhere) {
  const LevelPlan plan;
  for (const auto& [sigma_m, arrives] : {std::pair{1.0, true}, std::pair{4.0, false}}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    EXPECT_EQ(guide.follow({{{20, 20}, 0}, 90 * kDegree, sigma_m}, at(0)).arrived, arrives) << sigma_m;
  }
}

TEST(Guide, APlaceThatIsLessThanSureTurnsNobodyForAMoment) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  const auto kind_at = [&](double t) {
    return guide.follow({{{0, 8}, 0}, 90 * kDegree, 1.0}, at(t)).instruction.kind();
  };
  EXPECT_EQ(kind_at(0), Instruction::CONTINUE);
  EXPECT_EQ(kind_at(0.8), Instruction::CONTINUE);
  EXPECT_EQ(kind_at(1.2), Instruction::TURN);
}

TEST(Guide, WhoLooksQuiteAnotherWayIsTurnedAtOnceHoweverDoubtfulTheirPlace) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  EXPECT_EQ(guide.follow({{{0, 3}, 0}, 0.0, 1.5}, at(0)).instruction.kind(), Instruction::CONTINUE);
  EXPECT_EQ(guide.follow({{{0, 4}, 0}, 150 * kDegree, 1.5}, at(4)).instruction.kind(), Instruction::TURN);
}

TEST(Guide, WhoGetsOnNowhereIsSentBackALittle) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  std::vector<std::string> said;
  for (double t = 0; t < 13; t += 0.2) {
    const auto advice = guide.follow({{{0, 8}, 0}, 0.0, 1.5}, at(t));
    if (advice.is_new) said.push_back(advice.instruction.text());
  }
  EXPECT_THAT(said, ::testing::ElementsAre("Go straight on for 12 m.", "Go straight on for 12 m.",
                                           "You do not get on there. Turn around, and walk some steps."));
}

TEST(Guide, WhoStandsBesideThePathIsLedBackToIt) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  std::string last;
  for (double t = 0; t < 5; t += 0.2) last = guide.follow({{{0.9, 8}, 0}, 0.0, 0.7}, at(t)).instruction.text();
  EXPECT_EQ(last, "Turn left to the path.");
}

TEST(Guide, WhoComesBackToThePathAcrossIsToldInTimeToTurnAlongIt) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  double t = 0;
  for (; t < 5; t += 0.2) guide.follow({{{1.6, 8}, 0}, 0.0, 0.7}, at(t));
  const auto back = guide.follow({{{1.6, 8}, 0}, 0.0, 0.7}, at(t)).instruction;
  ASSERT_EQ(back.text(), "Turn left to the path.");
  std::vector<std::string> said;
  for (double x_m = 1.6; x_m > 0.4; x_m -= 0.26) {
    const auto advice = guide.follow({{{x_m, 8}, 0}, -80 * kDegree, 0.7}, at(t += 0.2));
    if (!advice.is_new) continue;
    said.push_back(advice.instruction.text());
    EXPECT_EQ(advice.instruction.kind(), Instruction::TURN);
    EXPECT_NEAR(advice.instruction.distance(), x_m, 0.01);
    EXPECT_NEAR(advice.turn.distance_to_turn(), 1000 * x_m, 1);
  }
  EXPECT_THAT(said, ::testing::ElementsAre("Turn right now."));
  EXPECT_EQ(guide.follow({{{0.1, 8.2}, 0}, 0.0, 0.7}, at(t += 1)).instruction.text(), "Go straight on for 12 m.");
}

TEST(Guide, WhoLooksAlongTheWayBackToThePathIsToldToGoStraightOnToIt) {
  const LevelPlan plan;
  Guide guide(plan, through_a_door(), "Room 7", false, at(0));
  guide.follow({{{0, 8}, 0}, 0.0, 0.6}, at(0));
  const auto said = guide.follow({{{5, 8}, 0}, -63 * kDegree, 0.6}, at(0.2)).instruction;
  EXPECT_EQ(said.text(), "Go straight on to the path.");
  EXPECT_EQ(said.hour(), NextTurn::HOUR_12);
}

TEST(Guide, NoiseOfAPlaceDoesNotTurnWhoWalksAlongThePath) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  int turned = 0;
  for (int i = 0; i < 40; ++i) {
    const double aside_m = i % 5 < 2 ? 1.2 : -1.2;
    const auto advice = guide.follow({{{aside_m, 0.26 * i}, 0}, 20 * kDegree, 1.6}, at(0.2 * i));
    turned += advice.instruction.kind() == Instruction::TURN && advice.instruction.distance() == 0;
  }
  EXPECT_EQ(turned, 0);
}

TEST(Guide, NoDirectionLeadsThroughAWallAnywhereInTheHouse) {
  const Building building = Building::read(FIONA_BUILDING_FILE);
  const LevelPlan plan = plan_of(building);
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0.0, 0.3);
  int checked = 0;
  for (int i = 0; i < 60; ++i) {
    const auto& from = building.rooms()[random() % building.rooms().size()];
    const auto& to = building.rooms()[random() % building.rooms().size()];
    const auto found = building.route(from, to);
    if (!found || found->length_m < 5) continue;
    Guide guide(plan, *found, "there", true, at(0));
    for (double along = 0, t = 0; along < guide.path().end_m(); along += 0.26, t += 0.2) {
      Walker walker{guide.path().place(along), 0.0, 0.0};
      const building::Point wish{walker.place.at.x_m + noise(random), walker.place.at.y_m + noise(random)};
      if (!plan.walled(walker.place.at, wish, walker.place.level)) walker.place.at = wish;
      const auto advice = guide.follow(walker, at(t));
      const bool steers =
          advice.instruction.kind() == Instruction::CONTINUE || advice.instruction.kind() == Instruction::START;
      if (!steers || !plan.level_near(walker.place.level, 0.0)) continue;
      // The hour says it to 15 degrees: one of the directions that it stands for must be free for half a metre.
      bool free = false;
      for (int off = -15; off <= 15; off += 5) {
        const double angle = advice.instruction.hour() * 30 * kDegree + off * kDegree;
        const building::Point ahead{walker.place.at.x_m + 0.5 * std::sin(angle),
                                    walker.place.at.y_m + 0.5 * std::cos(angle)};
        free = free || !plan.walled(walker.place.at, ahead, walker.place.level);
      }
      EXPECT_TRUE(free) << advice.instruction.ShortDebugString() << " at " << walker.place.at.x_m << ", "
                        << walker.place.at.y_m;
      ++checked;
    }
  }
  EXPECT_GT(checked, 500);
}

}  // namespace
}  // namespace fiona::guidance
