// What a call that waits returns, whatever ends it (docs/patterns.md, the table of pending calls), and events.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using testing::HasSubstr;

class Calls : public testing::TestWithParam<Transport> {
 protected:
  Calls() {
    system.load_client("caller", "caller");
    system.load_provider("source", "source", "neutral");
    system.load_provider("source", "quiet", "neutral");  // never puts, so that a wait for it waits
    system.load_provider("answerer", "answerer");
    system.load_provider("sink", "sink");
    outcomes = system.watch("caller.outcome");
  }

  /// Makes a call and does not wait for its end.
  void begin(const std::string& call, const std::string& parameters = "") {
    system.set("caller", "call=" + call + " go=" + std::to_string(++go) + (parameters.empty() ? "" : " " + parameters));
  }
  SeenSample end_of(unsigned number) {
    return system.wait_for(outcomes, [&](const SeenSample& one) { return one.number() == number; });
  }
  SeenSample end() { return end_of(go); }
  Outcome outcome() { return static_cast<Outcome>(static_cast<int>(end().value())); }
  Outcome outcome_of(const std::string& call, const std::string& parameters = "") {
    begin(call, parameters);
    return outcome();
  }
  void wire_all() {
    system.wire("caller.samples", "quiet.newest");
    system.wire("caller.echo", "answerer.echo");
    system.wire("caller.bell", "source.bell");
    system.wire("caller.handled_bell", "source.bell");
    system.wire("caller.orders", "sink.orders");
  }

  RunningSystem system{GetParam()};
  std::uint64_t outcomes = 0;
  unsigned go = 0;
};

// ---- the table ------------------------------------------------------------------------------------------------

TEST_P(Calls, WithoutAWireEndUnwiredAtOnce) {
  for (const std::string call : {"wait_update", "latest", "query", "activate", "send", "send_acknowledged"}) {
    EXPECT_EQ(outcome_of(call), Outcome::Unwired) << call;
  }
}

TEST_P(Calls, AreNotActiveInAModeThatDoesNotServeThePort) {
  wire_all();
  system.state("caller", "neutral");
  for (const std::string call : {"wait_update", "latest", "query", "activate", "send", "send_acknowledged"}) {
    EXPECT_EQ(outcome_of(call), Outcome::NotActive) << call;
  }
}

TEST_P(Calls, ThatWaitEndNotActiveWhenTheInstanceLeavesTheMode) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  for (const std::string call : {"wait_update", "query", "event"}) {
    begin(call, "manner=never");
    system.state("caller", "neutral");
    EXPECT_EQ(outcome(), Outcome::NotActive) << call;
    system.state("caller", "active");
  }
}

TEST_P(Calls, ThatWaitEndDisconnectedWhenThePortIsUnwired) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  begin("event");
  system.unwire("caller.bell");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "event";
  begin("query", "manner=never");
  system.unwire("caller.echo");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "query";
  begin("wait_update");
  system.unwire("caller.samples");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "wait_update";
}

TEST_P(Calls, ThatWaitEndDisconnectedWhenTheProviderIsUnloaded) {
  wire_all();
  begin("query", "manner=never");
  system.unload("answerer");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "query";
  begin("wait_update");
  system.unload("quiet");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "wait_update";
}

TEST_P(Calls, ThatWaitEndTimeoutAtTheirDeadline) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event", "deadline_ms=30"), Outcome::Timeout);
  EXPECT_EQ(outcome_of("query", "deadline_ms=30 manner=never"), Outcome::Timeout);
  EXPECT_EQ(outcome_of("wait_update", "deadline_ms=30"), Outcome::Timeout);
}

TEST_P(Calls, ThatWaitEndCancelledByEachOfTheThreeFlagsAndSoDoNewOnesUntilItIsTakenBack) {
  wire_all();
  for (const std::string flag : {"port", "pattern", "instance"}) {
    begin("wait_update");
    system.set("caller", "cancel=" + flag);
    EXPECT_EQ(outcome(), Outcome::Cancelled) << flag;
    EXPECT_EQ(outcome_of("query"), Outcome::Cancelled) << flag;
    system.set("caller", "cancel=none");
    EXPECT_EQ(outcome_of("query"), Outcome::Ok) << flag;
  }
}

TEST_P(Calls, CancelledReceiveLeavesTheIdValid) {
  wire_all();
  ASSERT_EQ(outcome_of("request", "manner=later"), Outcome::Ok);
  const unsigned asked = go;
  system.set("caller", "cancel=port");
  EXPECT_EQ(outcome_of("receive"), Outcome::Cancelled);
  system.set("caller", "cancel=none");
  begin("receive");
  EXPECT_EQ(end().payload(), std::to_string(asked));
}

TEST_P(Calls, ReceivedIdIsWrongTheSecondTime) {
  wire_all();
  ASSERT_EQ(outcome_of("request"), Outcome::Ok);
  EXPECT_EQ(outcome_of("receive"), Outcome::Ok);
  EXPECT_EQ(outcome_of("receive"), Outcome::WrongId);
}

TEST_P(Calls, WaitForAnUpdateGoesOnOnTheNewProviderWhenItIsRewired) {
  wire_all();
  system.load_provider("source", "second", "neutral period_ms=1 count=1");
  begin("wait_update");
  system.wire("caller.samples", "second.newest");
  system.state("second", "active");
  EXPECT_EQ(outcome(), Outcome::Ok);
}

