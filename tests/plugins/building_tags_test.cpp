// Tag by tag: what each says on the map, and on the way.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "osm_text.hpp"
#include "raster.hpp"

namespace fiona::building {
namespace {

using map_server::Cell;

Cell cell_at(const Building& building, double level, double x_m, double y_m, int access = 0) {
  const auto frame = map_server::frame_of(building.plan(), 0.1);
  const Point pixel = frame.to_pixel({x_m, y_m});
  const auto cells = map_server::draw(building.plan(), frame,
                                      {static_cast<int>(pixel.x_m), static_cast<int>(pixel.y_m), 1, 1}, level, access);
  return cells.front();
}

bool uses(const std::optional<Route>& route, Passage passage) {
  return route && std::any_of(route->points.begin(), route->points.end(),
                              [&](const RoutePoint& p) { return p.passage == passage; });
}

/// Two halls of 10 x 10 m beside each other, with the wall between them at x = 10.
Osm halls(const std::vector<int>& between = {}, const std::string& right = "level=0") {
  Osm osm;
  osm.node(10, 0, 0).node(11, 10, 0).node(12, 10, 10).node(13, 0, 10).node(14, 20, 0).node(15, 20, 10);
  std::vector<int> left{10, 11}, second{11, 14, 15, 12};
  left.insert(left.end(), between.begin(), between.end());
  left.insert(left.end(), {12, 13, 10});
  second.insert(second.end(), between.rbegin(), between.rend());
  second.push_back(11);
  osm.way(10, left, "indoor=room level=0 name=Left");
  return osm.way(11, second, "indoor=room name=Right " + right);
}

/// An area of 10 x 10 m on each of two levels.
Osm floors(const std::string& low = "0", const std::string& high = "1") {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 10, "indoor=area name=Low level=" + low);
  osm.rectangle(20, 0, 0, 10, 10, "indoor=area name=High level=" + high);
  return osm.node(30, 2, 5).node(31, 8, 5);
}

/// The levels that each of the stairs and lifts joins, the lowest first.
std::vector<std::vector<double>> joined(const Building& building) {
  std::vector<std::vector<double>> levels;
  for (const Connector& connector : building.connectors()) levels.push_back(connector.levels);
  std::sort(levels.begin(), levels.end());
  return levels;
}

constexpr std::array kLines = {"footway", "corridor", "path", "pedestrian", "service"};

TEST(Tags, AWallWithoutADoorIsOccupiedAndNotPassed) {
  const Building house = halls().read();
  EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Wall);
  EXPECT_FALSE(house.route(house.room("Left"), house.room("Right")));
}

TEST(Tags, ADoorIsOpenAndPassed) {
  for (const char* tags : {"door=hinged level=0", "door=yes", "indoor=door", "entrance=yes level=0"}) {
    const Building house = halls({5}).node(5, 10, 5, tags).read();
    EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Door) << tags;
    EXPECT_TRUE(uses(house.route(house.room("Left"), house.room("Right")), Passage::Door)) << tags;
  }
}

TEST(Tags, DoorNoIsNoDoor) {
  const Building house = halls({5}).node(5, 10, 5, "door=no level=0").read();
  EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Wall);
  EXPECT_FALSE(house.route(house.room("Left"), house.room("Right")));
}

TEST(Tags, ADoorIsAsWideAsItSays) {
  const Building house = halls({5}).node(5, 10, 5, "door=yes level=0 width=3").read();
  EXPECT_EQ(cell_at(house, 0, 10, 6.3), Cell::Door);
  EXPECT_EQ(cell_at(house, 0, 10, 7.0), Cell::Wall);
}

TEST(Tags, AWideDoorIsPassedWithoutADetourToItsMiddle) {
  const auto length_m = [](const std::string& width) {
    Osm osm;
    osm.rectangle(10, 0, 0, 20, 10, "indoor=room level=0 name=Hall");
    osm.node(30, 10, 0).node(5, 10, 5, "door=yes level=0 width=" + width).node(31, 10, 10);
    const Building house = osm.way(50, {30, 5, 31}, "indoor=wall level=0").read();
    const auto route = house.route(PathPoint{{7, 6.3}, 0}, PathPoint{{13, 6.3}, 0});
    return route ? route->length_m : 0.0;
  };
  EXPECT_NEAR(length_m("3"), 6.0, 0.01);
  EXPECT_GT(length_m("1"), 6.2);
}

TEST(Tags, ADoorOnALineOfItsOwnCountsToo) {
  const Building house = halls({5, 6}).node(5, 10, 4).node(6, 10, 6).way(50, {5, 6}, "door=yes level=0").read();
  EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Door);
  EXPECT_TRUE(house.route(house.room("Left"), house.room("Right")));
}

