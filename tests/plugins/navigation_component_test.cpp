// The navigation component on the bench: the way, what is said on it, and the place that is shown.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "led_person.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using hmi::InstructionProvider;
using hmi::NextTurn;
using localisation::CommLocation;
using localisation::LocationProvider;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using world::destination;
using world::Led;
using world::location;
using namespace std::chrono_literals;

/// Another one may have led before, and whoever shows guidance still shows that.
TEST(Navigation, WhoIsNotLedIsToldSoFromTheStart) {
  Led led;
  ASSERT_EQ(led.paths_at_start.size(), 1u);
  EXPECT_FALSE(led.paths_at_start[0].is_valid());
  ASSERT_EQ(led.said_at_start.size(), 1u);
  EXPECT_EQ(led.said_at_start[0].kind(), Instruction::KIND_UNSPECIFIED);
}

TEST(Navigation, ADestinationGivesAPathAndAnInstruction) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0));
  const auto paths = led.paths();
  ASSERT_EQ(paths.size(), 1u);
  EXPECT_TRUE(paths[0].is_valid());
  EXPECT_DOUBLE_EQ(paths[0].waypoints(0).x(), 5);
  EXPECT_DOUBLE_EQ(paths[0].waypoints().rbegin()->z(), 1);
  const Instruction first = led.last();
  EXPECT_EQ(first.kind(), Instruction::START);
  EXPECT_THAT(first.text(), HasSubstr("To D, "));
  EXPECT_EQ(first.number(), 1u);
  EXPECT_EQ(led.bench.probe<std::int64_t>("plans"), 1);
}

TEST(Navigation, WhoMayBeInSeveralRoomsLeavesTheirsFirstAndIsLedOnceTheyAreFound) {
  Led led;
  led.stand(location(5, 6, 0, 0, 6.0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0, 0, 6.0), 4s);
  const Instruction sought = led.last();
  EXPECT_EQ(sought.kind(), Instruction::START);
  EXPECT_EQ(sought.text(), "It is not sure yet where you are. Leave the room that you are in, or walk some steps.");
  EXPECT_EQ(sought.hour(), NextTurn::TYPE_OF_TURN_UNSPECIFIED) << "no direction can be right";
  EXPECT_TRUE(sought.uncertain());
  EXPECT_TRUE(led.paths().empty());
  led.stand(location(5, 4, 0, 0, 1.0), 1s);
  EXPECT_EQ(led.paths().size(), 1u);
  EXPECT_THAT(led.last().text(), AllOf(HasSubstr("To D, "), Not(HasSubstr("door")))) << "they go through it already";
}

TEST(Navigation, WhoHasNotLeftTheirRoomIsToldOfItsDoorInTheEnd) {
  Led led;
  led.stand(location(5, 6, 0, 0, 6.0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0, 0, 6.0), 4s);
  led.stand(location(5, 4, 0, 0, 1.0), 12s);
  EXPECT_THAT(led.last().text(), HasSubstr("go through the door"));
}

TEST(Navigation, WhoIsNotFoundBetterIsLedAllTheSame) {
  Led led;
  led.stand(location(5, 6, 0, 0, 6.0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0, 0, 6.0), 12s);
  EXPECT_EQ(led.paths().size(), 1u);
}

TEST(Navigation, AQuarterTurnRightIsHourThreeWhereTheCompassIsFifteenDegreesOff) {
  Led led;
  led.map.mutable_reference()->set_reference_lat(47.6);
  led.map.mutable_reference()->set_reference_long(-122.3);  // Seattle
  // In the hall before the door of C, which is in the north. By the compass alone, which says 245, the turn were
  // hour 4.
  const double looks_deg = 260;
  led.stand(location(25, 1, 0, looks_deg - 15));
  led.go_to(destination(25, 6, 0));
  led.stand(location(25, 1, 0, looks_deg - 15));
  const auto turns = led.bench.take<hmi::LocalPath>("turn");
  ASSERT_FALSE(turns.empty());
  EXPECT_EQ(turns.back()->type_of_turn(), NextTurn::HOUR_3);
}

