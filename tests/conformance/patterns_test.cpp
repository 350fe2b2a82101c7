// Sentences of docs/patterns.md, one after the other, each run over every transport.
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;

// A suite for each row of the table that is printed at the end; rules_test.cpp and the others have more of them.
using Rules = OverTransports;
using Send = OverTransports;
using Query = OverTransports;
using PushNewest = OverTransports;
using PushTimed = OverTransports;
using Wiring = OverTransports;

double value_of(Outcome outcome) { return static_cast<double>(outcome); }

/// For this; on a busy machine it may have been lost for a silence before.
void eventually_lost(RunningSystem& system, const std::string& port, const std::string& reason) {
  system.eventually(port + " is lost: " + reason, [&] {
    const auto now = system.port(port);
    return now.connection() == control::LOST && now.reason() == reason;
  });
}

/// The source begins then, puts its five, all of them for this port, and is silent from then on.
void wire_to_one_that_falls_silent(RunningSystem& system, const std::string& port) {
  system.wire(port, "source.leased");
  system.state("source", "active");
  system.eventually("all five have come", [&] { return system.port(port).messages() >= 5; });
  eventually_lost(system, port, "source.leased has been silent for 100 ms");
}

TEST_P(PushNewest, PushEachDeliversEveryMessageOnceInOrder) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=200");
  system.wire("sink.each", "source.newest");
  const auto report = system.watch("sink.report");
  system.eventually("connected", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
  system.state("source", "active");
  const auto last = system.wait_for(report, [](const auto& s) { return s.number() == 200; });
  EXPECT_EQ(last.value(), 200 * 201 / 2) << "the sum of the numbers 1 to 200: none lost, none twice";
}

TEST_P(PushNewest, PrescaleDeliversTheFirstPutAfterSubscribingThenEveryNth) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=100");
  system.wire("sink.each", "source.newest", 10);
  const auto report = system.watch("sink.report");
  system.eventually("connected", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
  system.state("source", "active");
  const auto last = system.wait_for(report, [](const auto& s) { return s.number() == 10; });
  EXPECT_EQ(last.value(), 1 + 11 + 21 + 31 + 41 + 51 + 61 + 71 + 81 + 91);
}

TEST_P(PushNewest, NewestSubscriptionKeepsOneValueAndCountsTheSuperseded) {
  system.load_client("sink", "sink", "work_ms=50");
  system.load_provider("source", "source", "neutral period_ms=1 count=300");
  system.wire("sink.newest", "source.newest");
  system.state("source", "active");
  system.eventually("superseded", [&] { return system.port("sink.newest").superseded() > 100; });
  EXPECT_LT(system.port("sink.newest").messages(), 60U);
  EXPECT_EQ(system.port("sink.newest").dropped(), 0U);
}

TEST_P(PushNewest, ServiceWithLastValueGivesItToALateSubscriber) {
  system.load_provider("source", "source", "period_ms=1 count=1");
  system.eventually("put", [&] { return system.port("source.last").messages() == 1; });
  system.load_client("sink", "sink");
  const auto report = system.watch("sink.report");
  system.wire("sink.last", "source.last");
  EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).value(), 1);
}

TEST_P(PushNewest, ServiceWithoutLastValueGivesALateSubscriberNothing) {
  system.load_provider("source", "source", "period_ms=1 count=1");
  system.eventually("put", [&] { return system.port("source.newest").messages() == 1; });
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("connected", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
  EXPECT_EQ(system.port("sink.each").messages(), 0U);
}

TEST_P(PushTimed, PushTimedProducesOnceAPeriodWhileActive) {
  constexpr double kPeriod_ms = 20;
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "count=1");
  system.wire("sink.timed", "source.timed");
  const auto missed_then = system.read("source.timed.overruns").value();
  const auto produced = system.watch("source.timed");
  const auto first = system.wait_for(produced, [](const auto&) { return true; });
  const auto last = system.wait_for(produced, [&](const auto& one) { return one.counted >= first.counted + 25; });
  // Those that it was too late for have passed all the same.
  const double periods = static_cast<double>(last.counted - first.counted);
  const double most = periods + system.read("source.timed.overruns").value() - missed_then;
  const double took_ms = static_cast<double>(last.sent_ns() - first.sent_ns()) / 1e6;
  EXPECT_GT(took_ms, kPeriod_ms * periods / 2) << "by its own clock";
  EXPECT_LT(took_ms, kPeriod_ms * most * 2) << "by its own clock";
  system.eventually("they arrive", [&] { return system.port("sink.timed").messages() >= 10; });
  system.state("source", "neutral");
  const auto runs = system.instance("source").tasks(0).runs();
  system.load_provider("source", "clockwork", "period_ms=1 count=100");
  system.eventually("time has passed", [&] { return system.port("clockwork.newest").messages() == 100; });
  EXPECT_EQ(system.instance("source").tasks(0).runs(), runs);
}