TEST(Tags, ADoorIsOnTheLevelsThatItNames) {
  Osm osm;
  osm.node(5, 10, 5, "door=yes level=1");
  osm.node(10, 0, 0).node(11, 10, 0).node(12, 10, 10).node(13, 0, 10).node(14, 20, 0).node(15, 20, 10);
  osm.way(10, {10, 11, 5, 12, 13, 10}, "indoor=room level=0;1 name=Left");
  osm.way(11, {11, 14, 15, 12, 5, 11}, "indoor=room level=0;1 name=Right");
  const Building house = osm.read();
  EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Wall);
  EXPECT_EQ(cell_at(house, 1, 10, 5), Cell::Door);
  EXPECT_FALSE(house.route(house.room("Left", 0), house.room("Right", 0)));
  EXPECT_TRUE(house.route(house.room("Left", 1), house.room("Right", 1)));
}

TEST(Tags, AWallAcrossAHallIsWalkedAround) {
  Osm osm;
  osm.rectangle(10, 0, 0, 20, 10, "indoor=room level=0 name=Hall");
  osm.node(30, 10, 0).node(31, 10, 8).way(50, {30, 31}, "indoor=wall level=0");
  const Building house = osm.read();
  EXPECT_EQ(cell_at(house, 0, 10, 4), Cell::Wall);
  const auto route = house.route(PathPoint{{5, 2}, 0}, PathPoint{{15, 2}, 0});
  ASSERT_TRUE(route);
  EXPECT_GT(route->length_m, 15.6);
  EXPECT_LT(route->length_m, 17.0);
}

TEST(Tags, TheOutlineIsAWallBeyondWhichOneComesByAnEntrance) {
  for (const auto& [building, door, cell] :
       std::vector<std::tuple<std::string, std::string, Cell>>{{"building=yes", "", Cell::Wall},
                                                               {"building=train_station", "", Cell::Wall},
                                                               {"building=yes", "entrance=yes", Cell::Door},
                                                               {"building=no", "", Cell::Free}}) {
    Osm osm;
    osm.rectangle(10, 0, 0, 10, 10, "indoor=area level=0 name=Inside");
    osm.rectangle(20, 10, 0, 20, 10, "indoor=area level=0 name=Outside");
    osm.node(40, -1, -1).node(41, 10, -1).node(5, 10, 5, door).node(42, 10, 11).node(43, -1, 11);
    const Building house = osm.way(40, {40, 41, 5, 42, 43, 40}, building).read();
    EXPECT_EQ(cell_at(house, 0, 10, 5), cell) << building << ' ' << door;
    EXPECT_EQ(house.route(house.room("Inside"), house.room("Outside")).has_value(), cell != Cell::Wall)
        << building << ' ' << door;
  }
}

TEST(Tags, CorridorsAndAreasAreOpenToEachOther) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 3, "indoor=corridor level=0 name=West");
  osm.rectangle(20, 10, 0, 20, 3, "indoor=area level=0 name=East");
  const Building house = osm.read();
  EXPECT_EQ(cell_at(house, 0, 10, 1.5), Cell::Free);
  EXPECT_TRUE(house.route(house.room("West"), house.room("East")));
}

TEST(Tags, ListsRangesFractionsAndNegativesAreLevelsEach) {
  for (const auto& [tags, levels] :
       std::vector<std::pair<std::string, std::vector<double>>>{{"level=0;2", {0, 2}},
                                                                {"level=-2--1", {-2, -1}},
                                                                {"level=0.5", {0.5}},
                                                                {"level=0 repeat_on=1-2", {0, 1, 2}},
                                                                {"level=-1;0.5;3", {-1, 0.5, 3}}}) {
    Osm osm;
    osm.rectangle(10, 0, 0, 10, 10, "indoor=room name=Hall " + tags);
    const Building house = osm.read();
    ASSERT_EQ(house.levels().size(), levels.size()) << tags;
    for (double level : levels) {
      EXPECT_EQ(cell_at(house, level, 5, 5), Cell::Free) << tags;
      EXPECT_TRUE(house.route(PathPoint{{1, 1}, level}, PathPoint{{9, 9}, level})) << tags;
    }
  }
}

TEST(Tags, LevelsThatTheBuildingSkipsAreNoLevels) {
  Osm osm;
  osm.rectangle(10, -1, -1, 11, 11, "building=yes non_existent_levels=1");
  osm.rectangle(20, 0, 0, 10, 10, "indoor=area name=Hall level=0-3").node(30, 2, 5).node(31, 8, 5);
  osm.node(32, 5, 8, "highway=elevator level=0-3");
  const Building house = osm.way(30, {30, 31}, "highway=steps level=2;3 repeat_on=0-1 incline=up").read();
  std::vector<double> levels;
  for (const Level& level : house.levels()) levels.push_back(level.level);
  EXPECT_EQ(levels, std::vector<double>({0, 2, 3}));
  EXPECT_EQ(joined(house), std::vector<std::vector<double>>({{0, 2}, {0, 2, 3}, {2, 3}}));
  EXPECT_EQ(cell_at(house, 1, 5, 2), Cell::Outside);
  EXPECT_EQ(cell_at(house, 2, 5, 2), Cell::Free);
  EXPECT_TRUE(uses(house.route(house.room("Hall", 0), house.room("Hall", 3), {.lift = false}), Passage::Stairs));
  EXPECT_TRUE(uses(house.route(house.room("Hall", 0), house.room("Hall", 2), {.stairs = false}), Passage::Lift));
}

