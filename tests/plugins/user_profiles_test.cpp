// What users can and want on the way: given to who carries the session, kept, and refused to everyone else.
#include "user_profiles.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include "../temporary_directory.hpp"
#include "fiona/testing/bench.hpp"

namespace fiona::user_profiles {
namespace {

using namespace std::chrono_literals;
using hmi::CommUserProfileReply;
using hmi::CommUserProfileRequest;
using hmi::CommUserProfileUpdate;
using hmi::RequestPointsOfAttention;
using testing::Bench;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const std::string kSession(16, 's');

class UserProfilesTest : public ::testing::Test {
 protected:
  UserProfilesTest() { begin(); }
  void begin() {
    bench_.reset();
    bench_ = std::make_unique<Bench<UserProfiles>>("profiles");
    bench_->set("database", (folder_.path / "profiles.db").string());
    bench_->answer_with<security::SessionProvider>("sessions", [](const security::CommSessionRequest& request) {
      security::CommSession session;
      if (request.session() != kSession) return session;
      session.set_is_valid(true);
      session.set_user_name("anna");
      session.set_authentication_level(4);
      return session;
    });
    bench_->answer_with<navigation::LevelMap>("levels", [this](const navigation::CommLevelMapRequest& request) {
      EXPECT_EQ(request.user_name() + request.session(), "") << "who asks the map is the guest";
      ++maps_asked_;
      navigation::CommLevelMap map;
      for (const double level : {0.0, 1.5}) {
        navigation::MapLevel& one = *map.add_levels();
        one.set_level(level);
        one.set_map_name(level == 0 ? "house@0" : "house@1.5");
      }
      for (const double west : {-10.0, 0.0}) {
        navigation::MapRing& outline = *map.add_rooms()->mutable_outline();
        for (const double x : {west, west + 10.0}) outline.add_x(x);
        for (const double y : {-8.0, 8.0}) outline.add_y(y);
      }
      return map;
    });
    bench_->start();
  }

  Result<std::shared_ptr<const CommUserProfileReply>> ask(const std::string& user, const std::string& session) {
    CommUserProfileRequest request;
    request.set_user_name(user);
    request.set_session(session);
    return bench_->ask<hmi::ProfileProvider>("profile", request);
  }
  static RequestPointsOfAttention points(std::initializer_list<std::optional<double>> levels) {
    RequestPointsOfAttention request;
    request.set_user_name("anna");
    request.set_session(kSession);
    double x = 1.25;
    for (const auto& level : levels) {
      hmi::PointOfAttention& point = *request.add_points_of_attention();
      point.set_x(x++);
      point.set_y(-3);
      if (level) point.set_level(*level);
      point.set_name("lift");
    }
    return request;
  }