/// On a clock that waits for all that has to be done, and so exactly.
TEST(PushTimedVirtual, ProducesOnceAPeriodWhileActiveToTheInstant) {
  RunningSystem system(2, 20s);
  system.set("host", "clock=virtual");
  system.load_in("", "source", "source", "count=1");
  system.load_in("", "sink", "sink");
  system.wire("sink.timed", "source.timed");
  EXPECT_TRUE(system.let_pass(5ms).has_met());
  const auto before = system.port("sink.timed").messages();
  EXPECT_TRUE(system.let_pass(1000ms).has_met());
  EXPECT_EQ(system.port("sink.timed").messages(), before + 50) << "the period is 20 ms";
  system.state("source", "neutral");
  EXPECT_TRUE(system.let_pass(1000ms).has_met());
  EXPECT_EQ(system.port("sink.timed").messages(), before + 50);
}

TEST_P(PushNewest, LatestDoesNotConsume) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=5");
  const auto report = system.watch("sink.latest_report");
  system.wire("sink.latest", "source.newest");
  system.eventually("connected", [&] { return system.port("sink.latest").connection() == control::CONNECTED; });
  system.state("source", "active");
  system.wait_for(report, [](const auto& s) { return s.number() == 5; });
  EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).number(), 5U) << "read again, the same value";
}

TEST_P(PushNewest, LatestKeepsTheOldValueMarkedStaleUntilTheNewProviderSpeaks) {
  system.load_client("sink", "sink");
  system.load_provider("source", "first", "neutral period_ms=1 count=5");
  system.load_provider("source", "second", "neutral period_ms=1 count=7");
  const auto report = system.watch("sink.latest_report");
  system.wire("sink.latest", "first.newest");
  system.eventually("connected", [&] { return system.port("sink.latest").connection() == control::CONNECTED; });
  system.state("first", "active");
  system.wait_for(report, [](const auto& s) { return s.number() == 5 && s.value() == 0; });
  system.wire("sink.latest", "second.newest");
  system.wait_for(report, [](const auto& s) { return s.number() == 5 && s.value() == 1; });
  system.state("second", "active");
  bool speaks = false;
  const auto last = system.wait_for(report, [&](const auto& s) {
    EXPECT_FALSE(speaks && s.value() == 1) << "stale again, at " << s.number();
    speaks = s.value() == 0;
    return s.number() == 7;
  });
  EXPECT_EQ(last.value(), 0) << "what the new one has said is not stale";
}

TEST_P(PushNewest, ProviderThatIsSilentForLongerThanItsLeaseIsLostAndFoundAtItsNextPut) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=5");
  wire_to_one_that_falls_silent(system, "sink.leased");
  system.set("source", "count=0");
  system.state("source", "neutral");
  system.state("source", "active");
  system.eventually("found", [&] { return system.port("sink.leased").connection() == control::CONNECTED; });
}

TEST_P(PushNewest, ProviderThatIsSilentAndThenLeavesItsModeIsLostForThat) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "period_ms=1 count=5");
  system.wire("sink.leased", "source.leased");
  system.eventually("lost", [&] { return system.port("sink.leased").connection() == control::LOST; });
  system.state("source", "neutral");
  system.eventually("for another reason",
                    [&] { return system.port("sink.leased").reason() == "source.leased is not active"; });
  EXPECT_EQ(system.port("sink.leased").connection(), control::LOST);
}