TEST_P(Calls, OpenQueryFinishesOnTheOldProviderWhenItIsRewired) {
  wire_all();
  system.load_provider("answerer", "second");
  begin("query", "manner=later");
  system.wire("caller.echo", "second.echo");
  EXPECT_EQ(outcome(), Outcome::Ok);
  EXPECT_EQ(system.port("second.echo").messages(), 0U);
  EXPECT_EQ(outcome_of("query"), Outcome::Ok);
  EXPECT_EQ(system.port("second.echo").messages(), 1U);
}

TEST_P(Calls, OpenQueryOfAPortThatSaysSoEndsDisconnectedWhenItIsRewired) {
  system.wire("caller.failing_echo", "answerer.echo");
  system.load_provider("answerer", "second");
  begin("query_or_fail", "manner=never");
  system.wire("caller.failing_echo", "second.echo");
  EXPECT_EQ(outcome(), Outcome::Disconnected);
  EXPECT_EQ(outcome_of("query_or_fail", "manner=promptly"), Outcome::Ok);
}

TEST_P(Calls, RewireToAProviderInAnotherModeKeepsTheWireAndTellsNotActive) {
  wire_all();
  system.load_provider("answerer", "second", "neutral");
  system.wire("caller.echo", "second.echo");
  EXPECT_EQ(outcome_of("query"), Outcome::NotActive);
}

// ---- send -----------------------------------------------------------------------------------------------------

TEST_P(Calls, AcknowledgedSendEndsWhenTheProvidersHullHasIt) {
  wire_all();
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Ok);
  system.eventually("handled", [&] { return system.port("sink.orders").messages() == 1; });
}

TEST_P(Calls, AcknowledgedSendToAProviderThatIsNotActiveSaysSo) {
  wire_all();
  system.state("sink", "neutral");
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::NotActive);
  EXPECT_EQ(system.port("sink.orders").messages(), 0U);
}

// ---- event ----------------------------------------------------------------------------------------------------

TEST_P(Calls, ContinuousActivationDeliversEachEventInOrder) {
  wire_all();
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  const auto before = system.port("source.newest").messages();
  const auto first = system.wait_for(rings, [](const auto&) { return true; });
  EXPECT_GE(first.value(), static_cast<double>(before));
  const auto last = system.wait_for(rings, [](const auto& one) { return one.number() == 100; });
  EXPECT_EQ(last.value() - first.value(), 99) << "one for each state, none missing";
}

TEST_P(Calls, SingleActivationFiresOnce) {
  wire_all();
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=3 single=true"), Outcome::Ok);
  system.wait_for(rings, [](const auto& one) { return one.number() == 1; });
  const auto states_then = system.port("source.newest").messages();
  system.eventually("more states", [&] { return system.port("source.newest").messages() > states_then + 20; });
  EXPECT_EQ(system.port("caller.rings").messages(), 1U);
  ASSERT_EQ(outcome_of("activate", "every=1 single=true"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event"), Outcome::WrongId) << "it is over";
}

TEST_P(Calls, TestKeepsStateInItsOwnCopyOfTheActivation) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=3"), Outcome::Ok);
  for (const std::string seen : {"of 3", "of 6", "of 9"}) {
    begin("event");
    EXPECT_THAT(end().payload(), HasSubstr(seen));
  }
}

TEST_P(Calls, TestThatThrowsEndsThatActivationAloneAndSaysWhy) {
  wire_all();
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  const auto number = system.port("source.newest").messages() + 50;
  ASSERT_EQ(outcome_of("activate", "every=0 throw_at=" + std::to_string(number)), Outcome::Ok);
  begin("event", "every=1 throw_at=0");
  const auto ended = end();
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Rejected);
  EXPECT_THAT(ended.payload(), HasSubstr("asked to throw"));
  EXPECT_EQ(system.instance("source").mode(), "active");
  system.wait_for(rings, [&](const auto& one) { return one.value() > static_cast<double>(number) + 10; });
}

TEST_P(Calls, DeactivatedActivationFiresNoMore) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=1"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event"), Outcome::Ok);
  EXPECT_EQ(outcome_of("deactivate"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event"), Outcome::WrongId);
  EXPECT_EQ(outcome_of("deactivate"), Outcome::WrongId);
}

TEST_P(Calls, EventWaitGoesOnOnTheNewProviderWhenItIsRewired) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  system.unwire("caller.bell");
  EXPECT_EQ(outcome_of("event"), Outcome::Unwired);
  system.load_provider("source", "second");
  system.wire("caller.bell", "source.bell");
  begin("event");
  system.wire("caller.bell", "second.bell");
  begin("deactivate");
  EXPECT_EQ(static_cast<int>(end_of(go - 1).value()), static_cast<int>(Outcome::WrongId)) << "given up while it waited";
}

TEST_P(Calls, ActivationMovesToTheNewProvider) {
  wire_all();
  system.load_provider("source", "second");
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  system.wait_for(rings, [](const auto& one) { return one.number() == 1; });
  system.wire("caller.handled_bell", "second.bell");
  system.state("source", "neutral");
  const auto so_far = system.port("caller.rings").messages();
  system.eventually("events of the new provider", [&] { return system.port("caller.rings").messages() > so_far + 5; });
}

TEST_P(Calls, ActivationAtAProviderThatIsNotActiveIsNotMade) {
  wire_all();
  EXPECT_EQ(outcome_of("activate"), Outcome::NotActive);
}

INSTANTIATE_TEST_SUITE_P(Over, Calls, testing::Values(Transport::Process, Transport::Ipc, Transport::Tcp),
                         [](const auto& one) { return to_string(one.param); });

}  // namespace
}  // namespace fiona::conformance
