// A component with the right `master` changes the system: in the host's process, in a group, on another host.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <thread>

#include "campaign.hpp"
#include "masters.hpp"
#include "served_host.hpp"

namespace fiona::conformance {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::StartsWith;
using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

class Masters : public testing::TestWithParam<Transport> {
 protected:
  void load_system() {
    console.load("beacon", "main", "a", "period_ms=2");
    console.load("beacon", "main", "b", "period_ms=2");
    console.load("navigator", "main", "nav");
    load_boss(true);
  }
  void load_boss(bool granted) {
    control::Change boss = TestConsole::load_of("boss", host.place());
    if (granted) boss.mutable_load()->add_rights("master");
    console.change(boss);
  }
  /// What makes the boss call.
  control::Change order(const std::string& call, const std::string& first = "-", const std::string& second = "-",
                        const std::string& more = "") {
    ++calls;
    return TestConsole::set_of(
        "boss", "call=" + call + " first=" + first + " second=" + second + " go=" + std::to_string(calls) + " " + more);
  }
  void begin(const std::string& call, const std::string& first = "-", const std::string& second = "-",
             const std::string& more = "") {
    console.change(order(call, first, second, more));
  }
  /// How the newest call ended: "ok nav.fixes to a.fixes".
  std::string end() {
    const std::string number = std::to_string(calls) + " ";
    std::string ended;
    console.eventually("the end of the call", [&] { return (ended = console.read("boss.ended")).starts_with(number); });
    return ended.substr(number.size());
  }
  std::string call(const std::string& name, const std::string& first = "-", const std::string& second = "-",
                   const std::string& more = "") {
    begin(name, first, second, more);
    return end();
  }

