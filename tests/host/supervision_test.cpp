// A group whose process ends is started again, with all that it is meant to hold.
#include "supervision.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include "runtime.hpp"
#include "supervisor.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using host::Supervision;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

/// Two calls of its life cycle, on the thread that would say that the host is alive.
TEST(Supervision, OfAHostWaitsLongerThanTheEndOfAnInstanceMayTake) {
  EXPECT_GT(host::Supervisor::Options{}.hang, 2 * host::kLifeCycleDeadline);
  EXPECT_GT(host::Supervisor::kMakesWayWithin, 2 * host::kLifeCycleDeadline);
}

// ---- when -----------------------------------------------------------------------------------------------------

TEST(Supervision, EachRestartWaitsFourTimesAsLongAndTheFourthEndIsTheLast) {
  Supervision supervision;
  Supervision::Time now{};
  for (const auto pause : {100ms, 400ms, 1600ms}) {
    const auto due = supervision.ended("far", now);
    ASSERT_TRUE(due.has_value());
    EXPECT_EQ(*due - now, pause);
    EXPECT_THAT(supervision.take_due(now + pause - 1ms), IsEmpty());
    now += pause;
    EXPECT_TRUE(supervision.waits("far"));
    EXPECT_THAT(supervision.take_due(now), ElementsAre("far"));
    EXPECT_FALSE(supervision.any_waits());
  }
  EXPECT_EQ(supervision.ended("far", now), std::nullopt);
  EXPECT_THAT(supervision.take_due(now + 1h), IsEmpty());
  EXPECT_EQ(supervision.restarts("far"), 3U);
}

TEST(Supervision, KeepsHowWhatItStartedAgainHadEnded) {
  Supervision supervision;
  const Supervision::Time now{};
  supervision.ended("far", now, "it hung");
  EXPECT_FALSE(supervision.last_restart("far").has_value());
  supervision.take_due(now + 100ms);
  supervision.ended("far", now + 1s, "it died");
  EXPECT_EQ(supervision.last_restart("far")->reason, "it hung");
  EXPECT_EQ(supervision.last_restart("far")->at, now + 100ms);
}

TEST(Supervision, WhatRanForLongIsSoonStartedAgain) {
  Supervision supervision;
  Supervision::Time now{};
  for (int end = 0; end < 10; ++end) {
    EXPECT_EQ(supervision.ended("far", now), now + 100ms);
    EXPECT_THAT(supervision.take_due(now + 100ms), ElementsAre("far"));
    now += 31s;
  }
  EXPECT_EQ(supervision.restarts("far"), 10U);
  supervision.forget("far");
  EXPECT_EQ(supervision.restarts("far"), 0U);
}

// ---- what -----------------------------------------------------------------------------------------------------

class GroupRestart : public testing::Test {
 protected:
  void kill_group() { ::kill(system.system().child_groups().at(0)->process(), SIGKILL); }
  void await_restart(std::uint64_t number) {
    system.eventually("the restart", [&] {
      const auto status = system.instance("source");
      return status.restarts() == number && status.mode() != "failed";
    });
  }
  void expect_more_of(const std::string& port) {
    const auto before = system.port(port).messages();
    system.eventually("more for " + port, [&] { return system.port(port).messages() > before + 5; });
  }
  void expect_nothing_ends_for(std::chrono::milliseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    const auto groups = system.system().child_groups().size();
    system.eventually("the time passes", [&] { return std::chrono::steady_clock::now() >= end; });
    EXPECT_EQ(system.system().child_groups().size(), groups);
  }

  RunningSystem system{RunningSystem::RestartsGroups{}};
};