TEST(Tags, AMultipolygonIsARoomWithItsHole) {
  Osm osm;
  osm.rectangle(10, 0, 0, 20, 20, "").rectangle(20, 5, 5, 15, 15, "");
  osm.multipolygon(1, {10}, {20}, "indoor=room level=0 name=Ring");
  const Building house = osm.read();
  EXPECT_EQ(cell_at(house, 0, 2, 10), Cell::Free);
  EXPECT_EQ(cell_at(house, 0, 10, 10), Cell::Outside);
  EXPECT_EQ(cell_at(house, 0, 5, 10), Cell::Wall);
  const auto route = house.route(PathPoint{{2, 10}, 0}, PathPoint{{18, 10}, 0});
  ASSERT_TRUE(route);
  EXPECT_GT(route->length_m, 18.0);
}

TEST(Tags, AMultipolygonOfOpenWaysIsJoined) {
  Osm osm;
  osm.node(10, 0, 0).node(11, 10, 0).node(12, 10, 10).node(13, 0, 10).node(14, 20, 0).node(15, 20, 10);
  osm.way(10, {10, 11, 5, 12}, "").way(11, {10, 13, 12}, "").node(5, 10, 5, "door=yes level=2");
  osm.way(12, {11, 14, 15, 12, 5, 11}, "indoor=room level=2 name=East");
  osm.multipolygon(1, {10, 11}, {}, "indoor=room level=2 name=Hall");
  const Building house = osm.read();
  EXPECT_EQ(cell_at(house, 2, 5, 5), Cell::Free);
  EXPECT_EQ(cell_at(house, 2, 0, 5), Cell::Wall);
  EXPECT_TRUE(uses(house.route(house.room("East"), house.room("Hall")), Passage::Door));
}

TEST(Tags, StepsJoinTheirLevelsAndAreDrawnOnBoth) {
  const Building house = floors().way(30, {30, 31}, "highway=steps level=0;1 incline=up").read();
  EXPECT_EQ(cell_at(house, 0, 5, 5), Cell::Stairs);
  EXPECT_EQ(cell_at(house, 1, 5, 5), Cell::Stairs);
  EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("High")), Passage::Stairs));
  EXPECT_FALSE(house.route(house.room("Low"), house.room("High"), {.stairs = false}));
}

TEST(Tags, StepsJoinNegativeAndHalfLevels) {
  const Building house = floors("-1", "-0.5").way(30, {30, 31}, "highway=steps level=-1;-0.5 incline=up").read();
  EXPECT_EQ(cell_at(house, -0.5, 5, 5), Cell::Stairs);
  EXPECT_TRUE(house.route(house.room("Low"), house.room("High")));
}

TEST(Tags, StepsOverThreeLevelsAreLeftAtTheMiddleOne) {
  for (const bool told : {true, false}) {
    Osm osm = floors("0", "2").rectangle(40, 0, 0, 10, 10, "indoor=area level=1 name=Middle");
    osm.node(32, 5, 5, told ? "level=1" : "").node(33, 5, 8);
    // Without a level of its own, the landing is where what leads away from it is.
    if (!told) osm.way(31, {32, 33}, "highway=footway level=1");
    const Building house = osm.way(30, {30, 32, 31}, "highway=steps level=0-2 incline=up").read();
    EXPECT_EQ(cell_at(house, 1, 3, 5), Cell::Stairs);
    EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("Middle")), Passage::Stairs)) << told;
    EXPECT_TRUE(uses(house.route(house.room("Middle"), house.room("High")), Passage::Stairs)) << told;
  }
}

