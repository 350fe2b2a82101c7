// How navigation finds a way and leads along it, without component and clock.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "guide.hpp"
#include "landmarks.hpp"
#include "navigation_world.hpp"
#include "shown_position.hpp"
#include "words.hpp"

namespace fiona::guidance {
namespace {

using building::Building;
using building::PathPoint;
using building::RouteOptions;
using hmi::Instruction;
using hmi::NextTurn;
using ::testing::HasSubstr;
using world::house;
using world::plan_of;
using world::solve;
using namespace std::chrono_literals;

constexpr double kDegree = std::numbers::pi / 180.0;

TimePoint at(double seconds) { return TimePoint(Duration(static_cast<std::int64_t>(seconds * 1e9))); }

// ---- tasks

std::vector<std::string> actions(const navigation::CommPlan& plan) {
  std::vector<std::string> names;
  for (const auto& step : plan.steps()) names.push_back(step.action());
  return names;
}

building::Route way(const LevelPlan& plan, PathPoint from, PathPoint to, const RouteOptions& options = {}) {
  TaskGraph tasks(plan, from, options);
  const auto request = tasks.request(from, to);
  return request.route(solve(request));
}

const PathPoint kA{{5, 6}, 0};
const PathPoint kB{{15, 6}, 0};
const PathPoint kC{{25, 6}, 0};
const PathPoint kD{{25, 6}, 1};

TEST(Tasks, AWayThroughDoorsAndByStairsIsWalkPassClimb) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {.lift = false});
  const auto found = solve(tasks.request(kA, kD));
  EXPECT_THAT(actions(found), ::testing::ElementsAre("walk", "pass", "walk", "climb", "walk", "pass", "walk"));
  EXPECT_TRUE(found.is_optimal());
}

TEST(Tasks, WithoutStairsTheLiftIsRidden) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {.stairs = false});
  EXPECT_THAT(actions(solve(tasks.request(kA, kD))), ::testing::Contains("ride"));
}

TEST(Tasks, WithoutEitherThereIsNoPlan) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {.stairs = false, .lift = false});
  EXPECT_EQ(solve(tasks.request(kA, kD)).outcome(), navigation::CommPlan::UNSOLVABLE);
}

TEST(Tasks, ARoomForStaffIsClosedToGuestsAndOpenToWhoIsInIt) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph guest(plan, kA, {.access = 0});
  EXPECT_EQ(solve(guest.request(kA, kB)).outcome(), navigation::CommPlan::UNSOLVABLE);
  EXPECT_FALSE(guest.suits(kB, {.access = 0}));
  EXPECT_EQ(way(plan, kA, kB, {.access = 5}).points.back().at, kB.at);
}

TEST(Tasks, WhoSeesTheGoalWalksStraight) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {});
  EXPECT_EQ(tasks.request({{2, 5}, 0}, {{8, 7}, 0}).tasks(), 1u);
}

TEST(Tasks, RoomsThatNoWayLeadsThroughAreLeftOut) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {.stairs = false, .lift = false});
  // Out of A, along the hall, into C: neither B nor the street, and nothing twice.
  EXPECT_EQ(tasks.request(kA, kC).tasks(), 8u) << tasks.request(kA, kC).problem();
}

TEST(Tasks, APlanOfAnotherBuildingIsRefused) {
  const LevelPlan plan = plan_of(house().read());
  TaskGraph tasks(plan, kA, {});
  const auto request = tasks.request(kA, kD);
  navigation::CommPlan made_up;
  auto& step = *made_up.add_steps();
  step.set_action("fly");
  step.add_arguments("start");
  step.add_arguments("goal");
  try {
    request.route(made_up);
    ADD_FAILURE() << "nothing was refused";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("the plan is none of this building: there is no task 'fly start goal'"));
  }
  EXPECT_THROW(request.route(navigation::CommPlan{}), Error);
}

