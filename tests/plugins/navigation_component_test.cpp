// The navigation component on the bench.
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/sink.hpp"
#include "fiona/testing/bench.hpp"
#include "fiona/wire_end.hpp"
#include "navigation.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using hmi::InstructionProvider;
using hmi::NextTurn;
using localisation::CommLocation;
using localisation::LocationProvider;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

constexpr double kDegree = std::numbers::pi / 180.0;

CommLocation location(double x, double y, double level, double heading_deg = 0, double sigma_m = 0.1) {
  CommLocation told;
  told.set_is_valid(true);
  auto& position = *told.mutable_position();
  position.set_x(x);
  position.set_y(y);
  position.set_z(level);
  position.set_is_valid(true);
  const double var = sigma_m * sigma_m;
  for (double element : {var, 0.0, 0.0, 0.0, var, 0.0, 0.0, 0.0, 0.0}) position.add_confidence(element);
  auto& orientation = *told.mutable_orientation();
  orientation.set_yaw(std::fmod((720 - heading_deg) * kDegree, 2 * std::numbers::pi));
  orientation.set_is_valid(true);
  return told;
}

navigation::CommDestination destination(double x, double y, double level) {
  navigation::CommDestination wish;
  wish.mutable_destination()->set_x(x);
  wish.mutable_destination()->set_y(y);
  wish.mutable_destination()->set_z(level);
  wish.mutable_destination()->set_is_valid(true);
  return wish;
}

navigation::CommDestination of_user(navigation::CommDestination wish, const std::string& name) {
  wish.set_user_name(name);
  wish.set_session(name + std::string(16 - name.size(), '.'));
  return wish;
}

/// Takes what a required port asks for, in the place of a provider that is not as it should be.
struct Provider final : Sink {
  Outcome deliver(Parcel parcel) override {
    if (on_request) on_request(*parcel.reply);
    asked.push_back(std::move(parcel));
    return Outcome::Ok;
  }
  std::function<void(ReplySink&)> on_request;
  std::vector<Parcel> asked;
};

/// Navigation in the house of the tests, with map, planner and profile on the bench.
struct Led {
  explicit Led(const building::Osm& osm = world::house()) : map(world::told(osm.read())) {
    bench.answer_with<navigation::LevelMap>("levels", [this](const auto&) { return map; });
    bench.answer_with<navigation::PlanProvider>("planner", [](const auto& request) { return world::solve(request); });
    bench.answer_with<hmi::ProfileProvider>("profile", [this](const auto& request) {
      asked = request;
      return profile;
    });
    bench.start();
    paths_at_start = paths();
    said_at_start = said();
  }
  /// Wires a required port to another provider.
  std::shared_ptr<Provider> replace(const char* port, std::function<void(ReplySink&)> on_request = {}) {
    auto provider = std::make_shared<Provider>();
    provider->on_request = std::move(on_request);
    const auto end = dynamic_cast<RequiredPort&>(*bench.hull().find_port(port)).end_for("bench");
    end->set_target(provider);
    end->set_connection(Connection::Connected, "on the bench");
    return provider;
  }
  void unwire(const char* port) {
    const auto end = dynamic_cast<RequiredPort&>(*bench.hull().find_port(port)).end_for("bench");
    end->set_target(nullptr);
    end->set_connection(Connection::Unwired, "on the bench");
  }
  /// From now on the building is as this file says, and who watches it is told.
  void rebuild(const building::Osm& osm) {
    const std::uint64_t version = map.version() + 1;
    map = world::told(osm.read());
    map.set_version(version);
    tell_of_change(version);
  }
  void tell_of_change(std::uint64_t version) {
    navigation::LevelMapVersion changed;
    changed.set_version(version);
    ASSERT_GT(bench.fire<navigation::LevelMapChange>("change", changed), 0u) << "nobody watches the map";
  }
  void stand(const CommLocation& at, Duration time = 600ms) {
    for (Duration passed{}; passed < time; passed += 200ms) {
      bench.put<LocationProvider>("location", at);
      bench.advance(200ms);
    }
  }
  void go_to(const navigation::CommDestination& wish) {
    bench.put<navigation::DestinationProvider>("destination", wish);
  }
  std::vector<Instruction> said() {
    std::vector<Instruction> all;
    for (const auto& one : bench.take<InstructionProvider>("instructions")) all.push_back(*one);
    return all;
  }
  Instruction last() {
    const auto all = said();
    return all.empty() ? Instruction{} : all.back();
  }
  std::vector<navigation::CommPath> paths() {
    std::vector<navigation::CommPath> all;
    for (const auto& one : bench.take<navigation::PathProvider>("path")) all.push_back(*one);
    return all;
  }
  navigation::CommPath last_path() {
    const auto all = paths();
    return all.empty() ? navigation::CommPath{} : all.back();
  }