TEST(Tags, StepsThatRepeatClimbAsMappedAndFromEachOtherBase) {
  using Climbs = std::vector<std::vector<double>>;
  for (const auto& [tags, climbs] :
       std::vector<std::pair<std::string, Climbs>>{{"level=0;1 repeat_on=5", {{0, 1}, {5, 6}}},
                                                   {"level=0-1 repeat_on=1-2", {{0, 1}, {1, 2}, {2, 3}}},
                                                   {"level=0;1 repeat_on=0;5", {{0, 1}, {5, 6}}},
                                                   {"level=0-2 repeat_on=4", {{0, 1, 2}, {4, 5, 6}}},
                                                   {"level=3;4 repeat_on=0", {{0, 1}, {3, 4}}},
                                                   {"level=0.1;0.3 repeat_on=2.1", {{0.1, 0.3}, {2.1, 2.3}}},
                                                   {"level=0;1 repeat_on=above", {{0, 1}}}}) {
    Osm osm;
    osm.rectangle(10, 0, 0, 10, 10, "indoor=area name=Hall level=0-7;0.1;0.3;2.1;2.3");
    osm.node(30, 2, 5).node(31, 8, 5);
    const Building house = osm.way(30, {30, 31}, "highway=steps incline=up " + tags).read();
    EXPECT_EQ(joined(house), climbs) << tags;
    for (double level = 0; level <= 7; ++level) {
      const auto reaches = [&](const auto& climb) { return std::count(climb.begin(), climb.end(), level) > 0; };
      const bool reached = std::any_of(climbs.begin(), climbs.end(), reaches);
      EXPECT_EQ(cell_at(house, level, 5, 5), reached ? Cell::Stairs : Cell::Free) << tags << ": " << level;
    }
    for (const auto& climb : climbs) {
      EXPECT_TRUE(
          uses(house.route(house.room("Hall", climb.front()), house.room("Hall", climb.back())), Passage::Stairs))
          << tags;
    }
    EXPECT_FALSE(house.route(house.room("Hall", 0), house.room("Hall", 7))) << tags;
  }
}

TEST(Tags, StepsThatRepeatKeepTheirDirectionAndTheirLanding) {
  const Building house = floors()
                             .node(32, 2, 7, "level=1")
                             .node(33, 5, 7, "level=0.5")
                             .node(34, 8, 7, "level=0")
                             .way(30, {32, 33, 34}, "highway=steps level=0;1 repeat_on=3")
                             .read();
  ASSERT_EQ(house.connectors().size(), 2u);
  std::vector<double> levels;
  for (const PathPoint& p : house.connectors()[1].path) levels.push_back(p.level);
  EXPECT_EQ(levels, std::vector<double>({4, 3.5, 3}));
}

TEST(Tags, AnEscalatorLeadsWhereItRuns) {
  for (const auto& [conveying, up, down] :
       {std::tuple("forward", true, false), {"backward", false, true}, {"yes", true, true}}) {
    const std::string tags = std::string("highway=steps level=0;1 incline=up conveying=") + conveying;
    const Building house = floors().way(30, {30, 31}, tags).read();
    EXPECT_EQ(cell_at(house, 0, 5, 5), Cell::Stairs) << conveying;
    EXPECT_EQ(cell_at(house, 1, 5, 5), Cell::Stairs) << conveying;
    EXPECT_EQ(uses(house.route(house.room("Low"), house.room("High")), Passage::Escalator), up) << conveying;
    EXPECT_EQ(uses(house.route(house.room("High"), house.room("Low")), Passage::Escalator), down) << conveying;
    EXPECT_FALSE(house.route(house.room("Low"), house.room("High"), {.stairs = false})) << conveying;
  }
}

TEST(Tags, AnEscalatorOnOneLevelLeadsWhereItRuns) {
  for (const auto& [conveying, there, back] :
       {std::tuple("forward", true, false), {"backward", false, true}, {"yes", true, true}}) {
    Osm osm;
    osm.rectangle(10, 0, 0, 10, 10, "indoor=area name=West level=0");
    osm.rectangle(20, 20, 0, 30, 10, "indoor=area name=East level=0");
    osm.node(30, 5, 5).node(31, 25, 5);
    const std::string tags = std::string("highway=steps level=0 incline=up conveying=") + conveying;
    const Building house = osm.way(30, {30, 31}, tags).read();
    EXPECT_EQ(uses(house.route(house.room("West"), house.room("East")), Passage::Escalator), there) << conveying;
    EXPECT_EQ(uses(house.route(house.room("East"), house.room("West")), Passage::Escalator), back) << conveying;
  }
}

/// Drawn on top of each other, without a hole, as Simple Indoor Tagging allows.
TEST(Tags, ARoomInAHallIsWalkedAroundAndNobodyIsLedIntoItInstead) {
  for (const std::string hall : {"room", "area", "corridor"}) {
    Osm osm;
    osm.node(42, 20, 15, "door=yes level=0");
    osm.rectangle(10, 0, 0, 40, 40, "indoor=" + hall + " name=Hall level=0");
    osm.rectangle(20, 15, 15, 25, 25, "indoor=room name=Kiosk level=0", {42});
    const Building house = osm.read();
    const PathPoint west{{1, 20}, 0}, east{{39, 20}, 0};
    const auto across = house.route(west, east);
    ASSERT_TRUE(across) << hall;
    EXPECT_LT(across->length_m, 45.0) << hall;
    EXPECT_TRUE(house.route(west, {house.room("Kiosk").centre, 0})) << hall;
    EXPECT_EQ(house.room_at(house.room("Hall").centre, 0)->name, "Hall") << hall;
    EXPECT_TRUE(house.route(west, {house.room("Hall").centre, 0})) << hall;
  }
}

