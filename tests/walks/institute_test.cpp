// What the building must have that people are led through.
#include <algorithm>
#include <map>
#include <set>
#include <string>

#include <gtest/gtest.h>

#include <fiona/building/building.hpp>
#include <fiona/building/geometry.hpp>

namespace fiona::walks {
namespace {

using building::Building;
using building::ConnectorKind;
using building::Room;

const std::set<double> kFloors{0.0, 1.0, 2.0};

const Building& institute() {
  static const Building kInstitute = Building::read(FIONA_INSTITUTE_FILE);
  return kInstitute;
}

/// Rooms with a number on the door; neither stairwells nor what stands beside them.
bool is_numbered(const Room& room) {
  return room.kind == building::RoomKind::Room && !room.ref.empty() && room.ref.find('.') != std::string::npos;
}

std::set<double> floors_of_rooms(const Building& building) {
  std::set<double> floors;
  for (const Room& room : building.rooms()) {
    if (is_numbered(room)) floors.insert(room.level);
  }
  return floors;
}

/// The floors that stairs or lifts join, by name.
std::map<std::string, std::set<double>> joined_by(ConnectorKind kind) {
  std::map<std::string, std::set<double>> floors;
  for (const building::Connector& one : institute().connectors()) {
    if (one.kind == kind) floors[one.name].insert(one.levels.begin(), one.levels.end());
  }
  return floors;
}

TEST(Institute, HasFortyNumberedRoomsOnThreeFloors) {
  std::set<std::string> numbers;
  for (const Room& room : institute().rooms()) {
    if (is_numbered(room)) numbers.insert(room.ref);
  }
  EXPECT_EQ(numbers.size(), 40U);
  EXPECT_EQ(floors_of_rooms(institute()), kFloors);
}

TEST(Institute, HasAFloorMoreThanTheHouse) {
  EXPECT_EQ(floors_of_rooms(Building::read(FIONA_HOUSE_FILE)).size() + 1, floors_of_rooms(institute()).size());
}

TEST(Institute, HasTwoStairsAndALiftThatJoinAllFloors) {
  const auto stairs = joined_by(ConnectorKind::Stairs), lifts = joined_by(ConnectorKind::Lift);
  EXPECT_EQ(stairs.size(), 2U);
  for (const auto& [name, floors] : stairs) {
    for (const double floor : kFloors) EXPECT_TRUE(floors.contains(floor)) << name;
  }
  ASSERT_EQ(lifts.size(), 1U);
  EXPECT_EQ(lifts.begin()->second, kFloors);
}

TEST(Institute, CanBeLeftByOneEntranceAndEnteredByAnother) {
  std::vector<building::Door> entrances;
  for (const building::Door& door : institute().doors()) {
    if (door.entrance) entrances.push_back(door);
  }
  ASSERT_EQ(entrances.size(), 2U);
  const building::Point before = entrances[0].at, behind = entrances[1].at;
  EXPECT_EQ(entrances[0].level, 0.0);
  const auto goes_outdoors = [&](const building::Path& path) {
    const auto passes = [&](building::Point door) {
      return std::any_of(path.points.begin(), path.points.end(),
                         [&](const building::PathPoint& point) { return distance_m(point.at, door) < 0.1; });
    };
    return passes(before) && passes(behind);
  };
  EXPECT_TRUE(std::any_of(institute().plan().paths.begin(), institute().plan().paths.end(), goes_outdoors));
}

TEST(Institute, HasAtMostOneBeaconOnEightySquareMetresOfRoomsAndCorridors) {
  std::map<double, double> area_m2, beacons;
  for (const Room& room : institute().rooms()) area_m2[room.level] += building::area_m2(room.polygon);
  for (const building::Landmark& landmark : institute().landmarks()) {
    if (landmark.tags.contains("fiona:beacon")) beacons[landmark.level] += 1.0;
  }
  for (const double floor : kFloors) {
    EXPECT_GT(beacons[floor], 0.0) << floor;
    EXPECT_LE(beacons[floor], area_m2[floor] / 80.0) << floor;
  }
}

}  // namespace
}  // namespace fiona::walks