/// Ways between places drawn by chance: what the tasks cost is what the graph's optimum costs.
void compare_costs(const Building& building, const std::vector<PathPoint>& places, int draws) {
  const LevelPlan plan = plan_of(building);
  const RouteOptions profiles[] = {{}, {.stairs = false}, {.lift = false}, {.outdoors = false}, {.access = 0}};
  std::mt19937 random(7);
  int ways = 0;
  for (const RouteOptions& options : profiles) {
    for (int i = 0; i < draws; ++i) {
      const PathPoint& from = places[random() % places.size()];
      const PathPoint& to = places[random() % places.size()];
      TaskGraph tasks(plan, from, options);
      const auto request = tasks.request(from, to);
      const auto solved = solve(request);
      const auto best = building.route(from, to, options);
      ASSERT_EQ(solved.outcome() == navigation::CommPlan::SOLVED, best.has_value()) << solved.message();
      if (!best) continue;
      ++ways;
      EXPECT_NEAR(solved.cost(), best->cost_s, 1e-4);
      const auto route = request.route(solved);
      EXPECT_NEAR(route.cost_s, best->cost_s, 1e-4);
      EXPECT_NEAR(route.length_m, best->length_m, 1e-6 + 0.05 * best->length_m);
      EXPECT_EQ(route.points.back().at, to.at);
    }
  }
  EXPECT_GT(ways, draws);
}

TEST(Tasks, CostWhatTheGraphsOptimumCostsInTheHouse) {
  const Building building = Building::read(FIONA_BUILDING_FILE);
  std::vector<PathPoint> places;
  for (const auto& room : building.rooms()) places.push_back({room.centre, room.level});
  compare_costs(building, places, 30);
}

TEST(Tasks, CostWhatTheGraphsOptimumCostsInAStation) {
  const char* data = std::getenv("FIONA_DATA");
  const auto file = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "osm_indoor" / "da_hbf_2.osm.pbf";
  if (!std::filesystem::exists(file)) GTEST_SKIP() << "no map of a station: " << file;
  const Building building = Building::read(file);
  std::vector<PathPoint> places;
  for (const auto& connector : building.connectors()) places.push_back(connector.path.front());
  compare_costs(building, places, 6);
}

// ---- maps that make no sense

std::string refusal_of(const navigation::CommLevelMap& map) {
  try {
    read_level_plan(map);
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was refused";
}

TEST(LevelPlan, AMapWithoutLevelsIsRefused) {
  navigation::CommLevelMap map = world::told(house().read());
  map.clear_levels();
  EXPECT_THAT(refusal_of(map), HasSubstr("has no levels"));
}

TEST(LevelPlan, ARoomIsToldByNameAndNumberAndTheNumberOnce) {
  LevelPlan plan = read_level_plan(world::told(house().read()));
  auto& room = plan.plan.rooms.front();
  const PathPoint inside{room.centre, room.level};
  const auto told = [&](const char* name, const char* ref) {
    room.name = name, room.ref = ref;
    return plan.room_name(inside).value_or("");
  };
  EXPECT_EQ(told("Library", "0.04"), "Library (0.04)");
  EXPECT_EQ(told("Office 1.09", "1.09"), "Office 1.09");
  EXPECT_EQ(told("Library", ""), "Library");
  EXPECT_EQ(told("", "0.04"), "0.04");
}

TEST(LevelPlan, EachDoorLeadsThroughItsWall) {
  const Building building = house().read();
  const LevelPlan plan = read_level_plan(world::told(building));
  for (const building::Door& door : plan.plan.doors) {
    EXPECT_TRUE(plan.behind_door(door.at - door.normal, door.at + door.normal, door.level)) << door.at.x_m;
    EXPECT_FALSE(plan.walled(door.at - door.normal * 0.3, door.at + door.normal * 0.3, door.level)) << door.at.x_m;
  }
  EXPECT_FALSE(plan.plan.doors.empty());
}

TEST(LevelPlan, AnEdgeToNowhereIsRefused) {
  navigation::CommLevelMap map = world::told(house().read());
  map.mutable_edges(0)->set_to(100000);
  EXPECT_THAT(refusal_of(map), HasSubstr("100000"));
}

TEST(LevelPlan, AnOutlineWithMoreXThanYIsRefused) {
  navigation::CommLevelMap map = world::told(house().read());
  map.mutable_rooms(0)->mutable_outline()->add_x(1);
  EXPECT_THAT(refusal_of(map), HasSubstr("has a broken outline of room"));
}

// ---- a walk along the path

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
                  {.at = {5, 1}, .level = 0},
                  {.at = {5, 2}, .level = 0, .passage = Passage::Door},
                  {.at = {5, 20}, .level = 0}};
  Guide guide(plan, route, "Room 7", false, at(0));
  EXPECT_EQ(guide.follow({{{4, 0}, 0}, 90 * kDegree, 1.0}, at(0)).instruction.kind(), Instruction::TURN);
  for (const double t : {3.0, 3.2}) {
    EXPECT_EQ(guide.follow({{{5, 1.9}, 0}, 0.0, 1.0}, at(t)).instruction.kind(), Instruction::DOOR) << t;
  }
  EXPECT_EQ(guide.follow({{{5, 4}, 0}, 0.0, 1.0}, at(6)).instruction.kind(), Instruction::CONTINUE);
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
  EXPECT_THAT(said,
              ::testing::ElementsAre("Go through the door.", "Go on for 10 m to Room 7.", "Go through the door."));
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
  for (const double y_m : {8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 10.9}) EXPECT_EQ(told_at(y_m), Instruction::DOOR) << y_m;
  EXPECT_EQ(told_at(11.1), Instruction::TURN);
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

