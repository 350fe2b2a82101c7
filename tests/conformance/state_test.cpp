// Modes and activities (docs/patterns.md, State). They are the same whichever process the component is in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include "fiona/error.hpp"
#include "holders.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;

class State : public testing::TestWithParam<Transport> {
 protected:
  void SetUp() override { system.load_client("mover", "mover"); }

  /// What has come, or was put.
  std::uint64_t count(const std::string& port) {
    const auto status = system.port("mover." + port);
    return status.messages() + status.superseded();
  }
  void expect_runs(const std::string& port) {
    const auto before = count(port);
    system.eventually(port + " runs", [&] { return count(port) > before + 2; });
  }
  /// `other` runs meanwhile, which shows that time has passed.
  void expect_stands(const std::string& port, const std::string& other) {
    const auto before = count(port);
    expect_runs(other);
    expect_runs(other);
    EXPECT_EQ(count(port), before) << port;
  }
  /// Keeps the steering task waiting, with its activity held.
  void hold_steering() {
    system.load_provider("source", "source", "neutral");
    system.wire("mover.orders", "source.newest");
    system.set("mover", "work_ms=60000");
    // Both tasks have the same period: one that waits falls behind the other.
    std::uint64_t steers = 0;
    std::uint64_t looks = 0;
    system.eventually("steering waits", [&] {
      const std::uint64_t looked = system.port("mover.looks").messages();
      if (const std::uint64_t steered = system.port("mover.steers").messages();
          steered != std::exchange(steers, steered))
        looks = looked;
      return looked > looks + 5;
    });
  }
  /// What waits at the gate holds the activity `steer` until it is opened.
  void load_gate() {
    system.load_provider("source", "keeper", "neutral");
    system.wire("mover.gate", "keeper.newest");
  }
  void open_gate() { system.state("keeper", "active"); }
  void wait_until_held() {
    system.eventually("it waits at the gate", [&] { return system.read("mover.held").value() == 1; });
  }
  std::shared_ptr<LaterAnswer> begin_held_turn() {
    const auto turn = system.begin_call("mover.turn_later", "degrees=7 manner=held", 60'000);
    wait_until_held();
    return turn;
  }
  void expect_blocked(const LaterAnswer& change, const std::string& by) {
    system.eventually("blocked by " + by,
                      [&] { return change.ended || system.instance("mover").pending().blocked_by() == by; });
    expect_runs("looks");
    EXPECT_EQ(system.instance("mover").pending().blocked_by(), by);
    EXPECT_FALSE(change.ended) << change.reply.ShortDebugString();
    EXPECT_EQ(system.instance("mover").mode(), "drive");
  }
  void expect_parked(const LaterAnswer& change) {
    system.eventually("the change", [&] { return change.ended.load(); });
    EXPECT_EQ(change.reply.done().note(), "mover is park");
    EXPECT_EQ(system.instance("mover").mode(), "park");
  }
  void expect_held_by(const std::string& holder) {
    const auto change = system.begin_state("mover", "park");
    expect_blocked(*change, holder);
    open_gate();
    expect_parked(*change);
  }
  std::string refusal_of(const std::string& mode, const std::string& name = "mover") {
    try {
      system.state(name, mode);
    } catch (const Error& error) {
      return error.text().what;
    }
    return "";
  }

  RunningSystem system{GetParam()};
};

TEST_P(State, LoadEntersTheFirstMainMode) {
  EXPECT_EQ(system.instance("mover").mode(), "drive");
  const auto instance = system.instance("mover");
  EXPECT_THAT(std::vector<std::string>(instance.modes().begin(), instance.modes().end()),
              ElementsAre("drive", "park", "rest"));
}

TEST_P(State, EachMainModeRunsItsActivitiesAndNoOthers) {
  expect_runs("looks");
  expect_runs("steers");
  system.state("mover", "park");
  expect_stands("steers", "looks");
  system.state("mover", "rest");
  const auto looked = count("looks");
  system.load_provider("source", "source", "period_ms=10");
  system.eventually("time has passed", [&] { return system.port("source.newest").messages() > 10; });
  EXPECT_LE(count("looks"), looked + 1);
  system.state("mover", "drive");
  expect_runs("steers");
}

TEST_P(State, PortOfAnActivityIsNotActiveOutsideOfIt) {
  system.load_provider("source", "source", "period_ms=1");
  system.wire("mover.orders", "source.newest");
  system.eventually("orders", [&] { return count("orders") > 3; });
  system.state("mover", "park");
  const auto before = count("orders");
  expect_runs("looks");
  EXPECT_EQ(count("orders"), before);
}

TEST_P(State, ChangeWaitsForTheActivityThatItLeavesAndSaysWhatBlocksIt) {
  hold_steering();
  const auto change = system.begin_state("mover", "park");
  system.eventually("pending", [&] { return system.instance("mover").has_pending(); });
  const auto pending = system.instance("mover").pending();
  EXPECT_EQ(pending.to(), "park");
  EXPECT_EQ(pending.blocked_by(), "task 'steer'");
  EXPECT_EQ(system.instance("mover").mode(), "drive");
  expect_runs("looks");  // common to both modes: it goes on
  EXPECT_FALSE(change->ended);
  system.state("source", "active");  // what the task waits for
  system.eventually("the change", [&] { return change->ended.load(); });
  EXPECT_EQ(change->reply.done().note(), "mover is park");
  EXPECT_EQ(system.instance("mover").mode(), "park");
}

TEST_P(State, HandlerOfAPushThatIsACoroutineHoldsTheActivityOfItsPort) {
  load_gate();
  system.load_provider("source", "source", "neutral count=1");
  system.wire("mover.notices", "source.newest");
  system.state("source", "active");
  wait_until_held();
  expect_held_by("the handler of 'notices'");
}

TEST_P(State, HandlerOfAQueryThatIsACoroutineHoldsTheActivityOfItsPort) {
  load_gate();
  const auto question = system.begin_call("mover.echo", "number=5", 60'000);
  wait_until_held();
  expect_held_by("the handler of 'echo'");
  system.eventually("its answer", [&] { return question->ended.load(); });
  EXPECT_EQ(question->reply.called().outcome(), "ok");
}

TEST_P(State, ChangeWaitsForTheFirstOfTwoHoldersThoughTheOtherEnds) {
  hold_steering();
  load_gate();
  const auto turn = begin_held_turn();
  const auto change = system.begin_state("mover", "park");
  expect_blocked(*change, "task 'steer'");
  open_gate();
  system.eventually("the turn ends", [&] { return turn->ended.load(); });
  expect_blocked(*change, "task 'steer'");
  system.state("source", "active");
  expect_parked(*change);
}

TEST_P(State, ChangeThatTheFirstOfTwoHoldersLetsGoIsBlockedByTheOther) {
  hold_steering();
  load_gate();
  const auto turn = begin_held_turn();
  const auto change = system.begin_state("mover", "park");
  expect_blocked(*change, "task 'steer'");
  system.state("source", "active");
  expect_blocked(*change, "trigger 'turn_later'");
  EXPECT_FALSE(turn->ended);
  open_gate();
  expect_parked(*change);
}

class StateOfHolders : public OverTransports {};

/// Whatever holds it, and whichever of the two ends first.
TEST_P(StateOfHolders, ChangeWaitsForBothOfEachPair) {
  Holders holders(system);
  for (const auto& first : Holders::kinds()) {
    for (const auto& second : Holders::kinds()) {
      if (first.name == second.name) continue;
      SCOPED_TRACE(first.name + ", then " + second.name);
      holders.begin(first);
      holders.wait_until_held({first.name});
      holders.begin(second);
      holders.wait_until_held({first.name, second.name});
      const auto change = holders.begin_to_rest();
      // A free running task holds the activity since its mode was entered.
      holders.wait_until_blocked(*change, second.name == "thread" ? second : first);
      holders.open(first);
      holders.wait_until_blocked(*change, second);
      EXPECT_EQ(holders.held(), second.name);
      holders.open(second);
      holders.wait_until_it_rests(*change);
      system.state("holder", "work");
    }
  }
}

TEST_P(State, RequestsQueueInOrderAndEachIsAnswered) {
  hold_steering();
  const auto first = system.begin_state("mover", "park");
  const auto second = system.begin_state("mover", "rest");
  system.state("source", "active");
  system.eventually("both", [&] { return first->ended && second->ended; });
  EXPECT_EQ(first->reply.done().note(), "mover is park");
  EXPECT_EQ(second->reply.done().note(), "mover is rest");
  EXPECT_EQ(system.instance("mover").mode(), "rest");
}

TEST_P(State, ChangeThatIsBlockedForTooLongIsWithdrawnAndNamesWhatBlockedIt) {
  hold_steering();
  const auto change = system.begin_state("mover", "park", 1000);  // its strand comes to it before, however busy it is
  system.eventually("the answer", [&] { return change->ended.load(); });
  EXPECT_EQ(change->reply.failure().what(), "'mover' did not change its mode to park in time: blocked by task 'steer'");
  EXPECT_EQ(system.instance("mover").mode(), "drive");
  EXPECT_FALSE(system.instance("mover").has_pending());
}

TEST_P(State, ChangeThatDoesNotLeaveTheHeldActivityIsMadeAtOnce) {
  system.state("mover", "park");
  system.state("mover", "drive");
  hold_steering();
  EXPECT_EQ(refusal_of("drive"), "");
}

TEST_P(State, DeactivatedCancelsWhatWaitsAndIsThenNeutral) {
  hold_steering();
  const auto outcome = system.watch("mover.outcome");
  system.state("mover", "deactivated");
  const auto ended = system.wait_for(outcome, [](const auto&) { return true; });
  EXPECT_EQ(static_cast<Outcome>(ended.number()), Outcome::Cancelled);
  EXPECT_EQ(system.instance("mover").mode(), "deactivated");
  system.set("mover", "work_ms=0");
  system.state("mover", "drive");
  expect_runs("steers");
}

TEST_P(State, NeutralIsPoliteAndWaitsForWhatRuns) {
  hold_steering();
  const auto change = system.begin_state("mover", "neutral");
  system.eventually("pending", [&] { return system.instance("mover").has_pending(); });
  EXPECT_EQ(system.instance("mover").pending().to(), "neutral");
  EXPECT_EQ(system.instance("mover").pending().blocked_by(), "task 'steer'");
  EXPECT_GT(system.instance("mover").pending().blocked_s(), 0);
  EXPECT_FALSE(change->ended);
  system.state("source", "active");
  system.eventually("the change", [&] { return change->ended.load(); });
  EXPECT_EQ(system.instance("mover").mode(), "neutral");
}

TEST_P(State, ComponentThatDeclaresNoModesHasOneAndIsInItAfterLoad) {
  system.load_client("sink", "sink");
  const auto instance = system.instance("sink");
  EXPECT_THAT(std::vector<std::string>(instance.modes().begin(), instance.modes().end()), ElementsAre("active"));
  EXPECT_EQ(instance.mode(), "active");
  system.load_client("sink", "other", "neutral");
  EXPECT_EQ(system.instance("other").mode(), "neutral") << "as the line says";
}

TEST_P(State, FailedLeadsToShutdownOnlyAndKeepsItsReason) {
  EXPECT_EQ(system.call("mover.turn", "manner=throw").outcome(), "rejected");
  system.eventually("failed", [&] { return system.instance("mover").mode() == "failed"; });
  for (const std::string mode : {"drive", "park", "neutral", "deactivated"}) EXPECT_NE(refusal_of(mode), "") << mode;
  EXPECT_EQ(system.instance("mover").reason(), "the wheel came off");
  system.unload("mover");
  system.load_client("mover", "mover");
  EXPECT_EQ(system.instance("mover").mode(), "drive");
}

TEST_P(State, AnExceptionLeadsToFailedFromEachMode) {
  for (const std::string mode : {"active", "neutral", "deactivated"}) {
    system.load_client("caller", "caller");
    system.state("caller", mode);
    ASSERT_EQ(system.instance("caller").mode(), mode);
    system.set("caller", "call=throw go=1");
    system.eventually("failed from " + mode, [&] { return system.instance("caller").mode() == "failed"; });
    EXPECT_EQ(system.instance("caller").reason(), "asked to throw") << mode;
    EXPECT_EQ(system.instance("mover").mode(), "drive") << "nobody else";
    system.unload("caller");
  }
}

class StateOfTheKilled : public State {};

TEST_P(StateOfTheKilled, TheEndOfAGroupLeadsToFailedFromEachMode) {
  for (const std::string mode : {"neutral", "deactivated"}) {
    system.load_client("mover", mode);
    system.state(mode, mode);
  }
  ::kill(system.far_process(), SIGKILL);
  for (const std::string name : {"mover", "neutral", "deactivated"}) {
    system.eventually(name + " has failed", [&] { return system.instance(name).mode() == "failed"; });
  }
}

TEST_P(State, UnloadJumpsTheQueueAndAnswersWhoWaitsInIt) {
  hold_steering();
  const auto change = system.begin_state("mover", "park");
  system.eventually("pending", [&] { return system.instance("mover").has_pending(); });
  system.unload("mover");
  system.eventually("answered", [&] { return change->ended.load(); });
  EXPECT_THAT(change->reply.failure().what(), HasSubstr("'mover' was unloaded")) << change->reply.ShortDebugString();
}

TEST_P(State, UnloadDoesNotWaitForAnActivity) {
  hold_steering();
  const auto start = std::chrono::steady_clock::now();
  system.unload("mover");
  EXPECT_LT(std::chrono::steady_clock::now() - start, 5s);
}

TEST_P(State, EveryPairOfModesOfALivingInstanceIsAllowed) {
  const std::vector<std::string> modes{"drive", "park", "rest", "neutral", "deactivated"};
  for (const auto& from : modes) {
    for (const auto& to : modes) {
      system.state("mover", from);
      system.state("mover", to);
      EXPECT_EQ(system.instance("mover").mode(), to) << "from " << from;
    }
  }
}

TEST_P(State, ModesThatNobodyMayAskForAreRefusedFromEachMode) {
  for (const std::string from : {"drive", "park", "rest", "neutral", "deactivated"}) {
    system.state("mover", from);
    for (const std::string to : {"init", "failed", "shutdown", "drift"}) {
      EXPECT_THAT(refusal_of(to), HasSubstr("cannot go from " + from + " to " + to));
      EXPECT_EQ(system.instance("mover").mode(), from);
    }
  }
}

TEST_P(State, NoModeIsLeftFailedFor) {
  EXPECT_EQ(system.call("mover.turn", "manner=throw").outcome(), "rejected");
  system.eventually("failed", [&] { return system.instance("mover").mode() == "failed"; });
  for (const std::string to :
       {"drive", "park", "rest", "neutral", "deactivated", "init", "failed", "shutdown", "drift"}) {
    EXPECT_THAT(refusal_of(to), HasSubstr("cannot go from failed to " + to));
    EXPECT_EQ(system.instance("mover").mode(), "failed");
  }
}

TEST_P(State, NoModeIsEnteredAfterShutdown) {
  system.unload("mover");
  for (const std::string to :
       {"drive", "park", "rest", "neutral", "deactivated", "init", "failed", "shutdown", "drift"}) {
    EXPECT_THAT(refusal_of(to), HasSubstr("mover")) << to;
  }
}

using StateOfAStart = State;

/// While its start takes long. A host that leads waits for those of others.
TEST_P(StateOfAStart, InInitModesThatNobodyMayAskForAreRefusedAndTheOthersQueueBehindTheLoad) {
  const auto loaded = system.begin_load_client("gauge", "slow", "start_ms=5000");
  system.eventually("it begins", [&] { return system.instance("slow").mode() == "init"; });
  for (const std::string to : {"init", "failed", "shutdown", "drift"}) {
    EXPECT_THAT(refusal_of(to, "slow"), HasSubstr("cannot go from init to " + to));
  }
  std::vector<std::shared_ptr<LaterAnswer>> asked;
  for (const std::string to : {"neutral", "active", "deactivated"}) asked.push_back(system.begin_state("slow", to));
  EXPECT_EQ(system.instance("slow").mode(), "init");
  EXPECT_FALSE(loaded->ended);
  for (const auto& one : asked) {
    system.eventually("answered", [&] { return one->ended.load(); });
    EXPECT_FALSE(one->reply.has_failure()) << one->reply.ShortDebugString();
  }
  EXPECT_TRUE(loaded->ended);
  EXPECT_EQ(system.instance("slow").mode(), "deactivated");
}

// ---- triggers (docs/patterns.md, Parameters) ------------------------------------------------------------------

class Triggers : public State {
 protected:
  int heading_of(const control::Called& called) {
    const auto result = system.system().types().make(called.result().type());
    result->ParseFromString(called.result().object());
    return result->GetReflection()->GetInt32(*result, result->GetDescriptor()->FindFieldByName("heading"));
  }
};

TEST_P(Triggers, RunsOnTheStrandAndTheCallerGetsARunIdAndTheResult) {
  const auto first = system.call("mover.turn", "degrees=30");
  const auto second = system.call("mover.turn", "degrees=12");
  EXPECT_EQ(first.outcome(), "ok") << first.reason();
  EXPECT_EQ(heading_of(first), 30);
  EXPECT_EQ(heading_of(second), 42);
  EXPECT_NE(first.run(), second.run());
}

TEST_P(Triggers, CoroutineAnswersLaterAndHoldsItsActivity) {
  system.load_provider("source", "source", "neutral");
  system.wire("mover.orders", "source.newest");
  EXPECT_EQ(heading_of(system.call("mover.turn_later", "degrees=7")), 7);
  load_gate();
  const auto turn = begin_held_turn();
  expect_held_by("trigger 'turn_later'");
  system.eventually("its answer", [&] { return turn->ended.load(); });
  EXPECT_EQ(heading_of(turn->reply.called()), 14);
}

TEST_P(Triggers, ErrorRejectsTheCallWithItsTextAndTheInstanceGoesOn) {
  const auto called = system.call("mover.turn", "manner=error");
  EXPECT_EQ(called.outcome(), "rejected");
  EXPECT_EQ(called.reason(), "the wheel is stuck");
  EXPECT_EQ(system.instance("mover").mode(), "drive");
}

TEST_P(Triggers, ExceptionFailsTheInstanceAndEndsTheCall) {
  const auto called = system.call("mover.turn", "manner=throw");
  EXPECT_EQ(called.outcome(), "rejected");
  system.eventually("it has failed", [&] { return system.instance("mover").mode() == "failed"; });
  EXPECT_EQ(system.instance("mover").reason(), "the wheel came off");
}

TEST_P(Triggers, OutsideOfItsActivityIsNotActive) {
  system.state("mover", "park");
  const auto called = system.call("mover.turn", "degrees=1");
  EXPECT_EQ(called.outcome(), "not_active");
  EXPECT_EQ(called.reason(), "mode park");
}

TEST_P(Triggers, ThatDoesNotAnswerInTimeIsTimeoutForItsCallerAndGoesOn) {
  load_gate();
  EXPECT_EQ(system.call("mover.turn_later", "degrees=7 manner=held", 100).outcome(), "timeout");
  open_gate();
  system.eventually("it has turned", [&] { return heading_of(system.call("mover.turn", "degrees=0")) == 7; });
}

TEST_P(Triggers, ArgumentOutsideItsRangeIsRefusedWithTheRule) {
  try {
    system.call("mover.turn", "degrees=200");
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_THAT(error.text().what, HasSubstr("degrees is 200, above 180"));
  }
}

TEST_P(Triggers, UnknownNameGetsTheNearest) {
  try {
    system.call("mover.trun");
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'mover' has no port or trigger 'trun'");
    EXPECT_EQ(error.text().near.front(), "turn");
  }
}

TEST_P(Triggers, QueryPortIsCalledByHandAndARequiredOneThroughItsWire) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "neutral");
  system.wire("asker.echo", "answerer.echo");
  EXPECT_EQ(system.call("answerer.echo", "number=5").outcome(), "ok");
  EXPECT_EQ(system.call("asker.echo", "number=5").outcome(), "ok");
  EXPECT_EQ(system.call("answerer.echo", "manner=never", 50).outcome(), "timeout");
}

TEST_P(Triggers, SendPortIsCalledByHand) {
  system.load_client("sink", "sink");
  EXPECT_EQ(system.call("sink.orders", "number=5").outcome(), "ok");
  system.eventually("handled", [&] { return system.port("sink.orders").messages() == 1; });
}

FIONA_OVER_EVERY_TRANSPORT(Triggers);

FIONA_OVER_EVERY_TRANSPORT(State);
FIONA_OVER_EVERY_TRANSPORT(StateOfHolders);
FIONA_OVER(StateOfAStart, Transport::Process, Transport::Ipc);
FIONA_OVER(StateOfTheKilled, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