TEST(Navigation, EveryDestinationThatLeadsNowhereIsASentence) {
  Led led;
  led.stand(location(5, 6, 0));
  const auto answer_to = [&](navigation::CommDestination wish) {
    led.go_to(wish);
    led.stand(location(5, 6, 0));
    const Instruction last = led.last();
    EXPECT_EQ(last.kind(), Instruction::NO_PATH) << last.ShortDebugString();
    return last.text();
  };
  auto invalid = destination(25, 6, 1);
  invalid.mutable_destination()->set_is_valid(false);
  EXPECT_EQ(answer_to(invalid), "The destination is not a valid place.");
  auto outdoors = destination(25, 6, 1);
  outdoors.mutable_destination()->clear_z();
  EXPECT_EQ(answer_to(outdoors), "The destination has no level: destinations are indoors.");
  EXPECT_EQ(answer_to(destination(25, 6, 7)), "house has no level 7.");
  EXPECT_EQ(answer_to(destination(500, 6, 1)), "The destination is in no room of house.");
  EXPECT_EQ(answer_to(destination(15, 6, 0)),
            "There is no way to B that is open to you: doors on it need another right.");
  led.profile.set_use_stairs(false);
  led.profile.set_use_elevator(false);
  EXPECT_EQ(answer_to(destination(25, 6, 1)),
            "There is no way to D without stairs, and your profile leaves stairs out.");
}

TEST(Navigation, WhoSeemsToBeBehindADoorThatIsClosedToThemIsNotToldThatThereIsNoWay) {
  const auto told = [](double sigma_m) {
    Led led;
    led.stand(location(15, 6, 0, 0, sigma_m));
    led.go_to(destination(5, 6, 0));
    led.stand(location(15, 6, 0, 0, sigma_m));
    return led.last();
  };
  EXPECT_EQ(told(0.1).kind(), Instruction::NO_PATH);
  const Instruction unsure = told(1.5);
  EXPECT_EQ(unsure.kind(), Instruction::START);
  EXPECT_EQ(unsure.text(), "It is not sure yet where you are. Leave the room that you are in, or walk some steps.");
}

TEST(Navigation, FromAPlaceThatIsLessThanSureAWayIsSoughtAgain) {
  const auto ways_from = [](double sigma_m) {
    Led led;
    led.profile.set_use_stairs(false);
    led.profile.set_use_elevator(false);
    led.stand(location(25, 6, 1, 0, sigma_m));
    led.go_to(destination(25, 6, 0));
    led.stand(location(25, 6, 1, 0, sigma_m));
    EXPECT_EQ(led.last().kind(), Instruction::NO_PATH);
    led.stand(location(5, 6, 0, 0, sigma_m), 6s);
    const auto paths = led.paths();
    return std::count_if(paths.begin(), paths.end(), [](const auto& path) { return path.is_valid(); });
  };
  EXPECT_EQ(ways_from(1.0), 1) << "they have been on the other level all the time";
  EXPECT_EQ(ways_from(0.1), 0) << "who is elsewhere than they surely were asks again";
}

TEST(Navigation, APlannerThatIsLateIsToldAndTriedAgain) {
  Led led;
  bool answers = false;
  led.bench.answer_with<navigation::PlanProvider>("planner",
                                                  [&](const auto& request) { return world::solve(request); });
  Led late;
  int asked = 0;
  late.bench.answer_with<navigation::PlanProvider>("planner", [&](const auto& request) {
    ++asked;
    if (answers) return world::solve(request);
    navigation::CommPlan plan;
    plan.set_outcome(navigation::CommPlan::OUT_OF_TIME);
    plan.set_message("no plan was found within the time bound of 1000 ms");
    return plan;
  });
  late.stand(location(5, 6, 0));
  late.go_to(destination(25, 6, 1));
  late.stand(location(5, 6, 0));
  EXPECT_EQ(late.last().text(), "The way cannot be planned: no plan was found within the time bound of 1000 ms.");
  answers = true;
  late.stand(location(5, 6, 0), 3s);
  EXPECT_EQ(late.last().kind(), Instruction::START);
  EXPECT_EQ(asked, 2);
}

TEST(Navigation, APlannerThatDoesNotAnswerIsTold) {
  testing::Bench<Navigation> bench("nav");
  const auto map = world::told(world::house().read());
  bench.answer_with<navigation::LevelMap>("levels", [&](const auto&) { return map; });
  bench.start();
  bench.put<LocationProvider>("location", location(5, 6, 0));
  bench.put<navigation::DestinationProvider>("destination", destination(25, 6, 0));
  for (int i = 0; i < 20; ++i) {
    bench.put<LocationProvider>("location", location(5, 6, 0));
    bench.advance(200ms);
  }
  std::string told;
  for (const auto& one : bench.take<InstructionProvider>("instructions")) told = one->text();
  EXPECT_THAT(told, HasSubstr("it does not answer"));
}