TEST(Tags, ShaftsThatAreDrawnLevelByLevelJoinThem) {
  for (const std::string kind : {"elevator", "stairs"}) {
    Osm osm = floors();
    osm.rectangle(40, 3, 3, 6, 6, "indoor=room room=" + kind + " level=0");
    osm.rectangle(50, 3, 3.2, 6, 6.2, "indoor=room room=" + kind + " level=1");
    EXPECT_EQ(joined(osm.read()), (std::vector<std::vector<double>>{{0, 1}})) << kind;
    Osm alone = floors();
    const Building house = alone.rectangle(40, 3, 3, 6, 6, "indoor=room room=" + kind + " level=0").read();
    ASSERT_EQ(house.warnings().size(), 1u) << kind;
    EXPECT_NE(house.warnings().front().find("no two levels; left out"), std::string::npos) << house.warnings().front();
  }
}

TEST(Tags, APrivateCellarClosesNoStairwellToGuests) {
  for (const std::string kind : {"elevator", "stairs"}) {
    Osm osm;
    osm.rectangle(10, 0, 0, 40, 20, "indoor=area name=Floor level=0;1;2");
    osm.rectangle(20, 0, 0, 40, 20, "indoor=area name=Cellar level=-1 access=private");
    osm.node(90, 7, 5, "door=yes level=-1;0;1;2");
    osm.rectangle(30, 5, 5, 9, 10, "indoor=room level=0;1;2 room=" + kind, {90});
    osm.rectangle(40, 5, 5, 9, 10, "indoor=room level=-1 access=private room=" + kind, {90});
    const Building house = osm.read();
    const Point far{20, 3};
    EXPECT_TRUE(house.route({far, 0}, {far, 2}, {.access = kOpen})) << kind;
    EXPECT_FALSE(house.route({far, 0}, {far, -1}, {.access = kOpen})) << kind;
    EXPECT_TRUE(house.route({far, 2}, {far, -1}, {.access = kByRight})) << kind;
  }
}

TEST(Tags, AFlightHasTheAccessOfItsOwnAreas) {
  Osm osm;
  osm.rectangle(10, 5, 5, 9, 10, "indoor=room room=stairs level=0;1");
  osm.rectangle(20, 5, 5, 9, 10, "indoor=room room=stairs level=2;3 access=private");
  osm.rectangle(30, 25, 5, 29, 10, "indoor=room room=elevator level=0;1 access=private");
  const Building house = osm.read();
  std::vector<std::pair<std::int64_t, int>> access;
  for (const Connector& connector : house.connectors()) access.emplace_back(connector.id.number, connector.access);
  std::sort(access.begin(), access.end());
  EXPECT_EQ(access, (std::vector<std::pair<std::int64_t, int>>{{10, kOpen}, {20, kByRight}, {30, kByRight}}));
}

TEST(Tags, ShaftsBesideEachOtherAreShaftsOfTheirOwnThoughTheyAreOneElement) {
  for (const std::string kind : {"elevator", "stairs"}) {
    Osm osm = floors();
    osm.rectangle(40, 1, 3, 3, 6, "").rectangle(50, 7, 3, 9, 6, "");
    const Building house = osm.multipolygon(7, {40, 50}, {}, "indoor=room level=0;1 room=" + kind).read();
    EXPECT_EQ(joined(house), (std::vector<std::vector<double>>{{0, 1}, {0, 1}})) << kind;
    for (const Connector& connector : house.connectors()) {
      EXPECT_LT(distance_m(connector.path.front().at, connector.path.back().at), 0.1) << kind;
    }
  }
}

TEST(Tags, TwoShaftsUnderOneAreaAreBothJoinedToIt) {
  for (const std::string kind : {"elevator", "stairs"}) {
    for (const int wide : {24, 60}) {  // before the others in the file, and after them
      Osm osm = floors();
      osm.rectangle(40, 1, 3, 3, 6, "indoor=room level=0 room=" + kind);
      osm.rectangle(50, 7, 3, 9, 6, "indoor=room level=0 room=" + kind);
      osm.rectangle(wide, 1, 3, 9, 6, "indoor=room level=1 room=" + kind);
      const Building house = osm.read();
      EXPECT_TRUE(house.warnings().empty()) << kind;
      EXPECT_EQ(joined(house), (std::vector<std::vector<double>>{{0, 1}, {0, 1}})) << kind;
      for (const Connector& connector : house.connectors()) {
        EXPECT_LT(distance_m(connector.path.front().at, connector.path.back().at), 2.0) << kind;
      }
    }
  }
}