TEST(Maneuvers, DoorsStairsAndLiftsAreThoseOfTheWay) {
  const LevelPlan plan = plan_of(house().read());
  const auto kinds = [&](const RouteOptions& options) {
    std::vector<int> all;
    for (const Maneuver& one : maneuvers(Path(way(plan, kA, kD, options)))) all.push_back(one.kind);
    return all;
  };
  EXPECT_THAT(kinds({.lift = false}), ::testing::IsSupersetOf({int{Instruction::DOOR}, int{Instruction::STAIRS},
                                                               int{Instruction::DOOR}, int{Instruction::ARRIVE}}));
  EXPECT_THAT(kinds({.stairs = false}), ::testing::Contains(int{Instruction::LIFT}));
}

TEST(Maneuvers, ADoorToTheStreetIsLeftByAndEnteredBy) {
  const LevelPlan plan = plan_of(house().read());
  const auto kind = [](const building::Route& route) { return maneuvers(Path(route)); };
  const auto is = [](Instruction::Kind wanted) { return ::testing::Field(&Maneuver::kind, wanted); };
  EXPECT_THAT(kind(way(plan, kA, {{-10, 1.5}, 0})), ::testing::Contains(is(Instruction::LEAVE)));
  EXPECT_THAT(kind(way(plan, {{-10, 1.5}, 0}, kA)), ::testing::Contains(is(Instruction::ENTER)));
}

TEST(Words, LiftsAndStairsNameTheLevel) {
  building::Plan plan;
  plan.levels = {{0, 0, "Ground"}, {1, 3, ""}};
  const Maneuver stairs{Instruction::STAIRS, 0, 0, {}, 1.0};
  EXPECT_EQ(maneuver_words(plan, stairs, NextTurn::HOUR_12, 0, std::nullopt), "Take the stairs up to level 1.");
  const Maneuver lift{Instruction::LIFT, 0, 0, {}, 0.0};
  EXPECT_EQ(maneuver_words(plan, lift, NextTurn::HOUR_12, 1, 6.2), "In 6 m take the lift to Ground.");
}

// ---- points of attention

TEST(Landmarks, ATextIsThreeNumbersAndAName) {
  const auto lift = parse_landmark("12.5,-3,1 lift B");
  ASSERT_TRUE(lift);
  EXPECT_EQ(lift->place.at, (building::Point{12.5, -3}));
  EXPECT_EQ(lift->place.level, 1);
  EXPECT_EQ(lift->name, "lift B");
  EXPECT_TRUE(parse_landmark("0,0,-0.5"));
  for (const char* text : {"", "1,2", "1,2,", "a,b,c", "1;2;3", "1,2,3x", "nan,0,0", "1e999,0,0"}) {
    EXPECT_FALSE(parse_landmark(text)) << text;
  }
}

TEST(Landmarks, APointIsToldOnceInPassingAndAgainAfterOneWasAway) {
  const LevelPlan plan;
  Passing passing;
  passing.watch({{{{10, 0}, 0}, "statue"}});
  std::vector<double> told_m;
  for (double x : {0.0, 5.0, 8.0, 10.0, 12.0, 20.0, 10.0}) {
    if (!passing.follow(plan, {{x, 0}, 0}, 3.0).empty()) told_m.push_back(x);
  }
  EXPECT_THAT(told_m, ::testing::ElementsAre(8.0, 10.0));
}

TEST(Landmarks, APointIsNeverToldOnAnotherLevelOrThroughAWall) {
  LevelPlan plan;
  plan.plan.walls.push_back({.segment = {{-5, 1}, {5, 1}}, .level = 0.0});
  Passing passing;
  passing.watch({{{{0, 0}, 0}, "statue"}});
  EXPECT_TRUE(passing.follow(plan, {{0, 0}, 1}, 3.0).empty());
  EXPECT_TRUE(passing.follow(plan, {{0, 0}, 0.5}, 3.0).empty());
  EXPECT_TRUE(passing.follow(plan, {{0, 2}, 0}, 3.0).empty());
  EXPECT_EQ(passing.follow(plan, {{0, -2}, 0}, 3.0).size(), 1u);
}