  testing::Bench<Navigation> bench{"nav"};
  std::vector<navigation::CommPath> paths_at_start;
  std::vector<Instruction> said_at_start;
  navigation::CommLevelMap map;
  hmi::CommUserProfileReply profile;
  hmi::CommUserProfileRequest asked;
};

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

TEST(Navigation, TheProfileOfTheSessionIsAskedForAndObeyed) {
  Led led;
  led.profile.set_use_stairs(false);
  led.stand(location(5, 6, 0));
  auto wish = destination(25, 6, 1);
  wish.set_user_name("ada");
  wish.set_session("0123456789abcdef");
  led.go_to(wish);
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.asked.user_name(), "ada");
  EXPECT_EQ(led.asked.session(), "0123456789abcdef");
  bool by_lift = false;
  const auto paths = led.paths();
  ASSERT_EQ(paths.size(), 1u);
  for (const auto& place : paths[0].waypoints()) by_lift = by_lift || std::abs(place.x() - 28) < 0.1;
  EXPECT_TRUE(by_lift);
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

TEST(Navigation, AMapWithoutLevelsIsTold) {
  Led led;
  led.map.clear_levels();
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0));
  EXPECT_EQ(led.last().text(), "The way cannot be planned: the map of house has no levels.");
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

TEST(Navigation, APointOfAttentionStandsBesideTheInstruction) {
  Led led;
  led.profile.add_landmark_list("5,6,0 statue");
  led.profile.add_landmark_list("5,6,1 fountain");
  led.profile.add_landmark_list("nonsense");
  led.stand(location(5, 6, 0));
  led.go_to(destination(25, 6, 1));
  led.stand(location(5, 6, 0), 1s);
  std::vector<std::string> told;
  for (const auto& one : led.said()) {
    if (one.kind() == Instruction::ATTENTION) told.push_back(one.text());
  }
  EXPECT_THAT(told, ::testing::ElementsAre("You are passing statue."));
  EXPECT_THAT(led.bench.log(), ::testing::Contains(HasSubstr("nonsense")));
}

/// Ada has been led to where she wanted to go, in room A; a statue stands in the hall.
struct Arrived : Led {
  Arrived() {
    profile.add_landmark_list("5,1.5,0 statue");
    stand(location(5, 6, 0));
    go_to(of_user(destination(8, 6, 0), "ada"));
    stand(location(5, 6, 0));
    stand(location(7.2, 6, 0), 3s);
    EXPECT_EQ(last().kind(), Instruction::ARRIVE);
  }
  void log_out() {
    replace("profile", [](ReplySink& client) {
      auto ended = std::make_shared<hmi::CommUserProfileReply>();
      ended->set_session_ended(true);
      client.answer(Outcome::Ok, {}, ended);
    });
    stand(location(7.2, 6, 0), 6s);
  }
  /// What they are told of when they walk along the hall.
  std::vector<std::string> told_in_the_hall() {
    said();
    stand(location(5, 1.5, 0), 1s);
    std::vector<std::string> told;
    for (const auto& one : said()) {
      if (one.kind() == Instruction::ATTENTION) told.push_back(one.text());
    }
    return told;
  }
};

TEST(Navigation, WhoHasArrivedIsToldOfTheirPointsAsBefore) {
  EXPECT_THAT(Arrived().told_in_the_hall(), ::testing::ElementsAre("You are passing statue."));
}

TEST(Navigation, APointThatTheUserAddsAfterArrivalIsTold) {
  Arrived led;
  led.profile.add_landmark_list("5,2,0 bench");
  led.stand(location(7.2, 6, 0), 6s);
  EXPECT_THAT(led.told_in_the_hall(), ::testing::Contains("You are passing bench."));
}

TEST(Navigation, WhoHasLoggedOutIsToldOfNoPoint) {
  Arrived led;
  led.log_out();
  EXPECT_THAT(led.told_in_the_hall(), ::testing::IsEmpty());
}

TEST(Navigation, WhoLogsOutOnTheWayIsToldSoAndOfNoPoint) {
  Arrived led;
  led.go_to(of_user(destination(25, 6, 0), "ada"));
  led.stand(location(7.2, 6, 0));
  led.log_out();
  const Instruction last = led.last();
  EXPECT_EQ(last.kind(), Instruction::NO_PATH);
  EXPECT_EQ(last.text(), "You are not led any more: you have been logged out. Log in again, or go on as a guest.");
  EXPECT_FALSE(led.last_path().is_valid());
  EXPECT_THAT(led.told_in_the_hall(), ::testing::IsEmpty());
}