  tests::TemporaryDirectory folder_;
  std::unique_ptr<Bench<UserProfiles>> bench_;
  int maps_asked_ = 0;
};

TEST_F(UserProfilesTest, TheGuestHasLevel0AndNoPreferences) {
  const auto reply = ask("", "");
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_EQ((*reply)->authentication_level(), 0);
  EXPECT_FALSE((*reply)->has_use_stairs());
  EXPECT_THAT((*reply)->map_list(), ElementsAre("house@0", "house@1.5"));
}

TEST_F(UserProfilesTest, TheSessionsUserGetsTheProfileWithTheSessionsLevel) {
  const auto reply = ask("anna", kSession);
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_EQ((*reply)->authentication_level(), 4);
}

TEST_F(UserProfilesTest, ANameWithoutItsSessionIsRejected) {
  EXPECT_THAT(ask("anna", "").reason(), HasSubstr("the request names a user and carries no session"));
  EXPECT_THAT(ask("bert", kSession).reason(), HasSubstr("the session is another user's"));
  EXPECT_THAT(ask("", kSession).reason(), HasSubstr("the session is another user's"));
  for (const auto& outcome : {ask("bert", kSession).outcome(), ask("anna", "").outcome()}) {
    EXPECT_EQ(outcome, Outcome::Rejected);
  }
}

TEST_F(UserProfilesTest, WhoseSessionHasEndedIsToldSoAndNothingElse) {
  const auto answer = ask("anna", std::string(16, 'x'));
  ASSERT_EQ(answer.outcome(), Outcome::Ok);
  CommUserProfileReply ended;
  ended.set_session_ended(true);
  EXPECT_EQ((*answer)->SerializeAsString(), ended.SerializeAsString());
}

TEST_F(UserProfilesTest, WhoseSessionHasEndedChangesNothingAndIsToldSo) {
  CommUserProfileUpdate update;
  update.set_user_name("anna");
  update.set_session(std::string(16, 'x'));
  update.set_use_stairs(false);
  const auto answer = bench_->ask<hmi::ProfileUpdate>("update", update);
  ASSERT_EQ(answer.outcome(), Outcome::Ok) << answer.reason();
  CommUserProfileReply ended;
  ended.set_session_ended(true);
  EXPECT_EQ((*answer)->SerializeAsString(), ended.SerializeAsString());
  EXPECT_FALSE((*ask("anna", kSession))->has_use_stairs());
  auto request = points({0.0});
  request.set_session(std::string(16, 'x'));
  EXPECT_THAT(bench_->ask<hmi::PointsOfAttention>("points", request).reason(), HasSubstr("or it has ended"));
}

TEST_F(UserProfilesTest, WithoutAProviderOfSessionsNobodyIsBelieved) {
  Bench<UserProfiles> alone("profiles");
  alone.set("database", (folder_.path / "alone.db").string());
  alone.start();
  CommUserProfileRequest request;
  request.set_user_name("anna");
  request.set_session(kSession);
  EXPECT_THAT(alone.ask<hmi::ProfileProvider>("profile", request).reason(),
              HasSubstr("the session could not be checked: timeout"));
  EXPECT_TRUE(alone.ask<hmi::ProfileProvider>("profile", {}).ok());
}

TEST_F(UserProfilesTest, PreferencesAreKeptAndCanBeTakenBack) {
  CommUserProfileUpdate update;
  update.set_user_name("anna");
  update.set_session(kSession);
  update.set_use_stairs(false);
  update.set_use_elevator(true);
  ASSERT_TRUE(bench_->ask<hmi::ProfileUpdate>("update", update).ok());
  begin();
  auto reply = ask("anna", kSession);
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_TRUE((*reply)->has_use_stairs());
  EXPECT_FALSE((*reply)->use_stairs());
  EXPECT_TRUE((*reply)->use_elevator());
  EXPECT_FALSE((*reply)->has_use_outdoor_navigation());

  update.clear_use_stairs();
  const auto after = bench_->ask<hmi::ProfileUpdate>("update", update);
  ASSERT_TRUE(after.ok());
  EXPECT_FALSE((*after)->has_use_stairs()) << "it was said, and taken back";
}

TEST_F(UserProfilesTest, AGuestSetsNothing) {
  EXPECT_THAT(bench_->ask<hmi::ProfileUpdate>("update", {}).reason(),
              HasSubstr("a guest has no profile that could be kept"));
  EXPECT_THAT(bench_->ask<hmi::PointsOfAttention>("points", {}).reason(),
              HasSubstr("a guest has no points of attention that could be kept"));
}

TEST_F(UserProfilesTest, PointsReplaceThoseOfBeforeAndAreToldWithTheirLevel) {
  ASSERT_TRUE(bench_->ask<hmi::PointsOfAttention>("points", points({0.0, 0.0, 0.0})).ok());
  ASSERT_TRUE(bench_->ask<hmi::PointsOfAttention>("points", points({1.5})).ok());
  begin();
  EXPECT_THAT((*ask("anna", kSession))->landmark_list(), ElementsAre("1.25,-3,1.5 lift"));
}

TEST_F(UserProfilesTest, PointsWithoutALevelOrOnOneThatIsNotThereAreRefusedOneByOne) {
  const auto reply = bench_->ask<hmi::PointsOfAttention>("points", points({7.0, 0.0, std::nullopt}));
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_THAT((*reply)->refused(), ElementsAre(0U, 2U));
  EXPECT_THAT((*reply)->reason(), ElementsAre("the building has no level 7", "it is not said on which level it is"));
  EXPECT_THAT((*ask("anna", kSession))->landmark_list(), ElementsAre("2.25,-3,0 lift"));
}

TEST_F(UserProfilesTest, APointOffTheMapIsRefusedAndOneBeforeTheDoorIsNot) {
  RequestPointsOfAttention request = points({0.0, 0.0, 0.0, 0.0});
  request.mutable_points_of_attention(0)->set_x(31);
  request.mutable_points_of_attention(1)->set_x(-29);
  request.mutable_points_of_attention(2)->set_y(29);
  request.mutable_points_of_attention(3)->set_y(std::numeric_limits<double>::lowest());
  const auto reply = bench_->ask<hmi::PointsOfAttention>("points", request);
  ASSERT_TRUE(reply.ok()) << reply.reason();
  EXPECT_THAT((*reply)->refused(), ElementsAre(0U, 2U, 3U));
  EXPECT_EQ((*reply)->reason(0), "it is more than 20 m away from the building");
  EXPECT_THAT((*ask("anna", kSession))->landmark_list(), ElementsAre("-29,-3,0 lift"));
}

TEST_F(UserProfilesTest, TheMapIsNotAskedForEachProfile) {
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(ask("", "").ok());
  EXPECT_EQ(maps_asked_, 1);
  bench_->advance(11s);
  EXPECT_TRUE(ask("", "").ok());
  EXPECT_EQ(maps_asked_, 2);
}

TEST_F(UserProfilesTest, ADamagedDatabaseFailsTheInstanceAndSaysWhatToDo) {
  bench_.reset();
  std::ofstream(folder_.path / "profiles.db", std::ios::trunc) << "not a database";
  Bench<UserProfiles> bench("profiles");
  bench.set("database", (folder_.path / "profiles.db").string());
  EXPECT_THROW(bench.start(), Error);
  EXPECT_THAT(bench.reason(), HasSubstr("the database is damaged: file is not a database"));
}

}  // namespace
}  // namespace fiona::user_profiles
