// That whoever judges what people are told finds what must not be.
#include <numbers>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "announcements.hpp"
#include "measured_path.hpp"
#include "navigation_world.hpp"
#include "word_check.hpp"

namespace fiona::walks {
namespace {

using building::Building;
using hmi::Instruction;
using hmi::NextTurn;

/// A corridor from west to east, 3 m wide, with a locked room in the middle of its north side.
const Building& corridor() {
  static const Building kCorridor = guidance::world::house().read();
  return kCorridor;
}

navigation::CommPath path_of(const std::vector<building::PathPoint>& places) {
  navigation::CommPath path;
  path.set_is_valid(true);
  for (const building::PathPoint& place : places) {
    auto& way_point = *path.add_waypoints();
    way_point.set_x(place.at.x_m), way_point.set_y(place.at.y_m), way_point.set_z(place.level);
  }
  return path;
}

navigation::CommPath along() { return path_of({{{5, 1}, 0}, {{25, 1}, 0}}); }
navigation::CommPath into_the_locked_room() {
  return path_of({{{10, 1}, 0}, {{15, 1}, 0}, {{15, 2.5}, 0}, {{15, 3}, 0}, {{15, 3.5}, 0}, {{15, 6}, 0}});
}

Instruction told(Instruction::Kind kind, double distance_m, NextTurn::TypeOfTurn hour = NextTurn::HOUR_12) {
  Instruction said;
  said.set_kind(kind), said.set_distance(distance_m), said.set_hour(hour), said.set_level(0.0);
  return said;
}

/// To one who is 5 m along the path and looks east.
std::string fault_of(const Instruction& said, const navigation::CommPath& path, building::RouteOptions profile) {
  const MeasuredPath measured(corridor(), path);
  const Believed walker{measured.place(5.0), std::numbers::pi / 2.0, 0.0};
  return WordCheck(corridor(), profile).fault_of(said, walker, measured, 5.0);
}

TEST(WordCheck, AWordThatLeadsIntoAWallIsAFault) {
  EXPECT_EQ(fault_of(told(Instruction::CONTINUE, 15.0), along(), {}), "");
  EXPECT_EQ(fault_of(told(Instruction::CONTINUE, 15.0, NextTurn::HOUR_3), along(), {}), "into a wall");
  EXPECT_EQ(fault_of(told(Instruction::START, 0.0, NextTurn::HOUR_4), along(), {}), "into a wall");
  EXPECT_EQ(fault_of(told(Instruction::TURN, 6.0, NextTurn::HOUR_3), along(), {}), "into a wall");
}

TEST(WordCheck, AWordAlongAPathBehindAWallIsAFault) {
  const MeasuredPath path(corridor(), along());
  const Believed in_the_room{{{10.5, 4.0}, 0.0}, std::numbers::pi / 2.0, 0.0};
  const WordCheck check(corridor(), {});
  EXPECT_EQ(check.fault_of(told(Instruction::CONTINUE, 15.0), in_the_room, path, 5.0), "along a path behind a wall");
}

TEST(WordCheck, AWordThroughALockedDoorIsAFault) {
  const Instruction through = told(Instruction::DOOR, 1.5, NextTurn::HOUR_9);
  EXPECT_EQ(fault_of(through, into_the_locked_room(), {.access = 9}), "");
  EXPECT_EQ(fault_of(through, into_the_locked_room(), {.access = 0}).substr(0, 29), "through a door that is locked");
}

TEST(WordCheck, AWordThroughADoorThatIsNotOnThePathIsAFault) {
  EXPECT_EQ(fault_of(told(Instruction::DOOR, 6.0), along(), {}), "through a door where there is none");
}

TEST(WordCheck, WhatTheProfileLeavesOutIsAFault) {
  EXPECT_EQ(fault_of(told(Instruction::STAIRS, 2.0), along(), {.stairs = false}), "stairs");
  EXPECT_EQ(fault_of(told(Instruction::LIFT, 2.0), along(), {.lift = false}), "the lift");
  EXPECT_EQ(fault_of(told(Instruction::LEAVE, 2.0), along(), {.outdoors = false}), "out of the building");
  EXPECT_EQ(fault_of(told(Instruction::STAIRS, 2.0), along(), {}), "");
}

TEST(WordCheck, APathThroughALockedDoorOrAWallIsAFault) {
  const WordCheck staff(corridor(), {.access = 9}), guest(corridor(), {.access = 0});
  EXPECT_EQ(staff.fault_of(into_the_locked_room()), "");
  EXPECT_NE(guest.fault_of(into_the_locked_room()), "");
  EXPECT_EQ(guest.fault_of(along()), "");
  EXPECT_EQ(guest.fault_of(path_of({{{7, 1}, 0}, {{7, 4}, 0}})).substr(0, 21), "a path through a wall");
}

/// Of a turn after 12 m, by words that say so many metres.
std::string fault_of_words(const std::vector<double>& words_m) {
  Announcements announcements({{Mark::Kind::Turn, 12.0, 12.0}});
  announcements.walk(0.0);
  for (const double left_m : words_m) announcements.hear(told(Instruction::TURN, left_m), 12.0 - left_m, 12.0 - left_m);
  announcements.walk(12.0);
  const auto passed = announcements.take_passed();
  return passed.size() == 1 ? passed.front().fault() : "not passed";
}

TEST(Announcements, ATurnThatIsToldSixMetresBeforeAndAgainAtTwoIsToldInTime) {
  EXPECT_EQ(fault_of_words({5.9, 1.9}), "");
}

TEST(Announcements, ATurnThatIsToldLateEarlyOnceOrNeverIsAFault) {
  for (const std::vector<double>& words_m :
       {std::vector<double>{3.0, 2.0}, {9.0, 2.0}, {6.0}, {6.0, 0.4}, {6.0, 4.0}, {}}) {
    const std::string fault = fault_of_words(words_m);
    EXPECT_EQ(fault.substr(0, 6), "walked") << words_m.size();
  }
}

TEST(Announcements, WhoWasTurnedToThePathMeanwhileIsToldAsSoonAsMayBe) {
  Announcements announcements({{Mark::Kind::Turn, 12.0, 12.0}});
  announcements.walk(0.0);
  Instruction astray = told(Instruction::TURN, 0.0);
  astray.set_text("Turn left to the path.");
  announcements.hear(astray, 7.0, 7.0);
  announcements.walk(12.0);
  EXPECT_EQ(announcements.take_passed().at(0).fault(), "");
}

TEST(MeasuredPath, WhatHasToBeToldIsFoundFromThePlacesOfAPath) {
  const MeasuredPath path(corridor(), into_the_locked_room());
  ASSERT_EQ(path.marks().size(), 2U);
  EXPECT_EQ(path.marks()[0].kind, Mark::Kind::Turn);
  EXPECT_DOUBLE_EQ(path.marks()[0].at_m, 5.0);
  EXPECT_EQ(path.marks()[1].kind, Mark::Kind::Door);
  EXPECT_DOUBLE_EQ(path.marks()[1].at_m, 6.5);
  EXPECT_DOUBLE_EQ(path.marks()[1].leg_m, 1.5);
}

}  // namespace
}  // namespace fiona::walks