TEST(Tags, NoFlightIsInventedBetweenElementsThatTellTheirLevels) {
  for (const std::string kind : {"elevator", "stairs"}) {
    const auto joined_by = [&](const std::string& lower, const std::string& upper) {
      Osm osm;
      osm.rectangle(10, 0, 0, 10, 10, "indoor=area level=0-5");
      osm.rectangle(40, 3, 3, 6, 6, "indoor=room room=" + kind + " level=" + lower);
      osm.rectangle(50, 3, 3, 6, 6, "indoor=room room=" + kind + " level=" + upper);
      return joined(osm.read());
    };
    using Joined = std::vector<std::vector<double>>;
    EXPECT_EQ(joined_by("0;1", "2;3"), (Joined{{0, 1}, {2, 3}})) << kind;
    EXPECT_EQ(joined_by("0;1", "1;2"), (Joined{{0, 1}, {1, 2}})) << kind;
    EXPECT_EQ(joined_by("0", "5"), Joined{}) << kind;
    EXPECT_EQ(joined_by("0;1", "2"), kind == "stairs" ? (Joined{{0, 1}, {1, 2}}) : (Joined{{0, 1, 2}})) << kind;
  }
}

/// Floors that are one area, in which rooms stand without holes.
Osm hall_of_rooms(int across) {
  Osm osm;
  osm.rectangle(10, -3, -3, 6 * across + 3, 8 * across + 3, "indoor=area name=Hall level=0");
  for (int i = 0, id = 1000; i < across; ++i) {
    for (int j = 0; j < across; ++j, id += 10) {
      osm.node(id + 5, 6 * i + 2, 8 * j, "door=yes level=0");
      osm.rectangle(id, 6 * i, 8 * j, 6 * i + 4, 8 * j + 5, "indoor=room level=0", {id + 5});
    }
  }
  return osm;
}

TEST(Tags, AHallOfHundredsOfRoomsIsReadAndWalkedThroughAlongTheirCorners) {
  const Building house = hall_of_rooms(16).read();
  const PathPoint start{{-1, -1}, 0};
  for (const Point goal : {Point{95, 127}, Point{-1, 127}, Point{53, 70}}) {
    const auto route = house.route(start, {goal, 0});
    ASSERT_TRUE(route);
    EXPECT_LT(route->length_m, 1.2 * distance_m(start.at, goal));
  }
}

TEST(Tags, RoomsSideBySideAreWalkedAroundAsOne) {
  Osm osm;
  osm.rectangle(10, 0, 0, 30, 20, "indoor=area name=Hall level=0");
  osm.rectangle(20, 5, 5, 10, 15, "indoor=room level=0").rectangle(30, 10, 5, 20, 15, "indoor=room level=0");
  const Building house = osm.read();
  const auto hall = room_index_at(house.plan(), {2, 2}, 0);
  ASSERT_TRUE(hall);
  EXPECT_EQ(house.graph().nodes_of_room[*hall].size(), 1u + 4u) << "its middle, and their corners";
}

/// They have more corners than can be joined.
TEST(Tags, AHallOfRoundPillarsIsReadWhateverTheirNumber) {
  Osm osm;
  osm.rectangle(10, -5, -5, 200, 200, "indoor=area name=Hall level=0");
  for (int pillar = 0, id = 1000; pillar < 200; ++pillar, id += 36) {
    std::vector<int> ring;
    for (int i = 0; i < 36; ++i) {
      const double angle = i * std::numbers::pi / 18;
      osm.node(id + i, 10 * (pillar % 20) + std::cos(angle), 10 * (pillar / 20) + std::sin(angle));
      ring.push_back(id + i);
    }
    ring.push_back(id);
    osm.way(id, ring, "indoor=room level=0");
  }
  const Building house = osm.read();
  EXPECT_TRUE(house.route({{-3, -3}, 0}, {{105, 5}, 0}));
}

TEST(Tags, TheMiddleOfAHallThatItsRoomsFillIsNotItsCorner) {
  Osm osm;
  osm.rectangle(10, 0, 0, 20, 10, "indoor=area name=Floor level=0");
  osm.rectangle(20, 0.02, 0.02, 10, 10, "indoor=room level=0").rectangle(30, 10, 0, 20, 10, "indoor=room level=0");
  const Point middle = osm.read().room("Floor").centre;
  EXPECT_LT(distance_m(middle, Point{10, 5}), 1.0);
}