TEST_P(PushNewest, ProviderThatNeverWasActiveIsLostFromTheStart) {
  system.load_provider("source", "idle", "neutral");
  system.load_client("sink", "late");
  system.wire("late.leased", "idle.leased");
  eventually_lost(system, "late.leased", "idle.leased is not active");
  system.state("idle", "active");
  system.eventually("found", [&] { return system.port("late.leased").connection() == control::CONNECTED; });
}

TEST_P(PushNewest, LeaseIsRenewedByStillValidAndNotByTheHull) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "period_ms=1 count=5 vouch=true");
  system.wire("sink.leased", "source.leased");
  system.load_provider("source", "clockwork", "period_ms=10 count=60");
  system.eventually("600 ms have passed", [&] { return system.port("clockwork.newest").messages() == 60; });
  // Of a busy machine it may be late, and is renewed all the same.
  system.eventually("connected", [&] { return system.port("sink.leased").connection() == control::CONNECTED; });
  EXPECT_LT(system.port("sink.leased").messages(), 15U) << "of some 20 still_valid() few come after a silence";
  system.set("source", "vouch=false");
  system.eventually("lost", [&] { return system.port("sink.leased").connection() == control::LOST; });
}

TEST_P(PushNewest, LastValueThatIsStillValidAfterASilenceIsGivenAgainAlsoToWhoCameMeanwhile) {
  system.load_client("sink", "first");
  system.load_client("sink", "late");
  system.load_provider("source", "source", "neutral period_ms=1 count=5");
  wire_to_one_that_falls_silent(system, "first.leased");
  system.wire("late.leased", "source.leased");
  system.eventually("lost", [&] { return system.port("late.leased").connection() == control::LOST; });
  EXPECT_EQ(system.port("late.leased").messages(), 0U);
  const auto before = system.port("first.leased").messages();
  const auto report = system.watch("late.report");
  system.set("source", "vouch=true");
  EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).value(), 5) << "the last one";
  system.eventually("given again", [&] { return system.port("first.leased").messages() > before; });
}

TEST_P(PushNewest, ProviderThatLeavesItsModeIsLostToItsSubscribersAtOnce) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source");
  system.wire("sink.leased", "source.leased");
  system.state("source", "neutral");
  eventually_lost(system, "sink.leased", "source.leased is not active");
}

TEST_P(PushNewest, LateSubscriberToASilentProviderIsToldSoAndGetsNoValueUntilItSpeaks) {
  system.load_provider("source", "source", "neutral period_ms=1 count=5");
  system.load_client("sink", "first");
  wire_to_one_that_falls_silent(system, "first.leased");
  system.load_client("sink", "late");
  const auto report = system.watch("late.report");
  system.wire("late.leased", "source.leased");
  system.eventually("lost", [&] { return system.port("late.leased").connection() == control::LOST; });
  EXPECT_EQ(system.port("late.leased").messages(), 0U);
  system.set("source", "count=6");
  system.state("source", "neutral");
  system.state("source", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).value(), 6)
      << "the first value that it gets is the next one";
}

TEST_P(Query, QueryGetsItsAnswer) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "period_ms=20 payload=1000");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  const auto report = system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Ok); });
  EXPECT_EQ(report.payload(), "1000");
}

TEST_P(Query, ProviderMayAnswerLater) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "manner=later period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Ok); });
}

TEST_P(Query, ReplyDroppedWithoutAnswerIsRejectedNoAnswer) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "manner=drop period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  const auto report = system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Rejected); });
  EXPECT_EQ(report.payload(), "no answer");
}

TEST_P(Query, RefusalCarriesItsReason) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "manner=error period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  const auto report = system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Rejected); });
  EXPECT_EQ(report.payload(), "asked to refuse");
}

TEST_P(Query, QueryEndsAtItsDeadline) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "neutral manner=never count=3");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.state("asker", "active");
  system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Timeout); });
}

