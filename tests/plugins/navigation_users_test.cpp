// Who is led by the navigation component: profile, session and points of attention.
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "led_person.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance {
namespace {

using hmi::Instruction;
using ::testing::HasSubstr;
using world::destination;
using world::Led;
using world::location;
using world::of_user;
using namespace std::chrono_literals;

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

}  // namespace
}  // namespace fiona::guidance