TEST(Tags, AMultipolygonOfWhichAWayIsMissingIsNamed) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 10, "").rectangle(20, 4, 4, 6, 6, "");
  Osm torn = osm;
  const Building whole = osm.multipolygon(1, {10}, {20}, "indoor=area level=0").read();
  EXPECT_TRUE(whole.warnings().empty());
  const Building house = torn.multipolygon(1, {10}, {99}, "indoor=area level=0").read();
  ASSERT_EQ(house.warnings().size(), 1u);
  EXPECT_EQ(house.warnings().front(),
            "relation 1: some of its ways are not in the file, or do not close to a ring: only the others are used");
}

TEST(Tags, ARoofIsNoBuilding) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 10, "indoor=area name=Platform level=0");
  osm.rectangle(20, -5, 2, 15, 8, "building=roof");
  EXPECT_TRUE(osm.read().plan().walls.empty());
}

TEST(Tags, AWayFromOneLevelToAnotherIsARampForWhoTakesNoStairs) {
  for (const std::string kind : kLines) {
    const Building house = floors().way(30, {30, 31}, "level=0;1 incline=up highway=" + kind).read();
    EXPECT_EQ(cell_at(house, 0, 5, 5), Cell::Path) << kind;
    EXPECT_EQ(cell_at(house, 1, 5, 5), Cell::Path) << kind;
    EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("High"), {.stairs = false}), Passage::Ramp)) << kind;
  }
}

TEST(Tags, ALiftNodeJoinsItsLevels) {
  const Building house = floors().node(32, 5, 5, "highway=elevator level=0-1").read();
  EXPECT_EQ(cell_at(house, 1, 5, 5), Cell::Lift);
  EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("High"), {.stairs = false}), Passage::Lift));
  EXPECT_FALSE(house.route(house.room("Low"), house.room("High"), {.lift = false}));
}

TEST(Tags, ALiftShaftJoinsItsLevelsThroughItsDoors) {
  const Building house = floors()
                             .node(5, 5, 4, "door=yes level=0;1")
                             .rectangle(40, 4, 4, 6, 6, "indoor=room room=elevator level=0;1", {5})
                             .read();
  EXPECT_EQ(cell_at(house, 0, 5, 5), Cell::Lift);
  EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("High")), Passage::Lift));
}

TEST(Tags, AStairwellJoinsItsLevelsThroughItsDoors) {
  for (const char* tags : {"room=stairs", "stairs=yes"}) {
    const Building house = floors()
                               .node(5, 5, 4, "door=yes level=0;1")
                               .rectangle(40, 4, 4, 6, 9, "indoor=room level=0;1 " + std::string(tags), {5})
                               .read();
    EXPECT_EQ(cell_at(house, 1, 5, 6), Cell::Stairs) << tags;
    EXPECT_TRUE(uses(house.route(house.room("Low"), house.room("High")), Passage::Stairs)) << tags;
  }
}

TEST(Tags, AWayWithoutALevelJoinsWhatItMeets) {
  for (const std::string kind : kLines) {
    Osm osm = floors();
    osm.node(50, -5, 5).node(51, -20, 5).way(50, {30, 50}, "highway=footway level=0");
    const Building house = osm.way(51, {50, 51}, "highway=" + kind).read();
    EXPECT_EQ(cell_at(house, 0, -5.9, 5), Cell::Path) << kind;
    EXPECT_EQ(cell_at(house, 1, -5.9, 5), Cell::Outside) << kind;
    const PathPoint inside{{5, 5}, 0}, outside{{-20, 5}, 0};
    EXPECT_TRUE(house.route(inside, outside)) << kind;
    EXPECT_FALSE(house.route(inside, outside, {.outdoors = false})) << kind;
  }
}

TEST(Tags, AWayThatIsDrawnThroughAWallOpensIt) {
  for (const std::string kind : kLines) {
    Osm osm = halls();
    osm.node(50, 5, 5).node(51, 15, 5).way(50, {50, 51}, "level=0 highway=" + kind);
    const Building house = osm.read();
    EXPECT_EQ(cell_at(house, 0, 10, 5), Cell::Path) << kind;
    EXPECT_EQ(cell_at(house, 0, 10, 6), Cell::Wall) << kind;
    EXPECT_TRUE(house.route(house.room("Left"), house.room("Right"))) << kind;
  }
}

TEST(Tags, TheEntranceLeadsOutUnlessOneStaysInside) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 10, "indoor=room level=0 name=Hall", {5}).node(5, 5, 0, "entrance=main level=0");
  const Building house = osm.node(50, 5, -20).way(50, {5, 50}, "highway=footway").read();
  EXPECT_EQ(cell_at(house, 0, 5, 0), Cell::Door);
  const PathPoint inside{{5, 5}, 0}, outside{{5, -20}, 0};
  const auto out = house.route(inside, outside);
  EXPECT_TRUE(uses(out, Passage::Door));
  EXPECT_TRUE(out && std::any_of(out->points.begin(), out->points.end(), [](const auto& p) { return p.outdoors; }));
  EXPECT_FALSE(house.route(inside, outside, {.outdoors = false}));
}