  ServedHost host{GetParam()};
  TestConsole console{host};
  int calls = 0;
};

/// At its start, while a console asks for the same.
TEST_P(Masters, AChangeToThePresentModeIsAnsweredToTheComponentItselfAndToAConsoleThatAsksMeanwhile) {
  load_boss(true);
  for (int i = 0; i < 20; ++i) {
    control::Change to_active;
    to_active.mutable_state()->set_instance("boss");
    to_active.mutable_state()->set_mode("active");
    console.begin(to_active);
    console.begin(TestConsole::set_of("boss", "call=state first=boss second=active go=" + std::to_string(++calls)));
    console.begin(to_active);
    for (int answer = 0; answer < 3; ++answer) EXPECT_TRUE(console.receive().has_done());
    EXPECT_EQ(end(), "ok boss is active");
  }
}

TEST_P(Masters, AComponentWiresRewiresListsAndUnwires) {
  load_system();
  EXPECT_EQ(call("wire", "nav.fixes", "a.fixes"), "ok nav.fixes to a.fixes");
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
  EXPECT_EQ(call("list"), "ok nav.fixes<a ");
  EXPECT_EQ(call("swap", "a", "b"), "ok nav.fixes to b.fixes");
  EXPECT_EQ(console.peer_of("nav.fixes"), "b");
  EXPECT_EQ(call("plan", "nav.fixes", "a.fixes"), "ok 1 step");
  EXPECT_EQ(console.peer_of("nav.fixes"), "b") << "a plan changes nothing";
  EXPECT_EQ(call("unwire", "nav.fixes"), "ok nav.fixes unwired");
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
}

TEST_P(Masters, AComponentChangesModesAndParameters) {
  load_system();
  EXPECT_EQ(call("state", "a", "neutral"), "ok a is neutral");
  EXPECT_EQ(console.instance("a").mode(), "neutral");
  EXPECT_EQ(call("set", "b"), "ok 2 changes");
  EXPECT_EQ(console.instance("b").set_parameters_size(), 2);
}

TEST_P(Masters, AChangeIsInTheJournalUnderItsNameAndUndoTakesItBack) {
  load_system();
  call("wire", "nav.fixes", "a.fixes");
  console.change(TestConsole::set_of("b", "period_ms=3"));
  console.undo();
  call("wire", "nav.fixes", "b.fixes");
  const control::JournalEntry entry = console.last_entry();
  EXPECT_EQ(entry.author(), "component boss");
  EXPECT_EQ(entry.state(), control::JournalEntry::DONE);
  console.undo();
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
}

TEST_P(Masters, WithoutTheRightEachCallIsRejectedWithASentenceThatSaysHowToGrantIt) {
  console.load("beacon", "main", "a", "period_ms=2");
  console.load("navigator", "main", "nav");
  load_boss(false);
  for (const std::string name : {"wire", "list", "plan", "read", "watch"}) {
    const std::string ended = call(name, "nav.fixes", "a.fixes");
    EXPECT_THAT(ended, StartsWith("rejected ")) << name;
    EXPECT_THAT(ended, HasSubstr("'boss' has not been granted the right 'master'")) << name;
    EXPECT_THAT(ended, HasSubstr("unload boss, then: load ")) << name;
    EXPECT_THAT(ended, EndsWith(" as boss with master")) << name;
  }
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
}

TEST_P(Masters, ABatchIsMadeAsAWholeOrNotAtAll) {
  load_system();
  const std::string ended = call("batch", "nav.fixes", "a.fixes");
  EXPECT_THAT(ended, StartsWith("rejected "));
  EXPECT_THAT(ended, HasSubstr("'nav' cannot go from active to nowhere"));
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
  EXPECT_EQ(console.last_entry().state(), control::JournalEntry::ROLLED_BACK);
}

TEST_P(Masters, ARefusalIsTheSentenceThatAConsoleGets) {
  load_system();
  EXPECT_THAT(call("wire", "nav.fixs", "a.fixes"), HasSubstr("'nav' has no port 'fixs' that requires"));
  EXPECT_THAT(call("wire", "nav.fixes", "a.echo"),
              HasSubstr("nav.fixes requires Fixes (push newest, Fix); a.echo provides Echo"));
}

TEST_P(Masters, WhatAComponentAsksWhileItsCallsAreCancelledEndsCancelledAndIsNotMade) {
  load_system();
  EXPECT_EQ(call("cancelled", "nav.fixes", "a.fixes"), "cancelled");
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
  EXPECT_EQ(call("wire", "nav.fixes", "a.fixes"), "ok nav.fixes to a.fixes");
}

TEST_P(Masters, OneThatIsNotActiveMayNotAsk) {
  load_system();
  console.state("boss", "neutral");
  EXPECT_EQ(call("wire", "nav.fixes", "a.fixes"), "not_active");
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
}

TEST_P(Masters, ChangesItsOwnModeAndHearsThatItLeftIt) {
  load_system();
  EXPECT_EQ(call("state", "boss", "neutral"), "not_active");
  console.eventually("neutral", [&] { return console.instance("boss").mode() == "neutral"; });
}

TEST_P(Masters, ChangeOfItsOwnModeThatItBlocksItselfEndsInTimeSaysSoAndHoldsUpNobody) {
  load_system();
  const auto begun = Steady::now();
  begin("state", "boss", "neutral", "deadline_ms=10000 held=true");
  console.change(TestConsole::wire_of("nav.fixes", "b.fixes"));
  EXPECT_LT(Steady::now() - begun, 8s) << "the wire did not wait for it";
  const std::string ended = end();
  EXPECT_THAT(ended, StartsWith("rejected ")) << ended;
  EXPECT_THAT(ended, HasSubstr("did not change its mode to neutral in time: blocked by task 'hold'"));
  EXPECT_EQ(console.instance("boss").mode(), "active");
}

TEST_P(Masters, UnloadsItself) {
  load_system();
  begin("unload", "boss");
  console.eventually("it is gone", [&] {
    const auto system = console.snapshot();
    return std::none_of(system.instances().begin(), system.instances().end(),
                        [](const auto& one) { return one.name() == "boss"; });
  });
  EXPECT_EQ(console.last_entry().author(), "component boss");
  EXPECT_EQ(console.last_entry().state(), control::JournalEntry::DONE);
}

TEST_P(Masters, MoreCallsThanMayBeOpenAreRejectedAndTheOthersMade) {
  load_system();
  EXPECT_THAT(call("many", "nav.fixes", "a.fixes"), HasSubstr("64 made, 16 refused"));
}

/// Beside somebody who holds his activity until he is told to let go: so long a change of his mode takes.
class MastersThatWait : public Masters {
 protected:
  static constexpr const char* kBriefly = "deadline_ms=50";
  void SetUp() override {
    load_system();
    console.load("holder", "main", "holder");
    tell_holder("begin");
    console.eventually("it holds", [&] { return console.read("holder.held") == "task"; });
  }
  void tell_holder(const std::string& trigger) {
    auto told = console.request();
    *told.mutable_call()->mutable_target() = port_name("holder." + trigger);
    add_arguments("manner=task", *told.mutable_call()->mutable_arguments());
    EXPECT_EQ(console.ask(told).called().outcome(), "ok");
  }
  /// Makes the boss call while the change that tells it to is under way, until the holder lets go.
  void begin_held_up(const control::Change& asked) {
    auto request = other.request();
    *request.mutable_transact()->add_changes() = asked;
    auto& rest = *request.mutable_transact()->add_changes()->mutable_state();
    rest.set_instance("holder");
    rest.set_mode("rest");
    rest.set_within_ms(60'000);
    other.send(request);
  }
  /// And all changes have had their turn.
  void let_go() {
    tell_holder("open");
    EXPECT_TRUE(other.receive().has_done());
    console.set("a", "period_ms=3");
  }
  /// At the host the time of a call begins, and ends, later than where it was made.
  static void let_the_deadline_pass() { std::this_thread::sleep_for(1s); }

  TestConsole other{host};
};

TEST_P(MastersThatWait, WhatHasNotBegunByTheDeadlineEndsTimeoutAndIsNotMade) {
  begin_held_up(order("wire", "nav.fixes", "a.fixes", kBriefly));
  EXPECT_EQ(end(), "timeout");
  let_the_deadline_pass();
  let_go();
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
}

TEST_P(MastersThatWait, WhatHasBegunByTheDeadlineEndsTimeoutAndIsMade) {
  begin("patient_state", "holder", "rest", kBriefly);
  EXPECT_EQ(end(), "timeout");
  let_the_deadline_pass();
  EXPECT_EQ(console.instance("holder").mode(), "work");
  tell_holder("open");
  console.eventually("it rests", [&] { return console.instance("holder").mode() == "rest"; });
  console.eventually("it is done", [&] { return console.last_entry().state() == control::JournalEntry::DONE; });
  EXPECT_EQ(console.last_entry().author(), "component boss");
}

TEST_P(MastersThatWait, CallThatNamesNoDeadlineEndsAfterTwoSeconds) {
  const tests::Pulse pulse;
  const auto begun = Steady::now();
  begin_held_up(order("wire_by_default", "nav.fixes", "a.fixes"));
  EXPECT_EQ(end(), "timeout");
  const double took_ms = std::chrono::duration<double, std::milli>(Steady::now() - begun).count();
  EXPECT_GE(took_ms, 2000);
  EXPECT_LE(took_ms, 2000 + allowed(500, false) + pulse.longest_ms());
  let_go();
}

/// What one sees of others, beside a gauge.
class Watchers : public Masters {
 protected:
  void SetUp() override {
    console.load("gauge", host.place(), "gauge", "level=1");
    load_boss(true);
  }
  void level(double value) { console.set("gauge", fmt::format("level={}", value)); }
  /// Until nothing more has come for a while: "timeout 2 seen, 0 missing: 1 2 ".
  std::string fetched() { return call("fetch", "-", "-", "deadline_ms=2000"); }
};

TEST_P(Watchers, AComponentReadsAProbeOnce) {
  EXPECT_EQ(call("read", "gauge.level", "-", "deadline_ms=10000"), "ok 1");
  EXPECT_EQ(call("read", "gauge.mode"), "ok active");
  EXPECT_THAT(call("read", "gauge.levle"), HasSubstr("'gauge' has no"));
}

TEST_P(Watchers, AComponentIsToldEachValueOfAProbeInItsOrder) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  level(2);
  level(3);
  EXPECT_EQ(fetched(), "timeout 3 seen, 0 missing: 1 2 3 ");
  level(4);
  EXPECT_EQ(fetched(), "timeout 1 seen, 0 missing: 4 ") << "a time that is over loses nothing";
  EXPECT_EQ(call("watch", "gauge.level", "every2", "deadline_ms=10000"), "ok") << "in the place of the other one";
  for (const double value : {5, 6, 7, 8}) level(value);
  EXPECT_EQ(fetched(), "timeout 3 seen, 0 missing: 4 6 8 ");
}

TEST_P(Watchers, AComponentIsToldWhenAConditionBecomesTrue) {
  EXPECT_EQ(call("watch", "gauge.level", "above5", "deadline_ms=10000"), "ok");
  for (const double value : {2, 6, 7, 1, 8}) level(value);
  EXPECT_EQ(fetched(), "timeout 2 seen, 0 missing: 6 8 ");
  EXPECT_EQ(call("watch", "gauge.level", "older", "deadline_ms=10000"), "ok");
  EXPECT_EQ(fetched(), "timeout 1 seen, 0 missing: 8 ");
}

TEST_P(Watchers, AComponentThatIsSlowKeepsTheNewestAndIsToldHowManyAreMissing) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  for (int value = 2; value <= 100; ++value) level(value);
  const std::string seen = fetched();
  EXPECT_THAT(seen, StartsWith("timeout 64 seen, 36 missing: 37 38 "));
  EXPECT_THAT(seen, EndsWith(" 99 100 "));
}

