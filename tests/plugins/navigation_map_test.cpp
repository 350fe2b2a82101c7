// The navigation component and the building's map, which may change.
#include <algorithm>
#include <cmath>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "led_person.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using world::destination;
using world::Led;
using world::location;
using namespace std::chrono_literals;

/// A hall with room A and, east of it, room C, which has a door in the west, on the shorter way, and one in the east.
building::Osm two_doors(const std::string& west, const std::string& east = "door=hinged level=0") {
  building::Osm osm;
  osm.node(5, 5, 3, "door=hinged level=0").node(6, 12, 3, west).node(8, 28, 3, east);
  osm.node(10, 0, 0).node(11, 30, 0).node(12, 30, 3).node(13, 0, 3);
  osm.way(10, {10, 11, 12, 8, 6, 5, 13, 10}, "indoor=room level=0 name=Hall");
  osm.rectangle(20, 0, 3, 10, 8, "indoor=room level=0 name=A", {5});
  osm.rectangle(30, 10, 3, 30, 8, "indoor=room level=0 name=C", {6, 8});
  return osm;
}
constexpr const char* kOpenDoor = "door=hinged level=0";
constexpr const char* kLockedDoor = "door=hinged level=0 access=private";
constexpr const char* kNoDoor = "";

bool leads_by(const navigation::CommPath& path, double x, double y) {
  return std::any_of(path.waypoints().begin(), path.waypoints().end(),
                     [&](const auto& place) { return std::hypot(place.x() - x, place.y() - y) < 1.0; });
}

/// On the way along the hall to room C.
struct LedToC : Led {
  LedToC() : Led(two_doors(kOpenDoor)) {
    stand(location(6, 1.5, 0, 90));
    go_to(destination(25, 6, 0));
    stand(location(6, 1.5, 0, 90), 2s);
    EXPECT_TRUE(leads_by(last_path(), 12, 3));
    EXPECT_GT(last().number(), 0u);
  }
};

TEST(Navigation, WhoIsLedToADoorThatIsClosedMeanwhileIsLedByAnotherOne) {
  for (const char* closed : {kLockedDoor, kNoDoor}) {
    LedToC led;
    led.rebuild(two_doors(closed));
    led.stand(location(6, 1.5, 0, 90));
    const auto paths = led.paths();
    ASSERT_EQ(paths.size(), 1u) << closed;
    EXPECT_TRUE(paths[0].is_valid());
    EXPECT_FALSE(leads_by(paths[0], 12, 3)) << closed;
    EXPECT_TRUE(leads_by(paths[0], 28, 3)) << closed;
    const auto said = led.said();
    ASSERT_FALSE(said.empty());
    EXPECT_EQ(said.back().text(), "Go straight on for 22 m.") << closed;
  }
}

TEST(Navigation, WhomAClosedDoorLeavesNoWayIsToldSo) {
  LedToC led;
  led.rebuild(two_doors(kNoDoor, kLockedDoor));
  led.stand(location(6, 1.5, 0, 90));
  const Instruction last = led.last();
  EXPECT_EQ(last.kind(), Instruction::NO_PATH);
  EXPECT_EQ(last.text(), "There is no way to C that is open to you: doors on it need another right.");
  EXPECT_FALSE(led.last_path().is_valid());
  led.rebuild(two_doors(kOpenDoor));
  led.stand(location(6, 1.5, 0, 90));
  EXPECT_TRUE(led.last_path().is_valid()) << "the door is open again";
}

TEST(Navigation, AMapOfTheSameVersionIsNotAskedForAgain) {
  LedToC led;
  led.bench.take_any("levels");
  led.tell_of_change(led.map.version());
  led.stand(location(6, 1.5, 0, 90));
  EXPECT_THAT(led.bench.take_any("levels"), ::testing::IsEmpty());
}

/// A rewire asks the next provider what the first one was asked: that of then, while another map is led by.
TEST(Navigation, WhoServesNextTellsItsVersionWhateverIsKnown) {
  LedToC led;
  const auto activations = led.bench.take_any("map_change");
  ASSERT_FALSE(activations.empty());
  const auto& asked = static_cast<const navigation::LevelMapVersion&>(*activations.back().object);
  EXPECT_EQ(asked.version(), 0u);
  EXPECT_NE(led.map.version(), 0u);
}

TEST(Navigation, ADestinationOnALevelThatHasVanishedIsToldSo) {
  Led led;
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0), 2s);
  led.rebuild(two_doors(kOpenDoor));
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.last().text(), "house has no level 1.");
  EXPECT_FALSE(led.last_path().is_valid());
}

TEST(Navigation, AMapWithoutLevelsIsTold) {
  Led led;
  led.map.clear_levels();
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.last().text(), "The way cannot be planned: the map of house has no levels.");
}

TEST(Navigation, AMapThatCannotBeReadIsAskedForEveryTwoSeconds) {
  LedToC led;
  navigation::CommLevelMap whole = led.map;
  led.map.clear_levels();
  led.bench.take_any("levels");
  led.tell_of_change(2);
  led.stand(location(6, 1.5, 0, 90), 7s);
  EXPECT_EQ(led.last().text(), "The way cannot be planned: the map of house has no levels.");
  EXPECT_THAT(led.bench.take_any("levels"), ::testing::SizeIs(4));
  EXPECT_EQ(std::count(led.bench.log().begin(), led.bench.log().end(), "the map of house has no levels"), 1);
  led.map = whole;
  led.stand(location(6, 1.5, 0, 90), 2s);
  EXPECT_TRUE(led.last_path().is_valid());
}

TEST(Navigation, OnceNobodyTellsOfChangesAnyMoreTheMapIsAskedForAtEachDestination) {
  LedToC led;
  led.unwire("map_change");
  led.map = world::told(two_doors(kNoDoor).read());
  led.go_to(destination(25, 6, 0));
  led.stand(location(6, 1.5, 0, 90));
  EXPECT_TRUE(leads_by(led.last_path(), 28, 3));
}

TEST(Navigation, WhoIsLostIsToldInTimeThoughTheMapIsSilent) {
  LedToC led;
  led.replace("levels");
  led.tell_of_change(2);
  led.bench.advance(1800ms);
  EXPECT_EQ(led.last().kind(), Instruction::LOST);
  EXPECT_FALSE(led.bench.take_silence("instructions"));
}

}  // namespace
}  // namespace fiona::guidance
