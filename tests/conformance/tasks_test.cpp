// Tasks (docs/patterns.md, Tasks): what starts them comes over every transport.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using testing::ElementsAre;

class Tasks : public testing::TestWithParam<Transport> {
 protected:
  void SetUp() override {
    system.load_client("toiler", "toiler");
    system.load_provider("source", "source", "neutral period_ms=1 count=9");
  }
  void put_nine(const std::string& into) {
    system.wire("toiler." + into, "source.newest");
    system.state("source", "active");
  }
  double probe(const std::string& name) { return system.read("toiler." + name).value(); }
  void expect_reads() {
    const auto reads = system.watch("toiler.reads");
    system.wait_for(reads, [](const auto&) { return true; });
  }

  RunningSystem system{GetParam()};
};

TEST_P(Tasks, OnAPortStartsAtTheFirstArrivalAndThenAtEachNth) {
  const auto thirds = system.watch("toiler.thirds");
  put_nine("samples");
  for (const std::uint64_t number : {1U, 4U, 7U}) {
    EXPECT_EQ(system.wait_for(thirds, [](const auto&) { return true; }).number(), number);
  }
  system.eventually("all nine", [&] { return system.port("toiler.samples").messages() == 9; });
  EXPECT_EQ(probe("third.runs"), 3);
  EXPECT_EQ(probe("third.overruns"), 0);
}

TEST_P(Tasks, AfterAnotherStartsEachTimeThatThatHasEnded) {
  const auto follows = system.watch("toiler.follows");
  put_nine("samples");
  system.wait_for(follows, [](const auto& s) { return s.number() == 3; });
  EXPECT_EQ(probe("follow.runs"), 3);
  EXPECT_LT(probe("follow.late"), 5000) << "in ms, from the end of the other";
}

TEST_P(Tasks, OnAPortWithoutHandlerStartsAtEachArrivalOrCountsAnOverrun) {
  const auto looks = system.watch("toiler.looks");
  put_nine("slot");
  system.wait_for(looks, [](const auto& s) { return s.number() == 9; });
  system.eventually("each is counted", [&] { return probe("look.runs") + probe("look.overruns") == 9; });
}

TEST_P(Tasks, FreeRunningReachesThePortsThroughTheStrand) {
  const auto reads = system.watch("toiler.reads");
  for (int i = 0; i < 3; ++i) {
    const auto first = system.wait_for(reads, [](const auto&) { return true; });
    EXPECT_EQ(system.wait_for(reads, [](const auto&) { return true; }).number(), first.number() + 1);
  }
  EXPECT_GT(probe("read.runs"), 3);
  EXPECT_EQ(probe("read.overruns"), 0);
}

TEST_P(Tasks, FreeRunningEndsWithItsActivityAndBeginsWithIt) {
  expect_reads();
  system.state("toiler", "rest");
  const double runs = probe("read.runs");
  system.state("source", "active");
  system.eventually("time passes", [&] { return system.port("source.newest").messages() == 9; });
  EXPECT_EQ(probe("read.runs"), runs);
  system.state("toiler", "toil");
  expect_reads();
}

TEST_P(Tasks, FreeRunningThatDoesNotReturnBlocksTheChangeByNameAndForItsTimeOnly) {
  system.set("toiler", "stubborn=true");
  const auto change = system.begin_state("toiler", "rest", 1000);
  system.eventually("pending",
                    [&] { return change->ended || system.instance("toiler").pending().blocked_by() == "task 'read'"; });
  system.eventually("the answer", [&] { return change->ended.load(); });
  EXPECT_EQ(change->reply.failure().what(), "'toiler' did not change its mode to rest in time: blocked by task 'read'");
  EXPECT_EQ(system.instance("toiler").mode(), "toil");
  system.set("toiler", "stubborn=false");
  expect_reads();
  system.state("toiler", "rest");
  EXPECT_EQ(system.instance("toiler").mode(), "rest");
}

TEST_P(Tasks, ExceptionInAThreadOfItsOwnFailsTheInstanceAndLeavesTheOthers) {
  system.set("toiler", "fail_with=unplugged");
  system.eventually("failed", [&] { return system.instance("toiler").mode() == "failed"; });
  EXPECT_EQ(system.instance("toiler").reason(), "unplugged");
  EXPECT_EQ(system.instance("source").mode(), "neutral");
  system.unload("toiler");
}

TEST_P(Tasks, StatusSaysWhatStartsEach) {
  const auto instance = system.instance("toiler");
  std::vector<std::string> all;
  for (const auto& status : instance.tasks()) {
    all.push_back(status.task().name() + " " + TaskStart_Name(status.task().start()) + " " + status.task().of() + " " +
                  std::to_string(status.task().every()) + " in " + status.task().activity());
    EXPECT_EQ(status.task().period_ms(), status.task().name() == "tick" ? 20 : 0) << status.task().name();
  }
  EXPECT_THAT(all, ElementsAre("tick PERIODIC  0 in toil", "third ON_PORT samples 3 in toil",
                               "follow AFTER_TASK third 0 in toil", "look ON_PORT slot 1 in toil",
                               "read FREE_RUNNING  0 in toil"));
}

TEST_P(Tasks, PeriodicRunsAgainAndAgainWhileItsActivityDoes) {
  system.eventually("it runs", [&] { return probe("tick.runs") > 3; });
  system.state("toiler", "rest");
  const double runs = probe("tick.runs");
  system.load_provider("source", "clockwork", "period_ms=10 count=20");
  system.eventually("200 ms pass", [&] { return system.port("clockwork.newest").messages() == 20; });
  EXPECT_EQ(probe("tick.runs"), runs);
  system.state("toiler", "toil");
  system.eventually("it runs again", [&] { return probe("tick.runs") > runs + 3; });
}

FIONA_OVER_EVERY_TRANSPORT(Tasks);

}  // namespace
}  // namespace fiona::conformance