TEST(Navigation, WhoseLocalisationIsSilentIsToldToStopAndThenLedOn) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0));
  led.said();
  led.bench.advance(2s);
  const auto told = led.said();
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0].kind(), Instruction::LOST);
  EXPECT_TRUE(told[0].uncertain());
  led.stand(location(5, 6, 0), 200ms);
  const Instruction again = led.last();
  EXPECT_NE(again.kind(), Instruction::LOST);
  EXPECT_EQ(again.number(), told[0].number() + 1);
}

TEST(Navigation, WhoLeavesThePathIsToldAndLedFromThere) {
  Led led;
  led.stand(location(5, 2, 0, 90));
  led.go_to(destination(25, 6, 0));
  led.stand(location(5, 2, 0, 90), 1s);
  led.paths();
  led.said();
  led.stand(location(5, 6, 0, 90), 7s);  // into A: behind a wall
  std::vector<int> kinds;
  for (const auto& one : led.said()) kinds.push_back(one.kind());
  EXPECT_THAT(kinds, ::testing::Contains(int{Instruction::REROUTE}));
  const auto paths = led.paths();
  ASSERT_GE(paths.size(), 2u);
  EXPECT_FALSE(paths.front().is_valid());
  EXPECT_TRUE(paths.back().is_valid());
  EXPECT_NEAR(paths.back().waypoints(0).y(), 6, 0.5);
  EXPECT_EQ(led.bench.probe<std::int64_t>("reroutes"), 1);
}

TEST(Navigation, AtTheDestinationThePersonIsToldAndThePathEnds) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(8, 6, 0));
  led.stand(location(5, 6, 0));
  led.stand(location(7.2, 6, 0), 3s);
  EXPECT_EQ(led.last().kind(), Instruction::ARRIVE);
  EXPECT_FALSE(led.paths().back().is_valid());
}

TEST(Navigation, WhoArrivesWhileTheirPlaceMovesOverIsNotInDoubtForEver) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(8, 6, 0));
  led.stand(location(5, 6, 0));
  led.stand(location(7.4, 6, 0), 200ms);
  EXPECT_TRUE(led.last().uncertain());
  led.stand(location(7.4, 6, 0), 4s);
  const Instruction last = led.last();
  EXPECT_EQ(last.kind(), Instruction::ARRIVE);
  EXPECT_FALSE(last.uncertain());
}

TEST(Navigation, WhoWasLostWhereThereIsNoWayHearsAgainThatThereIsNone) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(15, 6, 0));
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.last().kind(), Instruction::NO_PATH);
  led.bench.advance(2s);
  EXPECT_EQ(led.last().kind(), Instruction::LOST);
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.last().kind(), Instruction::NO_PATH) << "and does not stop and wait for ever";
}

TEST(Navigation, HoursAreThoseInFrontOfThePersonHoweverTheyHoldTheDevice) {
  constexpr double kDegree = std::numbers::pi / 180.0;
  for (const double rises_deg : {0.0, 30.0, 60.0, 90.0, 100.0}) {
    // Who looks east. Beyond the vertical the top points back, and the screen to the ground.
    const bool is_beyond = rises_deg > 90;
    CommLocation here = location(5, 6, 0, is_beyond ? 270 : 90);
    here.mutable_orientation()->set_pitch(2 * std::numbers::pi - (is_beyond ? 180 - rises_deg : rises_deg) * kDegree);
    here.mutable_orientation()->set_roll(is_beyond ? std::numbers::pi : 0.0);
    Led led;
    led.stand(here);
    led.go_to(destination(9.5, 6, 0));
    led.stand(here);
    const auto said = led.said();
    ASSERT_FALSE(said.empty());
    EXPECT_EQ(said.back().hour(), hmi::NextTurn::HOUR_12) << rises_deg << ": " << said.back().text();
  }
}

TEST(Navigation, AMotionFasterThanPeopleWalkIsNoCourse) {
  Led led;
  const auto without_compass = [](double x) {
    CommLocation told = location(x, 6, 0, 0, 0.5);
    told.mutable_orientation()->set_is_valid(false);
    return told;
  };
  led.stand(without_compass(5));
  led.go_to(destination(9.5, 6, 0));
  for (double x = 5; x < 8; x += 0.26) led.stand(without_compass(x), 200ms);
  led.said();
  led.stand(without_compass(5.4), 200ms);  // a leap back
  for (const auto& one : led.said()) EXPECT_THAT(one.text(), ::testing::Not(HasSubstr("Turn around")));
}

