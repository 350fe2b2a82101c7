#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <osmium/io/pbf_output.hpp>
#include <osmium/io/reader.hpp>
#include <osmium/io/writer.hpp>
#include <osmium/io/xml_input.hpp>

#include <fiona/building/building.hpp>
#include <fiona/building/svg.hpp>
#include <fiona/error.hpp>

#include "../temporary_directory.hpp"
#include "osm_text.hpp"

namespace fiona::building {
namespace {

/// A corridor 20 x 3 m with two rooms of 10 x 5 m north of it; the left one has a door.
Osm corridor_with_two_rooms() {
  Osm osm;
  osm.node(5, 5, 3, "door=hinged level=0");
  osm.rectangle(10, 0, 0, 20, 3, "indoor=corridor level=0 name=Corridor");
  osm.rectangle(20, 0, 3, 10, 8, "indoor=room level=0 name=Left ref=A1", {5});
  osm.rectangle(30, 10, 3, 20, 8, "indoor=room level=0 name=Right material=concrete");
  return osm;
}

std::string error_of(const std::string& xml) {
  try {
    Building::parse(xml, "house.osm");
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

Building own_building() { return Building::read(FIONA_BUILDING_FILE); }

using Levels = std::vector<double>;

TEST(Levels, ListsRangesAndFractionsAreRead) {
  EXPECT_EQ(parse_levels("0"), Levels({0}));
  EXPECT_EQ(parse_levels("-1;0.5"), Levels({-1, 0.5}));
  EXPECT_EQ(parse_levels("1-3"), Levels({1, 2, 3}));
  EXPECT_EQ(parse_levels("-2--1; 4"), Levels({-2, -1, 4}));
  EXPECT_EQ(parse_levels("-1-1;1"), Levels({-1, 0, 1}));
  EXPECT_EQ(parse_levels("0.5-2"), Levels({0.5, 1.5, 2}));
}

TEST(Levels, TextThatIsNoListIsRefused) {
  for (const char* text : {"", "ground", "0,1", "1;", "1-", "--1", "nan", "1e9", "0-100000"}) {
    EXPECT_FALSE(parse_levels(text)) << text;
  }
}

TEST(Levels, HalfLevelsLieHalfWayUpTheirStorey) {
  const Heights heights{3.0, {{0, 4.0}, {-1, 2.5}}};
  EXPECT_DOUBLE_EQ(heights.floor_m(0.5), 2.0);
  EXPECT_DOUBLE_EQ(heights.floor_m(2), 7.0);
  EXPECT_DOUBLE_EQ(heights.floor_m(-1), -2.5);
  EXPECT_DOUBLE_EQ(heights.floor_m(-2), -5.5);
}

TEST(Levels, LevelAtAHeightIsTheReverseOfItsHeight) {
  const Heights heights{3.0, {{0, 4.0}, {-1, 2.5}}};
  for (double level : {-2.25, -1.0, -0.5, 0.0, 0.75, 1.0, 3.5}) {
    EXPECT_NEAR(heights.level_at(heights.floor_m(level)), level, 1e-12);
  }
}

TEST(BuildingFile, RoomsKeepNameRefLevelAndPlaceInMetres) {
  const Building house = corridor_with_two_rooms().read();
  const Room& left = house.room("Left");
  EXPECT_EQ(left.ref, "A1");
  EXPECT_EQ(left.level, 0.0);
  EXPECT_NEAR(area_m2(left.polygon), 50.0, 0.2);
  EXPECT_NEAR(left.centre.x_m, 5.0, 0.1);
  EXPECT_NEAR(left.centre.y_m, 5.5, 0.1);
}

TEST(BuildingFile, ARoomOnSeveralLevelsIsARoomOnEach) {
  Osm osm;
  osm.rectangle(10, 0, 0, 5, 5, "indoor=room level=0-1 repeat_on=4 name=Shaft");
  const Building house = osm.read();
  Levels levels;
  for (const Room& room : house.rooms()) levels.push_back(room.level);
  EXPECT_EQ(levels, Levels({0, 1, 4}));
}

/// The same elements as PBF.
std::string as_pbf(const std::string& xml) {
  const tests::TemporaryDirectory folder;
  const std::filesystem::path file = folder.path / "house.osm.pbf";
  osmium::io::Reader reader(osmium::io::File(xml.data(), xml.size(), "osm"));
  osmium::io::Writer writer(osmium::io::File(file.string(), "pbf"), osmium::io::overwrite::allow);
  while (osmium::memory::Buffer buffer = reader.read()) writer(std::move(buffer));
  writer.close();
  std::ostringstream bytes;
  bytes << std::ifstream(file, std::ios::binary).rdbuf();
  return bytes.str();
}

TEST(BuildingFile, PbfIsReadAsXmlIsWhateverItsName) {
  const std::string xml = corridor_with_two_rooms().text();
  const Building one = Building::parse(xml, "house.osm");
  const Building two = Building::parse(as_pbf(xml), "house.osm");
  ASSERT_EQ(one.rooms().size(), two.rooms().size());
  for (std::size_t i = 0; i < one.rooms().size(); ++i) {
    EXPECT_EQ(one.rooms()[i].name, two.rooms()[i].name);
    EXPECT_EQ(one.rooms()[i].polygon.outer, two.rooms()[i].polygon.outer);
  }
  EXPECT_EQ(one.graph().edges.size(), two.graph().edges.size());
}

TEST(BuildingFile, APbfThatEndsEarlyIsRefusedByName) {
  const std::string pbf = as_pbf(corridor_with_two_rooms().text());
  for (std::size_t size : {std::size_t{20}, pbf.size() / 2, pbf.size() - 1}) {
    EXPECT_NE(error_of(pbf.substr(0, size)).find("cannot read the building file house.osm: "), std::string::npos)
        << size;
  }
}

TEST(BuildingFile, ANodeFarAwayLeavesItsElementOutAndTheRestInPlace) {
  Osm osm = corridor_with_two_rooms();
  osm.node(70, 0, 0).node(71, 900'000, 0).node(72, 0, 5).way(70, {70, 71, 72, 70}, "indoor=room level=0 name=Typo");
  const Building house = osm.read();
  EXPECT_EQ(house.rooms().size(), 3u);
  ASSERT_EQ(house.warnings().size(), 1u);
  EXPECT_EQ(house.warnings()[0], "way 70: node 71 is more than 5 km away from the building; left out");
}

TEST(BuildingFile, ABorderThatCrossesItselfIsARoomAllTheSame) {
  Osm osm;
  osm.node(10, 0, 0).node(11, 10, 9).node(12, 10, 0).node(13, 0, 10);
  osm.way(10, {10, 11, 12, 13, 10}, "indoor=room level=0 name=Bow");
  const Building house = osm.read();
  ASSERT_EQ(house.rooms().size(), 1u);
  EXPECT_TRUE(contains(house.room("Bow").polygon, house.room("Bow").centre));
}

TEST(BuildingFile, ARoomWithTooManyCornersIsRefusedByNumber) {
  Osm osm;
  std::vector<int> ring;
  for (int i = 0; i <= 20'000; ++i) {
    osm.node(100 + i, 50 * std::cos(i * 3e-4), 50 * std::sin(i * 3e-4));
    ring.push_back(100 + i);
  }
  ring.push_back(100);
  const std::string error = error_of(osm.way(10, ring, "indoor=room level=0 name=Circle").text());
  EXPECT_NE(error.find("house.osm, way 10: the building file house.osm has too many corners"), std::string::npos)
      << error;
  EXPECT_NE(error.find("at most 20000"), std::string::npos) << error;
}

TEST(BuildingFile, LiftsThatWouldMakeTooManyEdgesAreRefusedByNumber) {
  Osm osm = corridor_with_two_rooms();
  for (int i = 0; i < 100; ++i) osm.node(1000 + i, 1 + 0.1 * i, 1, "highway=elevator level=0-199");
  const std::string error = error_of(osm.text());
  EXPECT_NE(error.find("has too many ways to walk"), std::string::npos) << error;
  EXPECT_NE(error.find("node 1052"), std::string::npos) << error;
}

TEST(BuildingFile, ATownWhoseBuildingsTakeTooLongToTellApartIsRefused) {
  Osm osm;
  std::vector<int> ring;
  for (int i = 0; i < 2000; ++i) {
    osm.node(10'000 + i, 50 * std::cos(i * 3.1e-3), 50 * std::sin(i * 3.1e-3));
    ring.push_back(10'000 + i);
  }
  ring.push_back(10'000);
  for (int i = 0; i < 200; ++i) osm.way(100 + i, ring, "building=yes");
  for (int i = 0; i < 3000; ++i) osm.node(20'000 + i, 0.01 * i, 0, "level=0");
  const std::string error = error_of(osm.text());
  EXPECT_NE(error.find("house.osm takes too long to make sense of"), std::string::npos) << error;
  EXPECT_NE(error.find("osmium extract -b"), std::string::npos) << error;
}

TEST(BuildingFile, MoreElementsThanAnyBuildingHasAreRefusedWithTheStepThatHelps) {
  std::string xml = "<osm version='0.6'>";
  std::string members;
  for (int i = 0; i < 2000; ++i) members += "<nd ref='1'/>";
  for (int i = 1; i <= 1500; ++i) xml += "<way id='" + std::to_string(i) + "'>" + members + "</way>";
  const std::string error = error_of(xml + "</osm>");
  EXPECT_NE(error.find("it has more than 3000000 nodes, tags and members"), std::string::npos) << error;
  EXPECT_NE(error.find("osmium extract -b"), std::string::npos);
}

TEST(BuildingFile, AMultipolygonHasItsHole) {
  const Building house = own_building();
  const Room& corridor = house.room("Ring Corridor", 0.0);
  ASSERT_EQ(corridor.polygon.holes.size(), 1u);
  EXPECT_FALSE(contains(corridor.polygon, {30, 17}));
  EXPECT_TRUE(contains(corridor.polygon, {30, 9}));
}

TEST(BuildingFile, HeightsComeFromTheLevelElements) {
  const Building house = own_building();
  EXPECT_DOUBLE_EQ(house.height_m(1), 3.6);
  EXPECT_DOUBLE_EQ(house.height_m(0.5), 1.8);
}

TEST(BuildingFile, WithoutHeightsAStoreyIsThreeMetres) {
  EXPECT_DOUBLE_EQ(corridor_with_two_rooms().read().height_m(2), 6.0);
}

TEST(BuildingFile, ALevelThatTheBuildingSkipsHasNoHeight) {
  Osm osm = corridor_with_two_rooms();
  osm.rectangle(40, -1, -1, 21, 9, "building=yes non_existent_levels=-1;1");
  const Building house = osm.read();
  EXPECT_DOUBLE_EQ(house.height_m(2), 3.0);
  EXPECT_DOUBLE_EQ(house.height_m(3), 6.0);
  EXPECT_DOUBLE_EQ(house.height_m(-2), -3.0);
}

TEST(BuildingFile, WithoutATaggedReferenceTheCentroidOfTheOutlineIsTheOrigin) {
  Osm osm = corridor_with_two_rooms();
  osm.rectangle(40, 0, 0, 20, 8, "building=yes");
  std::string xml = osm.text();
  xml.replace(xml.find("fiona:reference"), 15, "note:reference!");
  const Building house = Building::parse(xml, "house.osm");
  EXPECT_FALSE(house.reference().from_file);
  EXPECT_NEAR(house.to_local({48.0, 10.0}).x_m, -10.0, 0.05);
  EXPECT_NEAR(house.to_local({48.0, 10.0}).y_m, -4.0, 0.05);
}

TEST(BuildingFile, TheHeadingTurnsTheLocalFrame) {
  std::string xml = corridor_with_two_rooms().text();
  const std::string reference = "<tag k='fiona:reference' v='yes'/>";
  xml.replace(xml.find(reference), reference.size(), reference + "<tag k='fiona:heading' v='90'/>");
  const Building house = Building::parse(xml, "house.osm");
  const Point east = house.to_local({48.0, 10.0 + 10.0 / 74629.6});
  EXPECT_NEAR(east.y_m, 10.0, 0.02);
  EXPECT_NEAR(east.x_m, 0.0, 0.02);
}

TEST(BuildingFile, LocalAndWgs84AreInverse) {
  const Building house = own_building();
  const Point back = house.to_local(house.to_wgs84({12.5, 30.25}));
  EXPECT_NEAR(back.x_m, 12.5, 1e-6);
  EXPECT_NEAR(back.y_m, 30.25, 1e-6);
}

TEST(BuildingFile, LocalAndWgs84AreInverseAtTheFarthestTooWhereTheEarthHasCurvedAway) {
  const Building house = own_building();
  const Point back = house.to_local(house.to_wgs84({-5000.0, 5000.0}));
  EXPECT_NEAR(back.x_m, -5000.0, 1e-6);
  EXPECT_NEAR(back.y_m, 5000.0, 1e-6);
}

TEST(BuildingFile, OwnBuildingIsReadWithoutAWarning) {
  const Building house = own_building();
  EXPECT_EQ(house.name(), "Blautal House");
  EXPECT_EQ(house.levels().size(), 2u);
  EXPECT_EQ(house.warnings(), std::vector<std::string>{});
}

TEST(BuildingFile, AFileThatEndsEarlyNamesFileLineAndNextStep) {
  const std::string xml = corridor_with_two_rooms().text();
  const std::string error = error_of(xml.substr(0, xml.size() / 2));
  EXPECT_NE(error.find("cannot read the building file house.osm: line "), std::string::npos) << error;
  EXPECT_NE(error.find("a file that ends early was not fully copied"), std::string::npos) << error;
}

TEST(BuildingFile, EveryCutOfTheFileGivesAnErrorAndNothingElse) {
  const std::string xml = corridor_with_two_rooms().text();
  for (std::size_t size = 0; size + 7 < xml.size(); size += 97) {
    EXPECT_NE(error_of(xml.substr(0, size)), "no error") << size;
  }
}

TEST(BuildingFile, TextThatIsNotOsmIsRefused) {
  const std::string error = error_of("<html><body>404</body></html>");
  EXPECT_NE(error.find("cannot read the building file house.osm"), std::string::npos) << error;
  EXPECT_NE(error.find("open it in JOSM"), std::string::npos) << error;
}

TEST(BuildingFile, EntityBombsAreRefused) {
  const std::string error = error_of(
      "<!DOCTYPE x [<!ENTITY a 'aaaaaaaa'><!ENTITY b '&a;&a;&a;&a;'>]>"
      "<osm version='0.6'><node id='1' lat='1' lon='1'><tag k='n' v='&b;'/></node></osm>");
  EXPECT_NE(error.find("ntit"), std::string::npos) << error;
}

TEST(BuildingFile, AFileWithoutLevelsSaysWhatIsMissing) {
  const std::string error = error_of("<osm version='0.6'><node id='1' lat='48' lon='10'/></osm>");
  EXPECT_NE(error.find("house.osm has nothing on a level"), std::string::npos) << error;
  EXPECT_NE(error.find("Simple_Indoor_Tagging"), std::string::npos) << error;
}

TEST(BuildingFile, AMissingFileIsNotFound) {
  try {
    Building::read("no/such/house.osm");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    EXPECT_NE(std::string(error.what()).find("no/such/house.osm: there is no such file"), std::string::npos);
  }
}

TEST(BuildingFile, TwoReferencesAreRefusedWithBothNodes) {
  Osm osm = corridor_with_two_rooms();
  osm.node(7, 1, 1, "fiona:reference=yes");
  const std::string error = error_of(osm.text());
  EXPECT_NE(error.find("has two references"), std::string::npos) << error;
  EXPECT_NE(error.find("node 1 and node 7"), std::string::npos) << error;
}

TEST(BuildingFile, ARoomWithoutALevelIsLeftOutAndNamed) {
  Osm osm = corridor_with_two_rooms();
  osm.rectangle(50, 0, 10, 5, 15, "indoor=room name=Lost");
  const Building house = osm.read();
  EXPECT_EQ(house.warnings(),
            std::vector<std::string>{"way 50: it has no level; left out (add level=0 for the ground floor)"});
  EXPECT_EQ(house.rooms().size(), 3u);
}

TEST(BuildingFile, ALevelThatCannotBeReadIsLeftOutAndQuoted) {
  Osm osm = corridor_with_two_rooms();
  osm.rectangle(50, 0, 10, 5, 15, "indoor=room level=0,1");
  EXPECT_EQ(osm.read().warnings(),
            std::vector<std::string>{"way 50: level=0,1 is not a list of levels such as 0, -1;0 or 1-3; left out"});
}

TEST(BuildingFile, ARoomWhoseNodesAreMissingIsLeftOutAndNamed) {
  Osm osm = corridor_with_two_rooms();
  osm.way(60, {10, 11, 999, 10}, "indoor=room level=0");
  EXPECT_EQ(osm.read().warnings(), std::vector<std::string>{"way 60: node 999 is not in the file; left out"});
}

TEST(BuildingRooms, TheSmallestRoomAroundAPointIsFound) {
  Osm osm = corridor_with_two_rooms();
  osm.rectangle(50, 1, 5, 3, 7, "indoor=area level=0 name=Corner");
  const Building house = osm.read();
  EXPECT_EQ(house.room_at({2, 6}, 0)->name, "Corner");
  EXPECT_EQ(house.room_at({6, 6}, 0)->name, "Left");
  EXPECT_EQ(house.room_at({6, 6}, 1), nullptr);
  EXPECT_EQ(house.room_at({6, 60}, 0), nullptr);
}

TEST(BuildingRooms, AnUnknownNameOffersTheNearest) {
  try {
    own_building().room("Libary");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::NotFound);
    ASSERT_FALSE(error.text().near.empty());
    EXPECT_EQ(error.text().near.front(), "Library");
  }
}

TEST(BuildingWalls, AWallBetweenTwoRoomsCountsOnceWithTheStrongerMaterial) {
  const Crossings crossed = corridor_with_two_rooms().read().walls_crossed({8, 5}, {12, 5}, 0);
  EXPECT_EQ(crossed.walls, 1);
  EXPECT_DOUBLE_EQ(crossed.attenuation_db, 12.0);
}

TEST(BuildingWalls, TwoFacesOfOneThickWallCountOnce) {
  Osm osm;
  osm.rectangle(10, 0, 0, 5, 5, "indoor=room level=0");
  osm.rectangle(20, 5.3, 0, 10, 5, "indoor=room level=0");
  EXPECT_EQ(osm.read().walls_crossed({2, 2}, {8, 3}, 0).walls, 1);
}

TEST(BuildingWalls, ADoorIsAGapOfItsWidth) {
  const Building house = corridor_with_two_rooms().read();
  EXPECT_EQ(house.walls_crossed({5, 1}, {5, 5}, 0).walls, 0);
  EXPECT_EQ(house.walls_crossed({5.4, 1}, {5.4, 5}, 0).walls, 0);
  EXPECT_EQ(house.walls_crossed({5.6, 1}, {5.6, 5}, 0).walls, 1);
}

TEST(BuildingWalls, AreasAndCorridorsHaveNoWallsOfTheirOwn) {
  Osm osm;
  osm.rectangle(10, 0, 0, 5, 5, "indoor=area level=0");
  EXPECT_EQ(osm.read().walls_crossed({2, 2}, {8, 2}, 0).walls, 0);
}

TEST(BuildingWalls, AWayThroughTheCeilingMeetsTheWallsOfBothFloors) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 5, "indoor=area level=0;1");
  osm.node(20, 2, 0).node(21, 2, 5).way(20, {20, 21}, "indoor=wall level=0 fiona:attenuation=7");
  osm.node(30, 8, 0).node(31, 8, 5).way(30, {30, 31}, "indoor=wall level=1 material=glass");
  const Building house = osm.read();
  EXPECT_DOUBLE_EQ(house.walls_crossed({0, 2}, 1.0, {10, 2}, 5.0).attenuation_db, 10.0);
  EXPECT_DOUBLE_EQ(house.walls_crossed({0, 2}, 1.0, {10, 2}, 2.0).attenuation_db, 7.0);
}

TEST(BuildingRoutes, ARouteLeadsThroughTheDoor) {
  const Building house = corridor_with_two_rooms().read();
  const auto route = house.route(house.room("Corridor"), house.room("Left"));
  ASSERT_TRUE(route);
  const bool by_door = std::any_of(route->points.begin(), route->points.end(), [](const RoutePoint& p) {
    return p.passage == Passage::Door && distance_m(p.at, Point{5, 3}) < 0.05;
  });
  EXPECT_TRUE(by_door);
  EXPECT_NEAR(route->length_m, 8.3, 1.0);
}

TEST(BuildingRoutes, ARoomWithoutADoorHasNoRoute) {
  const Building house = corridor_with_two_rooms().read();
  EXPECT_FALSE(house.route(house.room("Corridor"), house.room("Right")));
}

TEST(BuildingRoutes, ARouteCrossesNoWall) {
  const Building house = own_building();
  for (const Room& room : house.rooms()) {
    const auto route = house.route(house.room("Workshop"), room);
    ASSERT_TRUE(route) << room.name;
    for (std::size_t i = 1; i < route->points.size(); ++i) {
      const RoutePoint &a = route->points[i - 1], &b = route->points[i];
      const int walls = a.level == b.level ? house.walls_crossed(a.at, b.at, a.level).walls : 0;
      EXPECT_EQ(walls, 0) << room.name;
    }
  }
}

bool uses(const Route& route, Passage passage) {
  return std::any_of(route.points.begin(), route.points.end(),
                     [&](const RoutePoint& p) { return p.passage == passage; });
}

TEST(BuildingRoutes, WithoutStairsTheLiftIsTakenAndWithoutTheLiftTheStairs) {
  const Building house = own_building();
  const Room& from = house.room("Workshop");
  const Room& to = house.room("Kitchen");
  const auto by_lift = house.route(from, to, {.stairs = false});
  const auto by_stairs = house.route(from, to, {.lift = false});
  ASSERT_TRUE(by_lift && by_stairs);
  EXPECT_TRUE(uses(*by_lift, Passage::Lift));
  EXPECT_FALSE(uses(*by_lift, Passage::Stairs));
  EXPECT_TRUE(uses(*by_stairs, Passage::Stairs));
  EXPECT_FALSE(house.route(from, to, {.stairs = false, .lift = false}));
}

TEST(BuildingRoutes, LevelsOnStairsRiseSteadilyAndLandingsKeepTheirLevel) {
  const Building house = own_building();
  const auto route = house.route(house.room("Workshop"), house.room("Quiet Room"), {.lift = false});
  ASSERT_TRUE(route);
  std::size_t on_landing = 0;
  for (std::size_t i = 1; i < route->points.size(); ++i) {
    EXPECT_GE(route->points[i].level, route->points[i - 1].level);
    on_landing += route->points[i].level == 0.5;
  }
  EXPECT_EQ(on_landing, 2u);
}

TEST(BuildingRoutes, AnEscalatorLeadsOneWayOnly) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 4, "indoor=area level=0 name=Below");
  osm.rectangle(20, 0, 0, 10, 4, "indoor=area level=1 name=Above");
  osm.node(30, 2, 2, "level=0").node(31, 8, 2, "level=1");
  osm.way(30, {30, 31}, "highway=steps level=0;1 conveying=forward");
  const Building house = osm.read();
  EXPECT_TRUE(house.route(house.room("Below"), house.room("Above")));
  EXPECT_FALSE(house.route(house.room("Above"), house.room("Below")));
}

TEST(BuildingRoutes, AStairsRoomWithoutStepsStillJoinsItsLevels) {
  Osm osm;
  osm.rectangle(10, 0, 0, 4, 6, "indoor=room room=stairs level=0;1 name=Stairs");
  const Building house = osm.read();
  EXPECT_TRUE(house.route(house.room("Stairs", 0.0), house.room("Stairs", 1.0)));
}

TEST(BuildingRoutes, CorridorsThatTouchAreOpenToEachOther) {
  Osm osm;
  osm.rectangle(10, 0, 0, 10, 3, "indoor=corridor level=0 name=East");
  osm.rectangle(20, -3, 0, 0, 10, "indoor=corridor level=0 name=North");
  const Building house = osm.read();
  EXPECT_TRUE(house.route(house.room("East"), house.room("North")));
}

TEST(BuildingRoutes, AStepsWayTakesItsUpperEndFromWhatItMeets) {
  Osm osm;
  osm.rectangle(10, 0, 0, 3, 3, "indoor=area level=1 name=Upper");
  osm.node(30, 8, 1).node(31, 1, 1).node(32, 2, 2);
  osm.way(30, {31, 30}, "highway=steps level=0;1");
  osm.way(31, {31, 32}, "highway=footway level=1");
  const Building house = osm.read();
  ASSERT_EQ(house.connectors().size(), 1u);
  EXPECT_EQ(house.connectors()[0].path.front().level, 1.0);
  EXPECT_EQ(house.connectors()[0].path.back().level, 0.0);
}

TEST(Svg, NamesAreEscapedWhereverTheyAppear) {
  Osm osm;
  osm.rectangle(10, 0, 0, 20, 20, "indoor=room level=0 name=&lt;script&gt;&amp;&quot;");
  const Track track{"<b>\"me\"\x01", {{0, 1, 1, 0}, {10, 2, 2, 0}}, "", ""};
  const std::string svg = floor_plan_svg(osm.read(), {&track, 1}, {.title = "a<b"});
  EXPECT_EQ(svg.find("<script"), std::string::npos);
  EXPECT_EQ(svg.find("<b>"), std::string::npos);
  EXPECT_EQ(svg.find('\x01'), std::string::npos);
  EXPECT_NE(svg.find("&lt;b&gt;&quot;me&quot;"), std::string::npos);
}

TEST(Svg, EachLevelHasItsPanelAndTitleAndDescriptionAreThere) {
  const std::string svg = floor_plan_svg(own_building(), {});
  EXPECT_NE(svg.find("aria-label=\"Ground Floor\""), std::string::npos);
  EXPECT_NE(svg.find("aria-label=\"First Floor\""), std::string::npos);
  EXPECT_NE(svg.find("<title id=\"title\">Blautal House</title>"), std::string::npos);
  EXPECT_NE(svg.find("2 levels. No tracks.</desc>"), std::string::npos);
}

TEST(Svg, TracksDifferInDashAsWellAsInColour) {
  const std::vector<Track> tracks = {{"truth", {{0, 1, 1, 0}, {10, 2, 2, 0}}, "", ""},
                                     {"estimate", {{0, 1, 2, 0}, {10, 2, 3, 0}}, "", ""}};
  const std::string svg = track_svg(tracks);
  EXPECT_NE(svg.find("#0072b2\" stroke-width=\"2\" stroke-dasharray=\"none\""), std::string::npos);
  EXPECT_NE(svg.find("#d55e00\" stroke-width=\"2\" stroke-dasharray=\"8 4\""), std::string::npos);
}

TEST(Svg, AColourFromOutsideCannotBecomeMarkup) {
  const Track track{"evil", {{0, 1, 1, 0}}, "red\"/><script>", ""};
  try {
    track_svg({&track, 1});
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Usage);
    EXPECT_NE(std::string(error.what()).find("the track evil cannot be drawn"), std::string::npos);
  }
}

TEST(Svg, AFileThatCannotBeWrittenIsNamed) {
  try {
    write_track_svg("no/such/directory/track.svg", {});
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("cannot write the drawing no/such/directory/track.svg"),
              std::string::npos);
  }
}

class RealFiles : public testing::Test {
 protected:
  std::filesystem::path folder_{};