TEST_P(Watchers, AComponentThatIsSlowKeeps4MiBOfLargeValuesAndIsToldHowManyAreMissing) {
  control::Change source =
      TestConsole::load_of("source", host.place(), "source", "period_ms=5 count=8 payload=1000000");
  source.mutable_load()->set_mode("neutral");
  console.change(source);
  EXPECT_EQ(call("watch", "source.newest", "-", "deadline_ms=10000"), "ok");
  console.state("source", "active");
  console.eventually("all are put", [&] { return console.instance("source").ports(0).messages() == 8; });
  console.unload("source");  // what has come before is told first
  EXPECT_THAT(call("fetch", "-", "-", "deadline_ms=10000"),
              StartsWith("rejected 4 seen, 4 missing: fiona.test.Sample "));
}

TEST_P(Watchers, AComponentThatPausesFindsWhatHasComeMeanwhile) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  console.state("boss", "neutral");
  level(2);
  console.state("boss", "active");
  EXPECT_EQ(fetched(), "timeout 2 seen, 0 missing: 1 2 ");
}

TEST_P(Watchers, AComponentWatchesAPushPort) {
  console.load("beacon", "main", "a", "period_ms=20");
  EXPECT_EQ(call("watch", "a.fixes", "-", "deadline_ms=10000"), "ok");
  const std::uint64_t before = console.instance("a").ports(0).messages();
  console.eventually("more is put", [&] { return console.instance("a").ports(0).messages() > before + 4; });
  console.state("a", "neutral");
  EXPECT_THAT(fetched(), HasSubstr("fiona.test.Fix fiona.test.Fix "));
}