TEST(Navigation, APlaceWithoutALevelIsOnTheLastOneForAWhile) {
  Led led;
  CommLocation flat = location(5, 6, 0);
  flat.mutable_position()->clear_z();
  led.stand(flat);
  led.go_to(destination(9.5, 6, 0));
  led.stand(flat);
  EXPECT_THAT(led.said().back().text(), HasSubstr("Your place is not known yet")) << "nobody has told a level";
  led.stand(location(5, 6, 0));
  led.said();
  led.stand(flat);
  for (const auto& one : led.said()) EXPECT_THAT(one.text(), ::testing::Not(HasSubstr("not known")));
  led.stand(flat, 12s);
  EXPECT_THAT(led.said().back().text(), HasSubstr("Your place is not known any more"));
}

TEST(Navigation, WhoAsksAgainIsAnsweredAgain) {
  Led led;
  led.stand(location(5, 6, 0));
  std::vector<std::uint32_t> numbers;
  for (int i = 0; i < 2; ++i) {
    led.go_to(destination(15, 6, 0));
    led.stand(location(5, 6, 0));
    for (const auto& one : led.said()) numbers.push_back(one.number());
  }
  EXPECT_THAT(numbers, ::testing::ElementsAre(1u, 0u, 2u)) << "what led to the first one holds no more";
}

TEST(Navigation, TheLocationShownIsBlendedAndTheInstructionSaysUncertain) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(8, 6, 0));
  led.stand(location(5, 6, 0));
  led.bench.take<LocationProvider>("shown");
  led.said();
  led.stand(location(2, 6, 0), 200ms);
  const auto shown = led.bench.take<LocationProvider>("shown");
  ASSERT_EQ(shown.size(), 1u);
  EXPECT_NEAR(shown[0]->position().x(), 5, 0.3);
  EXPECT_GT(shown[0]->position().confidence(0), 1.0);
  EXPECT_TRUE(led.last().uncertain());
  led.stand(location(2, 6, 0), 4s);
  EXPECT_EQ(led.bench.take<LocationProvider>("shown").back()->position().x(), 2);
  EXPECT_FALSE(led.last().uncertain());
}

TEST(Navigation, APlaceOfWhichNobodySaysHowSureItIsIsUncertain) {
  Led led;
  const auto unsure = [](double x, double y) {
    CommLocation told = location(x, y, 0, 90);
    told.mutable_position()->clear_confidence();
    return told;
  };
  led.stand(unsure(5, 6));
  led.go_to(destination(25, 6, 0));
  led.stand(unsure(5, 6), 2s);
  ASSERT_TRUE(led.last_path().is_valid());
  EXPECT_TRUE(led.last().uncertain());
  led.stand(location(5, 6, 0, 90), 2s);
  EXPECT_FALSE(led.last().uncertain());
}

/// A radio map that was learnt before the building was drawn anew tells places in the frame of then.
TEST(Navigation, APlaceInAnotherFrameIsMovedToTheMaps) {
  Led led;
  auto& reference = *led.map.mutable_reference();
  reference.set_reference_lat(48.4);
  reference.set_reference_long(9.99);
  led.stand(location(5, 6, 0), 2s);
  led.tell_of_change(7);
  const auto told_in = [](double latitude, double heading_deg, double x, double y) {
    CommLocation told = location(x, y, 0, 90);
    auto& position = *told.mutable_position();
    position.set_confidence(0, 0.04);
    position.set_reference_lat(latitude);
    position.set_reference_long(9.99);
    position.set_reference_heading(heading_deg);
    return told;
  };
  const auto shown = [&](const CommLocation& told) {
    led.stand(told, 5s);
    return led.bench.take<LocationProvider>("shown").back()->position();
  };
  const auto own = shown(told_in(48.4, 0, 5, 6));
  EXPECT_EQ(own.x(), 5);
  EXPECT_EQ(own.y(), 6);
  const double metre_deg = 1.0 / 111206.0;  // of latitude, there
  const auto north = shown(told_in(48.4 + 2 * metre_deg, 0, 5, 4));
  EXPECT_NEAR(north.x(), 5, 0.01);
  EXPECT_NEAR(north.y(), 6, 0.01);
  EXPECT_NEAR(north.reference_lat(), 48.4, 1e-12);
  // Its y axis points to the east, its x axis to the south.
  const auto turned = shown(told_in(48.4, 90, -6, 5));
  EXPECT_NEAR(turned.x(), 5, 0.01);
  EXPECT_NEAR(turned.y(), 6, 0.01);
  EXPECT_NEAR(turned.confidence(0), 0.01, 1e-6);
  EXPECT_NEAR(turned.confidence(4), 0.04, 1e-6);
  EXPECT_THAT(led.bench.log(), ::testing::Contains(HasSubstr("in a frame of their own")));
}