TEST_P(Query, QueryOnAPortWithoutWireIsUnwired) {
  system.load_client("asker", "asker", "period_ms=10");
  const auto outcome = system.watch("asker.outcome");
  EXPECT_EQ(system.wait_for(outcome, [](const auto&) { return true; }).value(), value_of(Outcome::Unwired));
}

TEST_P(Query, PendingQueryEndsDisconnectedWhenTheWireIsCut) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "manner=never period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.eventually("asked", [&] { return system.port("answerer.echo").messages() >= 1; });
  system.unwire("asker.echo");
  system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::Disconnected); });
}

TEST_P(Query, ProviderOutsideItsModeAnswersNotActiveAtOnce) {
  system.load_provider("answerer", "answerer");
  system.state("answerer", "neutral");
  system.load_client("asker", "asker", "period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.wait_for(outcome, [](const auto& s) { return s.value() == value_of(Outcome::NotActive); });
}

TEST_P(Send, SendReachesTheReceiverInOrder) {
  system.load_client("sink", "receiver");
  system.load_provider("source", "sender", "neutral period_ms=1 count=100");
  const auto report = system.watch("receiver.report");
  system.wire("sender.orders", "receiver.orders");
  system.eventually("connected", [&] { return system.port("sender.orders").connection() == control::CONNECTED; });
  system.state("sender", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() == 100; }).value(), 5050);
}

TEST_P(Rules, HandlerThatThrowsFailsItsInstanceAndNobodyElse) {
  system.load_provider("source", "source", "period_ms=1");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.set("source", "fail_with=broken");
  system.eventually("failed", [&] { return system.instance("source").mode() == "failed"; });
  EXPECT_EQ(system.instance("source").reason(), "broken");
  EXPECT_EQ(system.instance("sink").mode(), "active");
}

TEST_P(Rules, OneMebibyteArrivesWhole) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "period_ms=5 payload=1048576");
  const auto report = system.watch("sink.report");
  system.wire("sink.each", "source.newest");
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).payload(), "1048576");
  }
}

TEST_P(Wiring, UnloadingAProviderSaysWhoWaitsForIt) {
  system.load_provider("source", "source");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  control::Change change;
  change.mutable_unload()->set_instance("source");
  EXPECT_EQ(system.system().perform(change).note(), "unloaded source; waiting for it: sink.each");
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
  EXPECT_EQ(system.port("sink.each").reason(), "there is no instance 'source' yet");
}

TEST_P(Wiring, WireWaitsForItsProviderAndResolvesWhenThatAppears) {
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  EXPECT_EQ(system.instance("sink").mode(), "active");
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
  EXPECT_EQ(system.port("sink.each").peer().instance(), "source");
  const auto report = system.watch("sink.report");
  system.load_provider("source", "source");
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  EXPECT_EQ(system.wait_for(report, [](const auto&) { return true; }).number(), 1U);
}

TEST_P(Wiring, WireThatWaitsGoesOnWithAnotherInstanceOfTheName) {
  system.load_provider("source", "source");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.unload("source");
  system.load_provider("source", "source");
  const auto before = system.port("sink.each").messages();
  system.eventually("goes on", [&] { return system.port("sink.each").messages() > before + 2; });
}

TEST_P(Wiring, InstanceThatDoesNotFitAWireThatWaitsForItsNameIsRefused) {
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.timed");
  try {
    system.load_provider("source", "source");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::WiringInvalid);
    EXPECT_EQ(error.text().what,
              "a wire waits for 'source' and does not fit it: sink.each requires SampleNewest (push newest, Sample); "
              "source.timed provides SampleTimed (push timed, Sample)");
  }
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
}

FIONA_OVER_EVERY_TRANSPORT(Rules);
FIONA_OVER_EVERY_TRANSPORT(Send);
FIONA_OVER_EVERY_TRANSPORT(Query);
FIONA_OVER_EVERY_TRANSPORT(PushNewest);
FIONA_OVER_EVERY_TRANSPORT(PushTimed);
FIONA_OVER_EVERY_TRANSPORT(Wiring);

}  // namespace
}  // namespace fiona::conformance