TEST_P(Watchers, AWatchThatEndsAfterADeadlineHasPassedSaysWhyEachTime) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  EXPECT_EQ(fetched(), "timeout 1 seen, 0 missing: 1 ");
  console.unload("gauge");
  for (int i = 0; i < 2; ++i) {
    const std::string ended = fetched();
    EXPECT_THAT(ended, StartsWith("rejected 0 seen"));
    EXPECT_THAT(ended, HasSubstr("'gauge' was unloaded"));
  }
}

TEST_P(Watchers, AComponentIsToldOfAValueThatWasGivenToACallThatHadEnded) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  EXPECT_EQ(fetched(), "timeout 1 seen, 0 missing: 1 ");
  for (int value = 2; value <= 101; ++value) level(value);
  EXPECT_THAT(fetched(), StartsWith("timeout 64 seen, 36 missing: 38 39 "));
}

TEST_P(Watchers, AComponentIsToldThatWhatItWatchesIsGone) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  console.unload("gauge");
  const std::string ended = fetched();
  EXPECT_THAT(ended, StartsWith("rejected 1 seen, 0 missing: 1 ")) << "what had come before is not lost";
  EXPECT_THAT(ended, HasSubstr("gauge"));
  EXPECT_THAT(call("watch", "gauge.level", "-", "deadline_ms=10000"), StartsWith("rejected "));
}