TEST(Navigation, ADestinationInAnotherFrameIsMovedToTheMapsEachTimeThatOnePlans) {
  Led led;
  auto& reference = *led.map.mutable_reference();
  reference.set_reference_lat(48.4);
  reference.set_reference_long(9.99);
  led.stand(location(5, 6, 0));
  // Its y axis points to the east, its x axis to the south.
  auto wish = destination(-6, 25, 1);
  auto& place = *wish.mutable_destination();
  place.set_reference_lat(48.4);
  place.set_reference_long(9.99);
  place.set_reference_heading(90);
  led.go_to(wish);
  led.stand(location(5, 6, 0));
  EXPECT_THAT(led.last().text(), HasSubstr("To D, "));
  auto end = *led.last_path().waypoints().rbegin();
  EXPECT_NEAR(end.x(), 25, 0.01);
  EXPECT_NEAR(end.y(), 6, 0.01);
  // The building is drawn anew, by a reference 1 m further south.
  reference.set_reference_lat(48.4 - 1 / 111206.0);
  led.map.set_version(7);
  led.tell_of_change(7);
  led.stand(location(5, 6, 0));
  end = *led.last_path().waypoints().rbegin();
  EXPECT_NEAR(end.y(), 7, 0.01);
}

TEST(Navigation, APathTellsHowOneGetsAlongEachOfItsLegs) {
  using navigation::MapEdge;
  const auto legs = [](const navigation::CommDestination& wish, const CommLocation& from) {
    Led led;
    led.stand(from);
    led.go_to(wish);
    led.stand(from);
    const navigation::CommPath path = led.last_path();
    EXPECT_EQ(path.legs_size(), path.waypoints_size() - 1);
    std::vector<int> kinds;
    std::unique_copy(path.legs().begin(), path.legs().end(), std::back_inserter(kinds));
    return kinds;
  };
  EXPECT_THAT(legs(destination(25, 6, 1), location(27, 1, 0)),
              ElementsAre(MapEdge::CORRIDOR, MapEdge::LIFT, MapEdge::CORRIDOR, MapEdge::DOOR, MapEdge::CORRIDOR));
  EXPECT_THAT(legs(destination(5, 6, 0), location(-9, 1.5, 0)),
              ElementsAre(MapEdge::CORRIDOR, MapEdge::OUTDOORS, MapEdge::DOOR, MapEdge::CORRIDOR, MapEdge::DOOR,
                          MapEdge::CORRIDOR));
}

/// Only what is shown moves over.
TEST(Navigation, GuidanceKnowsOfALeapAtOnce) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(8, 6, 0));
  led.stand(location(5, 6, 0));
  led.stand(location(7.4, 6, 0), 200ms);
  EXPECT_EQ(led.last().kind(), Instruction::ARRIVE);
  EXPECT_LT(led.bench.take<LocationProvider>("shown").back()->position().x(), 6.0);
}

TEST(Navigation, APlaceThatIsNotFollowedInTimeIsShownAgainWithItsOwnTime) {
  Led led;
  led.stand(location(5, 6, 0));
  const auto last = led.bench.take<LocationProvider>("shown").back();
  led.bench.advance(700ms);
  const auto again = led.bench.take<LocationProvider>("shown");
  ASSERT_GE(again.size(), 2u);
  for (const auto& one : again) {
    EXPECT_EQ(one->position().x(), 5);
    EXPECT_EQ(one.origin, last.origin);
  }
  led.bench.advance(2s);
  led.bench.take<LocationProvider>("shown");
  led.bench.advance(1s);
  EXPECT_THAT(led.bench.take<LocationProvider>("shown"), ::testing::IsEmpty()) << "it is lost";
}

}  // namespace
}  // namespace fiona::guidance