TEST_F(GroupRestart, BringsBackInstancesWithTheirModesAndParametersAndWiresBothWays) {
  system.load_in("far", "source", "source", "period_ms=5");
  system.load_in("far", "sink", "far_sink");
  system.load_in("far", "source", "resting", "neutral period_ms=5");
  system.load_in("", "source", "near_source", "period_ms=5");
  system.load_in("", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.wire("far_sink.each", "near_source.newest");
  system.wire("far_sink.newest", "source.newest");
  system.set("source", "period_ms=3");
  for (const std::string port : {"sink.each", "far_sink.each", "far_sink.newest"}) expect_more_of(port);
  const auto before = system.instance("source");
  kill_group();
  await_restart(1);
  for (const std::string port : {"sink.each", "far_sink.each", "far_sink.newest"}) expect_more_of(port);
  EXPECT_EQ(system.instance("resting").mode(), "neutral");
  const auto after = system.instance("source");
  EXPECT_EQ(after.mode(), "active");
  EXPECT_EQ(after.set_parameters_size(), before.set_parameters_size());
  for (int i = 0; i < before.set_parameters_size(); ++i) {
    EXPECT_EQ(after.set_parameters(i).SerializeAsString(), before.set_parameters(i).SerializeAsString());
  }
}

TEST_F(GroupRestart, TheBetterAlternativeServesAgainOnceItIsBack) {
  system.load_in("far", "source", "source", "period_ms=5");
  system.load_in("", "source", "other", "period_ms=5");
  system.load_in("", "sink", "sink");
  system.wire_to_several("sink.each", {"source.newest", "other.newest"}, 50);
  const auto serves = [&](const std::string& provider) {
    return [this, provider] { return system.read("sink.each.serving").payload() == provider; };
  };
  system.eventually("the first serves", serves("source.newest"));
  kill_group();
  system.eventually("the other serves", serves("other.newest"));
  system.eventually("the first serves again", serves("source.newest"));
  expect_more_of("sink.each");
}

TEST_F(GroupRestart, AGroupThatEndsEachTimeIsLeftAndSaysSo) {
  system.load_in("far", "hog", "source", "from_ms=50 die=true");
  system.eventually("it is left", [&] { return system.instance("source").reason().find("left") != std::string::npos; });
  EXPECT_EQ(system.instance("source").reason(), "group 'far' exited with code 3; left, after 3 restarts within 30 s");
  EXPECT_EQ(system.instance("source").restarts(), 3U);
  EXPECT_FALSE(system.system().awaits_restart());
  system.unload("source");
  system.load_in("far", "hog", "source", "from_ms=50 die=true");
  system.eventually("it is started again", [&] { return system.instance("source").restarts() == 1; });
}

TEST_F(GroupRestart, WhatIsUnloadedMeanwhileStaysAway) {
  system.load_in("far", "source", "source");
  system.load_in("far", "sink", "sink");
  kill_group();
  system.eventually("its end", [&] { return system.instance("source").mode() == "failed"; });
  system.unload("source");
  system.unload("sink");
  EXPECT_FALSE(system.system().awaits_restart()) << "nobody wants it any more";
}

TEST_F(GroupRestart, OneThatIsLoadedAnewMeanwhileIsNotMadeTwice) {
  system.load_in("far", "source", "source");
  system.load_in("far", "sink", "sink");
  kill_group();
  system.eventually("its end", [&] { return system.instance("source").mode() == "failed"; });
  system.unload("source");
  system.load_in("far", "source", "source", "period_ms=7");
  system.eventually("the other is back", [&] { return system.instance("sink").mode() == "active"; });
  EXPECT_EQ(system.system().child_groups().size(), 1U);
  EXPECT_EQ(system.instance("source").mode(), "active");
}

// ---- nobody lives there any more ------------------------------------------------------------------------------

bool lives(pid_t process) { return ::kill(process, 0) == 0; }

TEST_F(GroupRestart, AGroupEndsOnceTheLastInstanceHasLeftIt) {
  system.load_in("far", "source", "source");
  system.load_in("far", "sink", "sink");
  const pid_t process = system.group("far").process();
  system.unload("source");
  expect_nothing_ends_for(300ms);
  EXPECT_EQ(system.group("far").process(), process) << "the sink lives there";
  system.unload("sink");
  system.eventually("its process ends", [&] { return !lives(process); });
  EXPECT_EQ(system.system().snapshot().groups_size(), 1) << "main";
}

TEST_F(GroupRestart, AGroupThatIsNamedAgainAfterTheLastInstanceHasLeftIsAnotherProcess) {
  system.load_in("far", "source", "source");
  const pid_t process = system.group("far").process();
  system.unload("source");
  system.load_in("far", "source", "source", "period_ms=5");
  system.load_in("", "sink", "sink");
  EXPECT_NE(system.group("far").process(), process);
  system.wire("sink.each", "source.newest");
  expect_more_of("sink.each");
  EXPECT_FALSE(lives(process));
}

TEST_F(GroupRestart, AGroupThatIsLeftWhileItIsDownIsNotStartedForNobody) {
  system.load_in("far", "source", "source");
  kill_group();
  system.eventually("its end", [&] { return system.instance("source").mode() == "failed"; });
  system.unload("source");
  system.eventually("it is forgotten", [&] { return system.system().snapshot().groups_size() == 1; });
}

}  // namespace
}  // namespace fiona::conformance
