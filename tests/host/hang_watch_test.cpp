// What counts as a hang, with a time of the test's own.
#include "hang_watch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <thread>
#include <vector>

#include "fiona/hull.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using testing::IsEmpty;

class HangWatchTest : public testing::Test {
 protected:
  std::vector<Hang> look_after(std::chrono::milliseconds time) { return watch.look(now += time, ::getpid()); }
  /// What was found in so much time, looking every 100 ms.
  std::vector<Hang> look_for(std::chrono::milliseconds time) {
    std::vector<Hang> all;
    for (const auto end = now + time; now < end;) {
      for (Hang& hang : look_after(100ms)) all.push_back(std::move(hang));
    }
    return all;
  }
  static std::optional<HangWatch::Part> parts(const std::string& instance) {
    if (instance == "planner") return HangWatch::Part{{"plan"}, 10s};
    if (instance != "steps") return std::nullopt;
    return HangWatch::Part{{"imu", "task 'ticker'"}};
  }

  const std::shared_ptr<Liveness> liveness = std::make_shared<Liveness>();
  Liveness::Place steps{liveness, "steps"};
  HangWatch watch{liveness->page(), &HangWatchTest::parts};
  HangWatch::Time now = HangWatch::Time() + 24h;
};

TEST_F(HangWatchTest, WorkThatDoesNotEndIsToldOnceWithItsPort) {
  steps.begins(Liveness::mark("imu"));
  EXPECT_THAT(look_for(900ms), IsEmpty());
  const auto hangs = look_for(2s);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_EQ(hangs[0].instance, "steps");
  EXPECT_EQ(hangs[0].in, "imu");
  EXPECT_THAT(hangs[0].text(), testing::MatchesRegex("'steps' was stuck in imu for 1\\.[0-9] s"));
}

TEST_F(HangWatchTest, OnePieceOfWorkAfterTheOtherIsNoHang) {
  for (int i = 0; i < 50; ++i) {
    steps.begins(Liveness::mark("imu"));
    EXPECT_THAT(look_for(200ms), IsEmpty());
  }
}

TEST_F(HangWatchTest, AnIdleStrandIsNoHang) {
  steps.begins(Liveness::mark("imu"));
  steps.rests();
  EXPECT_THAT(look_for(1min), IsEmpty());
}

TEST_F(HangWatchTest, TimeInWhichNobodyLookedDoesNotCount) {
  steps.begins(Liveness::mark("imu"));
  look_after(0ms);
  EXPECT_THAT(look_after(1h), IsEmpty());
}

TEST_F(HangWatchTest, WorkOfAPackageWhoseManifestSaysSoMayTakeLonger) {
  Liveness::Place planner{liveness, "planner"};
  planner.begins(Liveness::mark("plan"));
  EXPECT_THAT(look_for(9900ms), IsEmpty());
  const auto hangs = look_for(2s);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_THAT(hangs[0].text(), testing::MatchesRegex("'planner' was stuck in plan for 10\\.[0-9] s"));
}

TEST_F(HangWatchTest, ThatOnePackageMayTakeLongerIsNoExcuseForAnother) {
  Liveness::Place planner{liveness, "planner"};
  planner.begins(Liveness::mark("plan"));
  steps.begins(Liveness::mark("imu"));
  const auto hangs = look_for(2s);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_EQ(hangs[0].instance, "steps");
}

TEST_F(HangWatchTest, ACallOfTheLifeCycleMayTakeTenSeconds) {
  steps.begins(Liveness::mark(kItsStart));
  EXPECT_THAT(look_for(9s), IsEmpty());
  const auto hangs = look_for(3s);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_EQ(hangs[0].in, "its start");
}

TEST_F(HangWatchTest, AProcessThatIsStoppedIsToldSooner) {
  std::vector<Hang> hangs;
  for (int i = 0; i < 6; ++i) hangs = watch.look(now += 100ms, ::getpid(), true);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_EQ(hangs[0].text(), "it stood still for 0.8 s");
}

/// Three threads of the process share a CPU: each waits for it for two thirds of the time, all together for twice the
/// time that there is.
TEST_F(HangWatchTest, ThreadsThatWaitAtTheSameTimeAreNoLongerAnExcuseThanOneOfThem) {
  std::atomic<bool> over{false};
  const auto spin = [&over] {
    cpu_set_t first;
    CPU_ZERO(&first);
    CPU_SET(0, &first);
    ::sched_setaffinity(0, sizeof first, &first);
    while (!over) continue;
  };
  std::vector<std::jthread> threads;
  for (int i = 0; i < 3; ++i) threads.emplace_back(spin);
  steps.begins(Liveness::mark("imu"));
  std::vector<Hang> hangs;
  const auto end = std::chrono::steady_clock::now() + 60s;
  while (hangs.empty() && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(50ms);
    hangs = watch.look(std::chrono::steady_clock::now(), ::getpid());
  }
  over = true;
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_LT(hangs[0].time, HangWatch::kStarved);
}

TEST_F(HangWatchTest, WhatAnotherProcessClaimsToBeIsMadeInert) {
  Liveness::Place forged(liveness, "\x1b[31m\xff");
  forged.begins(7);
  const auto hangs = look_for(3s);
  ASSERT_EQ(hangs.size(), 1U);
  EXPECT_THAT(hangs[0].text(), testing::StartsWith("'?[31m?' was stuck for "));
}

TEST_F(HangWatchTest, ASlotIsUsedAgainAndMoreThanThereAreIsRefused) {
  std::vector<std::unique_ptr<Liveness::Place>> places;
  EXPECT_ANY_THROW(while (places.size() <= Liveness::kSlots)
                       places.push_back(std::make_unique<Liveness::Place>(liveness, "more")));
  EXPECT_EQ(places.size(), Liveness::kSlots - 1);
  places.clear();
  EXPECT_NO_THROW(Liveness::Place(liveness, "again"));
}

}  // namespace
}  // namespace fiona::host
