// How a person is led along a path, told five times a second where they are.
#include <cmath>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "guide.hpp"
#include "guide_paths.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using building::Building;
using hmi::Instruction;
using hmi::NextTurn;
using world::at;
using world::corner;
using world::kDegree;
using world::plan_of;
using world::through_a_door;
using world::walk;

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

TEST(Guide, SurelyBehindAWallIsOffThePathAtOnce) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.walls.push_back({.segment = {{1.5, 0}, {1.5, 19}}, .level = 0.0});
  for (const auto& [sigma_m, off] : {std::pair{0.6, true}, std::pair{0.9, false}}) {
    Guide guide(plan, corner(), "Room 7", false, at(0));
    guide.follow({{{0, 10}, 0}, 0.0, sigma_m}, at(0));
    EXPECT_EQ(guide.follow({{{3, 10.2}, 0}, 0.0, sigma_m}, at(0.2)).off_path, off) << sigma_m;
  }
}

TEST(Guide, InTheRoomBesideThePathIsOffIt) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.doors.push_back({.at = {0.5, 10}, .level = 0.0, .normal = {1, 0}});
  Guide guide(plan, corner(), "Room 7", false, at(0));
  guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(0));
  EXPECT_TRUE(guide.follow({{{1.0, 10}, 0}, 0.0, 0}, at(2.1)).off_path);
}

TEST(Guide, NobodyArrivesBeforeTheLastDoor) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.doors.push_back({.at = {0, 10}, .level = 0.0, .normal = {0, 1}});
  building::Route route = through_a_door();
  route.points.back().at.y_m = 10.9;  // a small room
  for (const double sigma_m : {0.2, 2.5}) {
    Guide guide(plan, route, "Room 7", false, at(0));
    bool arrived = false;
    for (double y_m = 5, t = 0; y_m < 9.6; y_m += 0.26, t += 0.2) {
      arrived = arrived || guide.follow({{{0, y_m}, 0}, 0.0, sigma_m}, at(t)).arrived;
    }
    EXPECT_FALSE(arrived) << sigma_m;
    for (double y_m = 9.6, t = 4; y_m < 11.5 && !arrived; y_m += 0.26, t += 0.2) {
      arrived = guide.follow({{{0, y_m}, 0}, 0.0, sigma_m}, at(t)).arrived;
    }
    EXPECT_TRUE(arrived) << sigma_m;
  }
}

TEST(Guide, WhoMayBeElsewhereIsToldThatTheyShouldBeNearAndNotSentAway) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  std::vector<std::string> words;
  for (double x_m = 10, t = 0; t < 40; x_m = std::min(x_m + 0.26, 20.0), t += 0.2) {
    const auto advice = guide.follow({{{x_m, 20}, 0}, 90 * kDegree, 3.2}, at(t));
    EXPECT_FALSE(advice.arrived);
    if (words.empty() || words.back() != advice.instruction.text()) words.push_back(advice.instruction.text());
  }
  EXPECT_EQ(words.back(), "You should be near Room 7. It is not sure where you are.");
  EXPECT_THAT(words, ::testing::Not(::testing::Contains(::testing::HasSubstr("Turn around"))));
  EXPECT_TRUE(guide.follow({{{20, 20}, 0}, 90 * kDegree, 3.0}, at(41)).arrived) << "as sure as who tells no covariance";
}

TEST(Guide, WhoWaitsBeforeALiftsDoorKnowsForWhatAndHearsNothingMore) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.levels.push_back({1.0, 0.0, "First"});
  Guide guide(plan, world::by_a_lift(), "Room 7", false, at(0));
  double y_m = 2, t = 0;
  std::string word;
  for (; y_m < 8.8; y_m += 0.26, t += 0.2) word = guide.follow({{{0, y_m}, 0}, 0.0, 0.1}, at(t)).instruction.text();
  EXPECT_EQ(word, "Go through the door. Behind it is the lift to First.");
  for (const double until = t + 60; t < until; t += 0.2) {
    const auto advice = guide.follow({{{0, y_m}, 0}, 0.0, 0.1}, at(t));
    EXPECT_EQ(advice.instruction.text(), word) << t;
  }
}

TEST(Guide, ALiftThatIsWalkedThroughOnItsLevelIsToldAsBefore) {
  const LevelPlan plan;
  building::Route route = world::by_a_lift();
  for (auto& point : route.points) point.level = 0;
  route.points[4].at.y_m = 12;
  Guide guide(plan, route, "Room 7", false, at(0));
  std::string word;
  for (double y_m = 2, t = 0; y_m < 9; y_m += 0.26, t += 0.2)
    word = guide.follow({{{0, y_m}, 0}, 0.0, 0.1}, at(t)).instruction.text();
  EXPECT_EQ(word, "Go through the door.");
}

TEST(Guide, WhoRestsOnStairsIsNotSentBack) {
  LevelPlan plan;
  plan.plan.levels.push_back({0.0, 0.0, "Ground"});
  plan.plan.levels.push_back({1.0, 0.0, "First"});
  Guide guide(plan, world::up_round_stairs(), "Room 7", false, at(0));
  double t = 0;
  for (double x_m = 1; x_m < 5; x_m += 0.26, t += 0.2) guide.follow({{{x_m, 0}, 0}, 90 * kDegree, 0.5}, at(t));
  for (double y_m = 0; y_m < 2; y_m += 0.13, t += 0.2) guide.follow({{{5, y_m}, y_m / 8}, 0.0, 0.5}, at(t));
  for (const double until = t + 60; t < until; t += 0.2) {
    const auto advice = guide.follow({{{5, 2}, 0.25}, 0.0, 0.5}, at(t));
    EXPECT_THAT(advice.instruction.text(), ::testing::Not(::testing::HasSubstr("Turn around"))) << t;
  }
}

TEST(Guide, WhoStandsIsToldAgainUnderAnotherNumber) {
  const LevelPlan plan;
  Guide guide(plan, corner(), "Room 7", false, at(0));
  const Walker stands{{{0, 10}, 0}, 0.0, 0};
  EXPECT_TRUE(guide.follow(stands, at(0)).is_new);
  EXPECT_FALSE(guide.follow(stands, at(4.8)).is_new);
  EXPECT_TRUE(guide.follow(stands, at(5.2)).is_new);
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