// ---- the place shown

TEST(ShownPosition, FollowsAWalkerAsLocalisationSays) {
  ShownPosition shown;
  for (int i = 0; i < 50; ++i) {
    const auto now = shown.follow({{0.26 * i, 0}, 0}, {1, 0, 1}, at(0.2 * i));
    EXPECT_DOUBLE_EQ(now.at.x_m, 0.26 * i);
    EXPECT_FALSE(now.blending);
  }
}

TEST(ShownPosition, AJumpIsBlendedWithinThreeSeconds) {
  ShownPosition shown;
  shown.follow({{0, 0}, 0}, {0.1, 0, 0.1}, at(0));
  double before = 0;
  for (double t = 0.2; t < 3.3; t += 0.2) {
    const auto now = shown.follow({{6, 0}, 0}, {0.1, 0, 0.1}, at(t));
    EXPECT_LE(now.at.x_m - before, 0.5);
    EXPECT_GE(now.at.x_m, before);
    EXPECT_EQ(now.blending, now.at.x_m < 6);
    before = now.at.x_m;
  }
  EXPECT_EQ(before, 6);
}

TEST(ShownPosition, WhatIsLessThanTwoSigmaIsNoJump) {
  ShownPosition shown;
  shown.follow({{0, 0}, 0}, {4, 0, 4}, at(0));
  EXPECT_FALSE(shown.follow({{3.9, 0}, 0}, {4, 0, 4}, at(0.2)).blending);
  EXPECT_TRUE(shown.follow({{8.1, 0}, 0}, {4, 0, 4}, at(0.4)).blending);
}

/// Whether the 95 % ellipse at `middle` contains a place.
bool covers(const ShownPosition::Shown& shown, building::Point place) {
  const building::Point d = place - shown.at;
  const Covariance& c = shown.covariance;
  const double det = c.xx_m2 * c.yy_m2 - c.xy_m2 * c.xy_m2;
  return (c.yy_m2 * d.x_m * d.x_m - 2 * c.xy_m2 * d.x_m * d.y_m + c.xx_m2 * d.y_m * d.y_m) / det <= 5.991 + 1e-6;
}

TEST(ShownPosition, TheEllipseCoversThatOfBeforeAndTheNewOneAllTheWay) {
  ShownPosition shown;
  const Covariance before{0.5, 0.2, 0.3};
  const Covariance after{0.4, -0.1, 0.9};
  shown.follow({{1, 2}, 0}, before, at(0));
  const auto on_ellipse = [](building::Point middle, const Covariance& c, double angle) {
    // Cholesky of the covariance, at the 95 % radius.
    const double a = std::sqrt(c.xx_m2), b = c.xy_m2 / a, e = std::sqrt(c.yy_m2 - b * b);
    const double u = std::sqrt(5.991) * std::cos(angle), v = std::sqrt(5.991) * std::sin(angle);
    return building::Point{middle.x_m + a * u, middle.y_m + b * u + e * v};
  };
  for (double t = 0.2; t < 3.0; t += 0.2) {
    const auto now = shown.follow({{5, -1}, 0}, after, at(t));
    for (double angle = 0; angle < 6.3; angle += 0.1) {
      EXPECT_TRUE(covers(now, on_ellipse({5, -1}, after, angle))) << t << " " << angle;
      if (t < 0.3) {
        EXPECT_TRUE(covers(now, on_ellipse({1, 2}, before, angle))) << angle;
      }
    }
    EXPECT_TRUE(covers(now, {1, 2})) << t;
  }
}

TEST(ShownPosition, AnotherLevelIsShownAtOnceAndIsAJump) {
  ShownPosition shown;
  shown.follow({{1, 2}, 0}, {0.5, 0, 0.5}, at(0));
  for (double t = 0.2; t < 3.3; t += 0.2) {
    const auto now = shown.follow({{1, 2}, 1}, {0.5, 0, 0.5}, at(t));
    EXPECT_EQ(now.at, (building::Point{1, 2}));
    EXPECT_EQ(now.blending, t < 3.1) << t;
  }
  for (double level = 1; level < 2; level += 0.1) {
    EXPECT_FALSE(shown.follow({{1, 2}, level}, {0.5, 0, 0.5}, at(4 + level)).blending) << "stairs";
  }
}

}  // namespace
}  // namespace fiona::guidance