TEST(Navigation, WhoseSessionCannotBeCheckedIsLedOnForAsLongAsThatLasts) {
  Arrived led;
  led.go_to(of_user(destination(25, 6, 0), "ada"));
  led.stand(location(7.2, 6, 0));
  const auto profiles = led.replace("profile", [](ReplySink& client) {
    client.answer(Outcome::Rejected, "the session could not be checked: disconnected", nullptr);
  });
  led.stand(location(7.2, 6, 0), 20s);
  EXPECT_GT(profiles->asked.size(), 3u);
  EXPECT_NE(led.last().kind(), Instruction::NO_PATH);
  EXPECT_TRUE(led.last_path().is_valid());
  EXPECT_THAT(led.told_in_the_hall(), ::testing::ElementsAre("You are passing statue."));
}

TEST(Navigation, WhoseSessionCouldNotBeCheckedAtFirstIsLedOnceItIs) {
  Led led;
  led.replace("profile", [](ReplySink& client) {
    client.answer(Outcome::Rejected, "the session could not be checked: timeout", nullptr);
  });
  led.stand(location(5, 6, 0));
  led.go_to(of_user(destination(25, 6, 0), "ada"));
  led.stand(location(5, 6, 0), 5s);
  EXPECT_EQ(led.last().text(), "Your profile cannot be had: the session could not be checked: timeout.");
  led.replace("profile",
              [](ReplySink& client) { client.answer(Outcome::Ok, {}, std::make_shared<hmi::CommUserProfileReply>()); });
  led.stand(location(5, 6, 0), 3s);
  EXPECT_TRUE(led.last_path().is_valid());
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

TEST(Navigation, ThePointsOfOneUserAreNotToldToTheNext) {
  Arrived led;
  led.profile.clear_landmark_list();
  led.go_to(of_user(destination(8, 6, 0), "bob"));
  led.stand(location(7.2, 6, 0));
  EXPECT_THAT(led.told_in_the_hall(), ::testing::IsEmpty());
}

TEST(Navigation, WhoseProfileCannotBeHadForAWhileIsToldOfTheirPointsAsBefore) {
  Arrived led;
  led.unwire("profile");
  led.stand(location(7.2, 6, 0), 6s);
  EXPECT_THAT(led.told_in_the_hall(), ::testing::ElementsAre("You are passing statue."));
}

TEST(Navigation, WhoCannotBeLedIsToldOfTheirPointsAllTheSame) {
  Led led;
  led.profile.add_landmark_list("5,6,0 statue");
  led.stand(location(5, 6, 0));
  led.go_to(of_user(destination(500, 6, 1), "ada"));
  led.stand(location(5, 6, 0), 1s);
  std::vector<int> kinds;
  for (const auto& one : led.said()) kinds.push_back(one.kind());
  EXPECT_THAT(kinds, ::testing::IsSupersetOf({int{Instruction::NO_PATH}, int{Instruction::ATTENTION}}));
}

TEST(Navigation, AfterAPointOfAttentionTheInstructionThatHoldsComesAgainUnderItsOwnNumber) {
  Arrived led;
  led.stand(location(5, 1.5, 0), 1s);
  const auto told = led.said();
  ASSERT_GE(told.size(), 2u);
  EXPECT_EQ(told.front().kind(), Instruction::ATTENTION);
  EXPECT_EQ(told.back().kind(), Instruction::ARRIVE);
  EXPECT_LT(told.back().number(), told.front().number());
}

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
  const auto activations = led.bench.take_any("change");
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
  led.unwire("change");
  led.map = world::told(two_doors(kNoDoor).read());
  led.go_to(destination(25, 6, 0));
  led.stand(location(6, 1.5, 0, 90));
  EXPECT_TRUE(leads_by(led.last_path(), 28, 3));
}

// ---- without a word

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

TEST(Navigation, WhoAsksAgainIsAnsweredAgain) {
  Led led;
  led.stand(location(5, 6, 0));
  std::vector<std::uint32_t> numbers;
  for (int i = 0; i < 2; ++i) {
    led.go_to(destination(15, 6, 0));
    led.stand(location(5, 6, 0));
    for (const auto& one : led.said()) numbers.push_back(one.number());
  }
  EXPECT_THAT(numbers, ::testing::ElementsAre(1u, 2u));
}

TEST(Navigation, WhoIsLostIsToldInTimeThoughTheMapIsSilent) {
  LedToC led;
  led.replace("levels");
  led.tell_of_change(2);
  led.bench.advance(1800ms);
  EXPECT_EQ(led.last().kind(), Instruction::LOST);
  EXPECT_FALSE(led.bench.take_silence("instructions"));
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