TEST(Tags, WhoIsBesideABuildingBeginsOnTheWayThatIsInSight) {
  Osm osm;
  osm.node(1, 0, 0).node(2, 10, 0).node(3, 20, 0).node(4, 20, 4).node(5, 10, 4).node(6, 0, 4);
  osm.node(7, 10, 2, "door=yes level=0").node(8, 20, 2, "entrance=yes level=0");
  osm.way(10, {1, 2, 7, 5, 6, 1}, "indoor=room level=0").way(11, {2, 3, 8, 4, 5, 7, 2}, "indoor=room level=0");
  osm.node(50, 14, -4).node(51, 30, -4).way(50, {50, 51, 8}, "highway=footway level=0");
  // Seen from the middle of the rooms: the door between them is nearer than the way.
  const auto route = osm.read().route({{1, -3}, 0}, {{20, -6}, 0});
  ASSERT_TRUE(route);
  EXPECT_FALSE(uses(route, Passage::Door));
  EXPECT_NEAR(route->length_m, std::hypot(3, 3) + 16, 0.1);
}

TEST(Tags, WhoStaysIndoorsTakesNoWayAroundTheBuilding) {
  Osm osm;
  osm.node(5, 0, 5, "entrance=yes level=0").node(6, 40, 5, "entrance=yes level=0").node(50, 20, -10);
  osm.node(10, 0, 0).node(11, 10, 0).node(12, 10, 10).node(13, 0, 10);
  osm.way(10, {10, 11, 12, 13, 5, 10}, "indoor=room level=0 name=Left");
  osm.node(20, 30, 0).node(21, 40, 0).node(22, 40, 10).node(23, 30, 10);
  osm.way(20, {20, 21, 6, 22, 23, 20}, "indoor=room level=0 name=Right");
  const Building house = osm.way(50, {5, 50, 6}, "highway=footway").read();
  const auto around = house.route(house.room("Left"), house.room("Right"));
  ASSERT_TRUE(around);
  EXPECT_TRUE(
      std::any_of(around->points.begin(), around->points.end(), [](const RoutePoint& p) { return p.outdoors; }));
  EXPECT_FALSE(house.route(house.room("Left"), house.room("Right"), {.outdoors = false}));
}

TEST(Tags, APrivateRoomIsClosedToGuestsAndOpenToStaff) {
  for (const char* tags : {"access=private", "access=staff", "access=employees", "access=permit", "access=delivery",
                           "access=emergency", "foot=private access=yes", "fiona:access=5"}) {
    const Building house = halls({5}, "level=0 " + std::string(tags)).node(5, 10, 5, "door=yes level=0").read();
    EXPECT_EQ(cell_at(house, 0, 15, 5, 0), Cell::Closed) << tags;
    EXPECT_EQ(cell_at(house, 0, 15, 5, 5), Cell::Free) << tags;
    EXPECT_FALSE(house.route(house.room("Left"), house.room("Right"), {.access = 4})) << tags;
    EXPECT_TRUE(house.route(house.room("Left"), house.room("Right"), {.access = 5})) << tags;
  }
}

TEST(Tags, WhoIsInAPrivateRoomMayLeaveIt) {
  const Building house = halls({5}, "level=0 access=private").node(5, 10, 5, "door=yes level=0").read();
  EXPECT_TRUE(house.route(house.room("Right"), house.room("Left"), {.access = 0}));
}

TEST(Tags, ADoorForStaffIsClosedToGuests) {
  const Building house = halls({5}).node(5, 10, 5, "door=yes level=0 access=private").read();
  EXPECT_EQ(cell_at(house, 0, 10, 5, 0), Cell::Closed);
  EXPECT_FALSE(house.route(house.room("Left"), house.room("Right"), {.access = 0}));
  EXPECT_TRUE(house.route(house.room("Left"), house.room("Right")));
}

TEST(Tags, AccessNoIsForNobody) {
  const Building house = halls({5}, "level=0 access=no").node(5, 10, 5, "door=yes level=0").read();
  EXPECT_EQ(cell_at(house, 0, 15, 5, 9), Cell::Closed);
  EXPECT_FALSE(house.route(house.room("Left"), house.room("Right")));
}

TEST(Tags, AnAccessThatIsNoNumberClosesAndIsTold) {
  const Building house = halls({5}, "level=0 fiona:access=ten").node(5, 10, 5, "door=yes level=0").read();
  EXPECT_EQ(house.rooms()[1].access, kClosed);
  ASSERT_EQ(house.warnings().size(), 1u);
  EXPECT_EQ(house.warnings()[0], "way 11: fiona:access=ten is not a whole number from 0 to 10; closed");
}

}  // namespace
}  // namespace fiona::building