  void SetUp() override {
    const char* data = std::getenv("FIONA_DATA");
    folder_ = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "osm_indoor";
    if (!std::filesystem::exists(folder_)) GTEST_SKIP() << "no map at " << folder_ << ": set FIONA_DATA";
  }

  /// The files are kept compressed; the reader takes plain .osm.
  Building read(const std::string& name, const std::string& unpack) const {
    const std::filesystem::path packed = folder_ / name;
    const tests::TemporaryDirectory unpacked;
    const std::filesystem::path plain = unpacked.path / "station.osm";
    const std::string command = unpack + " -dc '" + packed.string() + "' > '" + plain.string() + "'";
    if (std::system(command.c_str()) != 0) throw std::runtime_error("cannot unpack " + packed.string());
    return Building::read(plain);
  }
};

TEST_F(RealFiles, DarmstadtStationHasItsLevelsStairsAndLifts) {
  const Building station = read("da_hbf.osm.xz", "xz");
  const auto count = [&](ConnectorKind kind) {
    return std::count_if(station.connectors().begin(), station.connectors().end(),
                         [&](const Connector& c) { return c.kind == kind; });
  };
  EXPECT_EQ(station.levels().front().level, -1.0);
  EXPECT_EQ(station.levels().back().level, 1.0);
  EXPECT_GE(count(ConnectorKind::Lift), 5);
  EXPECT_GE(count(ConnectorKind::Stairs), 20);
  EXPECT_EQ(station.room("REWE").level, 0.0);
}

TEST_F(RealFiles, DarmstadtPassageIsLeftByLiftWhereStairsAreClosed) {
  const Building station = read("da_hbf.osm.xz", "xz");
  const auto lift = std::find_if(station.connectors().begin(), station.connectors().end(), [](const Connector& c) {
    return c.id == ElementId{'n', 2472210873};
  });
  ASSERT_NE(lift, station.connectors().end());
  const auto route = station.route(lift->path.front(), lift->path.back(), {.stairs = false});
  ASSERT_TRUE(route);
  EXPECT_TRUE(uses(*route, Passage::Lift));
}

TEST_F(RealFiles, MoorgateTellsWhatItLeftOut) {
  const Building station = read("moorgate.osm.xz", "xz");
  EXPECT_EQ(std::count(station.warnings().begin(), station.warnings().end(),
                       "node 1141415207: level=0,1 is not a list of levels such as 0, -1;0 or 1-3; left out"),
            1);
  EXPECT_GE(station.connectors().size(), 20u);
}

/// Places to go from and to: the ends of stairs and lifts, about 24 of them throughout the station.
std::vector<PathPoint> landings(const Building& station) {
  std::vector<PathPoint> places;
  for (const Connector& connector : station.connectors()) {
    places.push_back(connector.path.front());
    places.push_back(connector.path.back());
  }
  std::vector<PathPoint> some;
  for (std::size_t i = 0; i < 24; ++i) some.push_back(places[i * places.size() / 24]);
  return some;
}

/// Routes between all landings of different levels: how many there are, and how many break `rule`.
template <class Rule>
std::pair<int, int> routes_between_levels(const Building& station, const RouteOptions& options, Rule breaks) {
  int found = 0, broken = 0;
  const auto places = landings(station);
  for (const PathPoint& from : places) {
    for (const PathPoint& to : places) {
      if (from.level == to.level) continue;
      const auto route = station.route(from, to, options);
      if (!route) continue;
      ++found;
      broken += std::any_of(route->points.begin(), route->points.end(), breaks);
    }
  }
  return {found, broken};
}

constexpr auto kNothing = [](const RoutePoint&) { return false; };

/// With all allowed; without stairs; without lifts; indoors only.
void expect_profiles_to_hold(const Building& station, int least, int by_lift, int by_stairs, int indoors) {
  EXPECT_GE(routes_between_levels(station, {}, kNothing).first, least);
  const auto lift = routes_between_levels(station, {.stairs = false}, [](const RoutePoint& p) {
    return p.passage == Passage::Stairs || p.passage == Passage::Escalator;
  });
  EXPECT_GE(lift.first, by_lift);
  EXPECT_EQ(lift.second, 0);
  const auto stairs =
      routes_between_levels(station, {.lift = false}, [](const RoutePoint& p) { return p.passage == Passage::Lift; });
  EXPECT_GE(stairs.first, by_stairs);
  EXPECT_EQ(stairs.second, 0);
  const auto inside =
      routes_between_levels(station, {.outdoors = false}, [](const RoutePoint& p) { return p.outdoors; });
  EXPECT_GE(inside.first, indoors);
  EXPECT_EQ(inside.second, 0);
}

TEST_F(RealFiles, DarmstadtHasRoutesBetweenItsLevelsForEachProfile) {
  expect_profiles_to_hold(read("da_hbf.osm.xz", "xz"), 306, 16, 246, 306);
}

TEST_F(RealFiles, DarmstadtAsPbfHasThemToo) {
  expect_profiles_to_hold(Building::read(folder_ / "da_hbf_2.osm.pbf"), 368, 16, 330, 312);
}

TEST_F(RealFiles, MoorgateHasRoutesBetweenItsLevelsForEachProfile) {
  expect_profiles_to_hold(read("moorgate.osm.xz", "xz"), 106, 76, 80, 44);
}

TEST_F(RealFiles, TheLondonCorridorHasRoutesBetweenItsLevelsForEachProfile) {
  expect_profiles_to_hold(read("london-corridor.osm.xz", "xz"), 208, 208, 120, 24);
}

/// The map has no stairs, and nothing from its lifts to the platforms.
TEST_F(RealFiles, CologneHasRoutesBetweenItsLevelsByLiftAlone) {
  const Building station = read("kde-cologne-central.osm.gz", "gzip");
  std::vector<std::pair<double, double>> joined;
  for (const Connector& lift : station.connectors()) {
    const PathPoint low = lift.path.front(), high = lift.path.back();
    joined.push_back({low.level, high.level});
    for (const auto& [from, to] : {std::pair(low, high), std::pair(high, low)}) {
      const auto route = station.route(from, to, {.stairs = false, .outdoors = false});
      ASSERT_TRUE(route) << text(lift.id);
      EXPECT_TRUE(uses(*route, Passage::Lift)) << text(lift.id);
      EXPECT_FALSE(station.route(from, to, {.lift = false})) << text(lift.id);
    }
  }
  std::sort(joined.begin(), joined.end());
  EXPECT_EQ(joined, (std::vector<std::pair<double, double>>{{-2, 0}, {-2, 0}, {-1, 0}}));
}

TEST_F(RealFiles, CologneTellsOfEachLiftThatItLeavesOut) {
  const Building station = read("kde-cologne-central.osm.gz", "gzip");
  for (const std::string node : {"2393836723", "3094360229", "3309389973"}) {
    EXPECT_EQ(std::count(station.warnings().begin(), station.warnings().end(),
                         "node " + node + ": the lift joins no two levels; left out"),
              1)
        << node;
  }
}

TEST_F(RealFiles, PlatformsAloneAreNoBuildingAndTheErrorSaysSo) {
  try {
    read("kde-hamburg-central.osm.gz", "gzip");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("has no room, stairs or way with a level"), std::string::npos);
  }
}

}  // namespace
}  // namespace fiona::building
