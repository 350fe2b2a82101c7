// How navigation finds a way, and what is to be done on it; without component and clock.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "maneuvers.hpp"
#include "navigation_world.hpp"
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
using world::way;

// ---- tasks

std::vector<std::string> actions(const navigation::CommPlan& plan) {
  std::vector<std::string> names;
  for (const auto& step : plan.steps()) names.push_back(step.action());
  return names;
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

/// A corridor with so many rooms on each side, each of which has two doors to it; and a pair of rooms with a door
/// between them is quicker than around the corner.
building::Osm ward(int rooms) {
  building::Osm osm;
  std::vector<int> south, north;
  int node = 10;
  for (int i = 0; i < rooms; ++i) {
    const double west = 6.0 * i;
    for (const bool is_north : {false, true}) {
      const double wall = is_north ? 3.0 : 0.0, far = is_north ? 8.0 : -5.0;
      const int a = node++, b = node++;
      osm.node(a, west + 1.5, wall, "door=hinged level=0").node(b, west + 4.5, wall, "door=hinged level=0");
      auto& side = is_north ? north : south;
      side.push_back(a), side.push_back(b);
      const int w1 = node++, w2 = node++, w3 = node++, w4 = node++;
      osm.node(w1, west, wall).node(w2, west + 6, wall).node(w3, west + 6, far).node(w4, west, far);
      osm.way(1000 + 2 * i + (is_north ? 1 : 0), {w1, a, b, w2, w3, w4, w1},
              "indoor=room level=0 name=Room" + std::to_string(i) + (is_north ? "N" : "S"));
    }
  }
  const int c1 = node++, c2 = node++, c3 = node++, c4 = node++;
  osm.node(c1, 0, 0).node(c2, 6.0 * rooms, 0).node(c3, 6.0 * rooms, 3).node(c4, 0, 3);
  std::vector<int> corridor{c1};
  corridor.insert(corridor.end(), south.begin(), south.end());
  corridor.push_back(c2), corridor.push_back(c3);
  corridor.insert(corridor.end(), north.rbegin(), north.rend());
  corridor.push_back(c4), corridor.push_back(c1);
  osm.way(9999, corridor, "indoor=corridor level=0");
  return osm;
}

TEST(Tasks, RoomsThatLeadNowhereElseAreNoTasksHoweverManyDoorsTheyHave) {
  const LevelPlan plan = plan_of(ward(60).read());
  ASSERT_EQ(plan.plan.rooms.size(), 121u);
  const PathPoint from{{3, 6}, 0}, to{{6.0 * 59 + 3, -3}, 0};
  TaskGraph tasks(plan, from, {});
  const auto request = tasks.request(from, to);
  EXPECT_LT(request.problem().size(), 4000u);  // 240 doors would be 2 MB
  const auto found = solve(request);
  const auto route = building::find_route(plan.plan, plan.graph, from, to, {});
  ASSERT_TRUE(route);
  EXPECT_NEAR(request.route(found).cost_s, route->cost_s, 1e-3);
}

TEST(Tasks, WhoStandsInADoorwayIsLedAsAnybodyElse) {
  const LevelPlan plan = plan_of(ward(3).read());
  const PathPoint room{{15, -3}, 0};
  for (const building::GraphNode& node : plan.graph.nodes) {
    // On the sill, where no room is, one stands at the door's own node.
    const PathPoint at{node.at, node.level};
    for (const auto& [from, to] : {std::pair(at, room), std::pair(room, at)}) {
      const auto route = building::find_route(plan.plan, plan.graph, from, to, {});
      TaskGraph tasks(plan, from, {});
      const auto request = tasks.request(from, to);
      const auto found = solve(request);
      ASSERT_EQ(found.outcome() == navigation::CommPlan::SOLVED, route.has_value())
          << from.at.x_m << ' ' << from.at.y_m;
      if (!route) continue;
      EXPECT_NEAR(request.route(found).cost_s, route->cost_s, 1e-3) << from.at.x_m << ' ' << from.at.y_m;
    }
  }
}

TEST(Tasks, ARoomThatIsAShortCutIsOne) {
  // A corridor round three sides of a hall, which has a door at each end.
  building::Osm osm;
  osm.node(2, 4, 9, "door=hinged level=0").node(3, 36, 9, "door=hinged level=0");
  const LevelPlan plan = plan_of([&] {
    for (int i = 0; i < 8; ++i) {
      const double xs[] = {0, 4, 4, 36, 36, 40, 40, 0}, ys[] = {0, 0, 30, 30, 0, 0, 34, 34};
      osm.node(20 + i, xs[i], ys[i]);
    }
    osm.way(100, {20, 21, 2, 22, 23, 3, 24, 25, 26, 27, 20}, "indoor=corridor level=0");
    osm.node(30, 4, 5).node(31, 36, 5).node(32, 36, 12).node(33, 4, 12);
    osm.way(101, {30, 31, 3, 32, 33, 2, 30}, "indoor=room level=0 name=Hall");
    return osm.read();
  }());
  const PathPoint from{{2, 9}, 0}, to{{38, 9}, 0};
  TaskGraph tasks(plan, from, {});
  const auto request = tasks.request(from, to);
  const auto route = building::find_route(plan.plan, plan.graph, from, to, {});
  ASSERT_TRUE(route);
  EXPECT_LT(route->length_m, 45);
  EXPECT_NEAR(request.route(solve(request)).cost_s, route->cost_s, 1e-3);
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

// ---- what is to be done on a way

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

TEST(Maneuvers, ATurnTowardsADoorThatIsNearIsToldWithTheDoor) {
  using building::Passage;
  const auto kinds = [](double before_m) {
    building::Route route;
    route.points.push_back({.at = {0, 0}, .level = 0, .passage = Passage::Walk});
    route.points.push_back({.at = {0, 10}, .level = 0, .passage = Passage::Walk});
    route.points.push_back({.at = {before_m, 10}, .level = 0, .passage = Passage::Walk});
    route.points.push_back({.at = {before_m + 0.5, 10}, .level = 0, .passage = Passage::Door});
    route.points.push_back({.at = {20, 10}, .level = 0, .passage = Passage::Walk});
    std::vector<int> all;
    for (const Maneuver& one : maneuvers(Path(route))) all.push_back(one.kind);
    return all;
  };
  EXPECT_THAT(kinds(1.6), ::testing::ElementsAre(int{Instruction::DOOR}, int{Instruction::ARRIVE}));
  EXPECT_THAT(kinds(5.0),
              ::testing::ElementsAre(int{Instruction::TURN}, int{Instruction::DOOR}, int{Instruction::ARRIVE}));
}

TEST(Maneuvers, StepsToTheSideAndBackAreNoTurn) {
  const auto turns = [](double aside_m) {
    building::Route route;
    for (const building::Point at : {building::Point{0, 0}, {0, 10}, {aside_m, 10}, {aside_m, 20}, {20, 20}})
      route.points.push_back({at, 0.0});
    std::vector<double> all_m;
    for (const Maneuver& one : maneuvers(Path(route)))
      if (one.kind == Instruction::TURN) all_m.push_back(one.at_m);
    return all_m;
  };
  EXPECT_THAT(turns(1.2), ::testing::ElementsAre(21.2)) << "that at the end alone";
  EXPECT_THAT(turns(2.0), ::testing::ElementsAre(10.0, 12.0, 22.0));
}

TEST(Maneuvers, StepsOnOneLevelLeadToNoOther) {
  building::Route route;
  route.points.push_back({.at = {0, 0}, .level = 1});
  route.points.push_back({.at = {0, 10}, .level = 1});
  route.points.push_back({.at = {0, 14}, .level = 1, .passage = building::Passage::Stairs});
  route.points.push_back({.at = {0, 20}, .level = 1});
  const auto words = [&](int rise) {
    route.points[2].rise = rise;
    const auto all = maneuvers(Path(route));
    EXPECT_EQ(all[0].kind, Instruction::STAIRS);
    EXPECT_FALSE(all[0].to_level);
    return maneuver_words({}, all[0], NextTurn::HOUR_12, 1, std::nullopt);
  };
  EXPECT_EQ(words(0), "Take the stairs.");
  EXPECT_EQ(words(1), "Take the stairs up.");
  EXPECT_EQ(words(-1), "Take the stairs down.");
}

TEST(Maneuvers, StepsOnOneLevelLeadUpOrDownAsTheirInclineSays) {
  building::Osm osm;
  osm.node(2, 0, 1).node(3, 20, 1).node(4, 24, 1).node(5, 44, 1);
  osm.way(10, {2, 3}, "highway=footway level=0").way(11, {4, 5}, "highway=footway level=0");
  osm.way(12, {3, 4}, "highway=steps level=0 incline=up");
  osm.rectangle(20, 0, 10, 5, 15, "indoor=room level=0 name=A");
  const LevelPlan plan = plan_of(osm.read());
  const PathPoint low{{1, 1}, 0}, high{{43, 1}, 0};
  const auto rise = [&](const PathPoint& from, const PathPoint& to) {
    for (const Maneuver& one : maneuvers(Path(way(plan, from, to)))) {
      if (one.kind == Instruction::STAIRS) return one.rise;
    }
    return 0;
  };
  EXPECT_EQ(rise(low, high), 1);
  EXPECT_EQ(rise(high, low), -1);
}

TEST(Words, LiftsAndStairsNameTheLevel) {
  building::Plan plan;
  plan.levels = {{0, 0, "Ground"}, {1, 3, ""}};
  const Maneuver stairs{Instruction::STAIRS, 0, 0, {}, 1.0};
  EXPECT_EQ(maneuver_words(plan, stairs, NextTurn::HOUR_12, 0, std::nullopt), "Take the stairs up to level 1.");
  const Maneuver lift{Instruction::LIFT, 0, 0, {}, 0.0};
  EXPECT_EQ(maneuver_words(plan, lift, NextTurn::HOUR_12, 1, 6.2), "In 6 m take the lift to Ground.");
}

}  // namespace
}  // namespace fiona::guidance