TEST_P(Watchers, AWatchThatIsLetGoOfIsOver) {
  EXPECT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok");
  EXPECT_EQ(call("let_go"), "ok");
  EXPECT_EQ(fetched(), "rejected nothing is watched");
  for (int i = 0; i < 70; ++i) ASSERT_EQ(call("watch", "gauge.level", "-", "deadline_ms=10000"), "ok") << i;
}

TEST_P(Watchers, AComponentHas64AtMost) {
  for (int i = 0; i < 64; ++i)
    ASSERT_EQ(call("watch", i % 2 ? "gauge.level" : "gauge.count", "more", "deadline_ms=10000"), "ok") << i;
  EXPECT_THAT(call("watch", "gauge.level"), HasSubstr("it watches 64 things already"));
}

TEST_P(Watchers, OfAComponentThatIsUnloadedNoWatchIsLeft) {
  const auto watch = [this] {
    auto one = console.request();
    *one.mutable_watch()->mutable_port() = port_name("gauge.level");
    return console.ask(one);
  };
  for (int i = 0; i < 32; ++i) ASSERT_EQ(call("watch", "gauge.level", "more", "deadline_ms=10000"), "ok") << i;
  EXPECT_THROW(watch(), Error) << "there are fewer than may be";
  console.unload("boss");
  EXPECT_TRUE(watch().has_sample());
}

TEST_P(Watchers, AConditionThatDoesNotFitEndsTheWatch) {
  EXPECT_EQ(call("watch", "gauge.mode", "above5", "deadline_ms=10000"), "ok");
  const std::string ended = fetched();
  EXPECT_THAT(ended, StartsWith("rejected 0 seen, 0 missing: "));
  EXPECT_THAT(ended, HasSubstr("does not compare with this value"));
}

/// Of what lives in a process of its own: a group, or another host.
class OfAnotherProcess : public testing::TestWithParam<Transport> {
 protected:
  void kill_far() { ::kill(host.has_other() ? host.other().process() : console.process_of("far"), SIGKILL); }

  ServedHost host{GetParam()};
  TestConsole console{host};
};
using WatchOfAGroup = OfAnotherProcess;
using MasterThatDies = OfAnotherProcess;

TEST_P(WatchOfAGroup, ThatEndsIsOverWithAReason) {
  console.load("gauge", "far", "gauge", "level=1");
  control::Change boss = TestConsole::load_of("boss", "main");
  boss.mutable_load()->add_rights("master");
  console.change(boss);
  console.set("boss", "call=watch first=gauge.level second=- go=1");
  console.eventually("the watch", [&] { return console.read("boss.ended") == "1 ok"; });
  console.set("boss", "call=fetch go=2");
  kill_far();
  if (host.has_other()) host.other().restart();  // or it might be cut off
  std::string ended;
  console.eventually("its end", [&] { return (ended = console.read("boss.ended")).starts_with("2 "); });
  EXPECT_THAT(ended, StartsWith("2 rejected 1 seen, 0 missing: 1 "));
  EXPECT_THAT(ended, HasSubstr("far"));
}

FIONA_OVER_EVERY_TRANSPORT(Masters);
FIONA_OVER_EVERY_TRANSPORT(MastersThatWait);
FIONA_OVER_EVERY_TRANSPORT(Watchers);

TEST_P(MasterThatDies, LosesNothingOfWhatItAskedFor) {
  console.load("beacon", "main", "a", "period_ms=2");
  console.load("navigator", "main", "nav");
  control::Change boss = TestConsole::load_of("boss", "far");
  boss.mutable_load()->add_rights("master");
  console.change(boss);
  console.set("boss", "call=wire first=nav.fixes second=a.fixes go=1");
  console.eventually("the change", [&] { return console.last_entry().author() == "component boss"; });
  kill_far();
  console.eventually("its death is noticed", [&] { return console.instance("boss").mode() == "failed"; });
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
  EXPECT_EQ(console.last_entry().state(), control::JournalEntry::DONE);
  console.undo();
  EXPECT_EQ(console.peer_of("nav.fixes"), "");
}

FIONA_OVER(WatchOfAGroup, Transport::Ipc, Transport::Tcp);
FIONA_OVER(MasterThatDies, Transport::Ipc, Transport::Tcp);

TEST(MasterRights, AreGrantedToWhoAsksForThemOnly) {
  ServedHost host;
  TestConsole console(host);
  const auto refusal_of = [&](const std::string& component, const std::string& right) {
    control::Change load = TestConsole::load_of(component, "main");
    load.mutable_load()->add_rights(right);
    try {
      console.change(load);
    } catch (const Error& error) {
      return error.text();
    }
    return ErrorText{};
  };
  EXPECT_EQ(refusal_of("source", "master").what, "'source' has no use for the right 'master'");
  EXPECT_EQ(refusal_of("boss", "mister").what, "there is no right 'mister' that could be granted");
  EXPECT_THAT(refusal_of("boss", "mister").near, ::testing::ElementsAre("master"));
  EXPECT_EQ(console.snapshot().instances_size(), 0);
}

TEST(MasterRights, AreKeptByAnUndoOfTheUnload) {
  ServedHost host;
  TestConsole console(host);
  control::Change boss = TestConsole::load_of("boss", "main");
  boss.mutable_load()->add_rights("master");
  console.change(boss);
  console.unload("boss");
  console.undo();
  EXPECT_EQ(console.instance("boss").rights(0), "master");
}

/// What components say, as it comes from them.
class RawMaster : public ::testing::Test {
 protected:
  void SetUp() override {
    control::Change boss = TestConsole::load_of("boss", "main");
    boss.mutable_load()->add_rights("master");
    system.system().perform(boss);
  }

  RunningSystem system;
  TemporaryDirectory directory;
  host::Mailbox<std::function<void()>> work;
  const host::Engine::Later later = [this](std::function<void()> job) { work.push(std::move(job)); };
  host::Engine engine{system.system(), directory.path / "journal", later};
  host::Masters masters{system.system(), engine, later};
};

TEST_F(RawMaster, AWatchWhoseNumberIsInUseIsRefusedAndTheOneThatHasItGoesOn) {
  system.load_in("main", "gauge", "gauge");
  wire::Asked asked;
  asked.set_group("main");
  asked.set_instance("boss");
  asked.set_number(1);
  *asked.mutable_request()->mutable_watch()->mutable_port() = port_name("gauge.level");
  const control::Watch watch = asked.request().watch();
  for (int i = 0; i < 40; ++i) masters.serve(asked);
  for (int i = 1; i < 32; ++i) system.system().tap(system.system().new_tap(), watch);
  EXPECT_THROW(system.system().tap(system.system().new_tap(), watch), Error) << "not even one is left of the 40";
}

TEST_F(RawMaster, HasNoRightsInAnothersName) {
  system.load_in("red", "beacon", "beacon");
  wire::Asked forged;
  forged.set_instance("boss");
  forged.set_number(1);
  control::Change& unload = *forged.mutable_request()->mutable_transact()->add_changes();
  unload.mutable_unload()->set_instance("beacon");
  for (const std::string group : {"red", ""}) {
    forged.set_group(group);
    masters.serve(forged);
    EXPECT_TRUE(system.system().is_loaded("beacon")) << "said by '" << group << "'";
  }
  forged.set_group("main");
  masters.serve(forged);
  EXPECT_FALSE(system.system().is_loaded("beacon"));
}

}  // namespace
}  // namespace fiona::conformance
