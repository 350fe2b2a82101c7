// What a call that waits returns, whatever ends it (docs/patterns.md, the table of pending calls), and events.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

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
  static Outcome outcome_in(const SeenSample& one) { return static_cast<Outcome>(static_cast<int>(one.value())); }
  Outcome outcome() { return outcome_in(end()); }
  Outcome outcome_of(const std::string& call, const std::string& parameters = "") {
    begin(call, parameters);
    return outcome();
  }
  /// Not ended before its time, and not long after it: how busy the machine is, no test is about.
  static void expect_took(std::chrono::nanoseconds took, std::chrono::milliseconds deadline) {
    EXPECT_GE(took, deadline - 10ms);
    EXPECT_LT(took, deadline + 5s);
  }
  /// It goes on to put states, and puts none of them to an activation any more.
  void eventually_lets_go(const std::string& source) {
    system.eventually(source + " lets go of its activations", [&] {
      const double tested = system.read(source + ".tested").value();
      const auto put = system.port(source + ".newest").messages();
      system.eventually("more states", [&] { return system.port(source + ".newest").messages() > put + 10; });
      return system.read(source + ".tested").value() == tested;
    });
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

// Suites of their own for the table that is printed at the end.
using QueryCalls = Calls;
using SendCalls = Calls;
using Event = Calls;

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
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  begin("event");
  system.unload("source");
  EXPECT_EQ(outcome(), Outcome::Disconnected) << "event";
}

TEST_P(Calls, ThatNameNoDeadlineEndAfterTwoSeconds) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  ASSERT_EQ(outcome_of("request", "manner=never"), Outcome::Ok);
  const unsigned before = go;
  std::set<std::uint64_t> ended;
  const auto begun = std::chrono::steady_clock::now();
  for (const std::string call : {"query_by_default", "receive_by_default", "event_by_default"}) begin(call);
  while (ended.size() < 3) {
    const SeenSample one = system.wait_for(outcomes, [&](const auto& any) { return any.number() > before; });
    EXPECT_EQ(static_cast<Outcome>(static_cast<int>(one.value())), Outcome::Timeout) << one.number();
    ended.insert(one.number());
    expect_took(std::chrono::steady_clock::now() - begun, 2000ms);
  }
}

TEST_P(Calls, ToAProviderThatHangsInItsHandlerEndAtTheirDeadline) {
  wire_all();
  begin("query", "manner=stand");
  const unsigned first = go;
  system.eventually("it hangs", [&] { return system.port("answerer.echo").messages() == 1; });
  EXPECT_EQ(outcome_of("query", "deadline_ms=30 manner=promptly"), Outcome::Timeout);
  EXPECT_EQ(outcome_in(end_of(first)), Outcome::Ok) << "it hung for longer";
}

// ---- latest, which does not wait ------------------------------------------------------------------------------

TEST_P(Calls, LatestIsNoDataUntilSomethingComesAndThenThatWithItsAge) {
  wire_all();
  EXPECT_EQ(outcome_of("latest"), Outcome::NoData);
  system.set("quiet", "count=1");
  system.state("quiet", "active");
  system.eventually("put", [&] { return system.port("caller.samples").messages() == 1; });
  system.set("source", "period_ms=10 count=10");
  system.state("source", "active");
  system.eventually("100 ms have passed", [&] { return system.port("source.newest").messages() == 10; });
  begin("latest");
  const auto seen = end().payload();
  EXPECT_EQ(seen.substr(0, 2), "1 ") << "not stale";
  EXPECT_GE(std::stoi(seen.substr(2)), 80);
  EXPECT_LT(std::stoi(seen.substr(2)), 10'000);
}

TEST_P(Calls, LatestIsNotCancelledForItDoesNotWait) {
  wire_all();
  for (const std::string flag : {"port", "pattern", "instance"})
    EXPECT_EQ(outcome_of("latest", "cancel=" + flag), Outcome::NoData) << flag;
}

TEST_P(Calls, LatestIsUnwiredAndTheSlotEmptyOnceThePortIsUnwired) {
  wire_all();
  system.set("quiet", "count=1");
  system.state("quiet", "active");
  system.eventually("put", [&] { return system.port("caller.samples").messages() == 1; });
  EXPECT_EQ(outcome_of("latest"), Outcome::Ok);
  system.unwire("caller.samples");
  EXPECT_EQ(outcome_of("latest"), Outcome::Unwired);
  system.wire("caller.samples", "quiet.newest");
  EXPECT_EQ(outcome_of("latest"), Outcome::NoData) << "what came over the wire before is not this one's";
}

TEST_P(Calls, LatestIsNoDataWhileThePortWaitsForAProviderThatWasUnloadedAndNeverAnOldValue) {
  wire_all();
  system.set("quiet", "count=1");
  system.state("quiet", "active");
  system.eventually("put", [&] { return system.port("caller.samples").messages() == 1; });
  EXPECT_EQ(outcome_of("latest"), Outcome::Ok);
  system.unload("quiet");
  EXPECT_EQ(outcome_of("latest"), Outcome::NoData);
}

TEST_P(Calls, LatestIsDisconnectedWhenTheProviderHangsOrIsSilentForLongerThanItsLease) {
  system.wire("caller.leased", "source.leased");
  system.state("source", "active");
  system.eventually("put", [&] { return outcome_of("latest_leased") == Outcome::Ok; });
  system.set("source", "hang_ms=2000");
  system.eventually(
      "lost", [&] { return system.port("caller.leased").connection() == control::LOST; },
      std::chrono::milliseconds(1900));
  // It hangs again and again, and puts between.
  system.eventually("disconnected", [&] { return outcome_of("latest_leased") == Outcome::Disconnected; });
}

// ---- what waits, and how it ends ------------------------------------------------------------------------------

TEST_P(Calls, ThatWaitEndTimeoutAtTheirDeadline) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  for (const std::string call : {"event", "query", "wait_update"}) {
    const auto begun = std::chrono::steady_clock::now();
    EXPECT_EQ(outcome_of(call, "deadline_ms=200 manner=never"), Outcome::Timeout) << call;
    expect_took(std::chrono::steady_clock::now() - begun, 200ms);
  }
  ASSERT_EQ(outcome_of("request", "deadline_ms=10000"), Outcome::Ok);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_EQ(outcome_of("receive", "deadline_ms=200"), Outcome::Timeout);
  expect_took(std::chrono::steady_clock::now() - begun, 200ms);
}

TEST_P(Calls, ThatWaitEndCancelledByEachOfTheThreeFlagsAndSoDoNewOnesUntilItIsTakenBack) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  for (const std::string flag : {"port", "pattern", "instance"}) {
    for (const std::string call : {"wait_update", "query", "event"}) {
      begin(call, "manner=never");
      system.set("caller", "cancel=" + flag);
      EXPECT_EQ(outcome(), Outcome::Cancelled) << call << ", " << flag;
      EXPECT_EQ(outcome_of(call), Outcome::Cancelled) << "a new " << call << ", " << flag;
      EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Cancelled) << flag;
      EXPECT_EQ(outcome_of("send"), Outcome::Cancelled) << flag;
      EXPECT_EQ(outcome_of("request"), Outcome::Cancelled) << flag;
      EXPECT_EQ(outcome_of("activate"), Outcome::Cancelled) << flag;
      system.set("caller", "cancel=none");
    }
    EXPECT_EQ(outcome_of("query", "manner=promptly"), Outcome::Ok) << flag;
    EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Ok) << flag;
  }
  EXPECT_EQ(outcome_of("deactivate"), Outcome::Ok);
  eventually_lets_go("source");
}

TEST_P(Calls, AFlagOfOnePortOrOnePatternEndsNoCallOfAnother) {
  const std::map<std::string, std::set<std::string>> ended_by{{"samples", {"wait_update"}},
                                                              {"echo", {"query"}},
                                                              {"bell", {"event"}},
                                                              {"orders", {"send", "send_acknowledged"}},
                                                              {"PUSH_NEWEST", {"wait_update"}},
                                                              {"QUERY", {"query", "query_or_fail"}},
                                                              {"EVENT", {"event", "activate_handled"}},
                                                              {"SEND", {"send", "send_acknowledged"}}};
  wire_all();
  system.wire("caller.failing_echo", "answerer.echo");
  system.state("source", "active");
  for (const auto& [flag, calls] : ended_by) {
    ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
    std::map<std::uint64_t, std::string> waiting;
    for (const std::string call : {"wait_update", "query", "query_or_fail", "event"}) {
      begin(call, "manner=never deadline_ms=60000");
      waiting[go] = call;
    }
    system.set("caller", "cancel=" + flag);
    std::set<std::string> ended;
    for (const std::string call :
         {"wait_update", "query", "query_or_fail", "activate_handled", "send", "send_acknowledged"}) {
      const bool times_out = call == "wait_update";
      begin(call, times_out ? "deadline_ms=1" : "manner=promptly deadline_ms=60000");
      const auto one = system.wait_for(outcomes, [&](const SeenSample& any) {
        if (outcome_in(any) == Outcome::Cancelled && waiting.contains(any.number()))
          ended.insert(waiting.at(any.number()));
        return any.number() == go;
      });
      const auto otherwise = times_out ? Outcome::Timeout : Outcome::Ok;
      EXPECT_EQ(outcome_in(one), calls.contains(call) ? Outcome::Cancelled : otherwise) << call << ", " << flag;
    }
    for (const auto& [number, call] : waiting)
      EXPECT_EQ(ended.contains(call), calls.contains(call)) << call << ", " << flag;
    system.state("caller", "neutral");
    for (std::size_t left = waiting.size() - ended.size(); left > 0; --left) {
      const auto one = system.wait_for(outcomes, [](const auto&) { return true; });
      EXPECT_EQ(outcome_in(one), Outcome::NotActive) << waiting[one.number()] << ", " << flag;
    }
    system.set("caller", "cancel=none");
    system.state("caller", "active");
  }
}

TEST_P(QueryCalls, CancelledReceiveLeavesTheIdValid) {
  wire_all();
  ASSERT_EQ(outcome_of("request", "manner=never"), Outcome::Ok);
  const unsigned asked = go;
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  for (const std::string flag : {"port", "pattern", "instance"}) {
    begin("receive");
    system.set("caller", "cancel=" + flag);
    EXPECT_EQ(outcome(), Outcome::Cancelled) << flag;
    EXPECT_EQ(outcome_of("receive"), Outcome::Cancelled) << "a new one, " << flag;
    system.set("caller", "cancel=none");
  }
  EXPECT_EQ(system.read("answerer.abandoned").value(), 0) << "it is still wanted";
  begin("receive");
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  EXPECT_EQ(end().payload(), std::to_string(asked));
}

TEST_P(QueryCalls, ReceiveWhoseDeadlineHasPassedLeavesTheIdValidUntilItIsReceivedOrDiscarded) {
  wire_all();
  const auto begin_request = [&](double open) {
    ASSERT_EQ(outcome_of("request", "manner=never deadline_ms=100000"), Outcome::Ok);
    system.eventually("it is kept", [&] { return system.read("answerer.open").value() == open; });
    EXPECT_EQ(outcome_of("receive", "deadline_ms=50"), Outcome::Timeout);
  };
  begin_request(1);
  const unsigned asked = go - 1;
  EXPECT_EQ(system.read("answerer.abandoned").value(), 0) << "it is still wanted";
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  begin("receive", "deadline_ms=100000");
  EXPECT_EQ(end().payload(), std::to_string(asked));
  begin_request(1);
  EXPECT_EQ(outcome_of("discard"), Outcome::Ok);
  EXPECT_EQ(outcome_of("receive"), Outcome::WrongId);
}

TEST_P(QueryCalls, ReplyThatIsKeptAndDroppedLaterAnswersSo) {
  wire_all();
  begin("query", "manner=never");
  const unsigned open = go;
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  begin("query", "manner=promptly");
  EXPECT_EQ(system.wait_for(outcomes, [](const auto&) { return true; }).number(), go) << "the open one has not ended";
  EXPECT_EQ(system.call("answerer.echo", "manner=forget").outcome(), "ok");
  const SeenSample ended = end_of(open);
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Rejected);
  EXPECT_EQ(ended.payload(), "no answer");
}

TEST_P(QueryCalls, ProviderIsToldOfEachRequestThatItsClientGaveUp) {
  wire_all();
  int given_up = 0;
  const auto begin_open = [&] {
    begin("query", "manner=never");
    system.eventually("it is kept", [&] { return system.read("answerer.open").value() == given_up + 1; });
    EXPECT_EQ(system.read("answerer.abandoned").value(), given_up);
  };
  const auto expect_told = [&](const std::string& why) {
    ++given_up;
    system.eventually("told: " + why, [&] { return system.read("answerer.abandoned").value() == given_up; });
  };
  for (const std::string flag : {"port", "pattern", "instance"}) {
    begin_open();
    system.set("caller", "cancel=" + flag);
    EXPECT_EQ(outcome(), Outcome::Cancelled) << flag;
    expect_told(flag);
    system.set("caller", "cancel=none");
  }
  for (const std::string mode : {"neutral", "deactivated"}) {
    begin_open();
    system.state("caller", mode);
    EXPECT_EQ(outcome(), mode == "neutral" ? Outcome::NotActive : Outcome::Cancelled);
    expect_told(mode);
    system.state("caller", "active");
  }
}

TEST_P(QueryCalls, ManyRequestsMayBeOpenAndAnswersComeInAnyOrder) {
  wire_all();
  std::vector<unsigned> open;
  for (int i = 0; i < 3; ++i) {
    begin("query", "manner=never");
    open.push_back(go);
  }
  system.eventually("they are kept", [&] { return system.read("answerer.open").value() == 3; });
  begin("query", "manner=promptly");
  EXPECT_EQ(system.wait_for(outcomes, [](const auto&) { return true; }).number(), go) << "the last one first";
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  for (const unsigned one : open) EXPECT_EQ(end_of(one).payload(), std::to_string(one));
}

TEST_P(QueryCalls, HandlerThatThrowsAnythingButAnErrorFailsItsInstanceAndEndsTheQuery) {
  wire_all();
  begin("query", "manner=throw");
  const SeenSample ended = end();
  EXPECT_EQ(outcome_in(ended), Outcome::Rejected);
  EXPECT_EQ(ended.payload(), "the provider failed while it handled this");
  system.eventually("failed", [&] { return system.instance("answerer").mode() == "failed"; });
  EXPECT_EQ(system.instance("answerer").reason(), "asked to throw");
}

TEST_P(QueryCalls, HandlerThatThrowsTextThatIsNoUtf8FailsItsInstanceReadablyAndHurtsNobodyElse) {
  system.load_provider("answerer", "latin");
  system.load_provider("source", "neighbour");
  system.wire("caller.echo", "latin.echo");
  EXPECT_EQ(outcome_of("query", "manner=latin"), Outcome::Rejected);
  system.eventually("failed", [&] { return system.instance("latin").mode() == "failed"; });
  EXPECT_EQ(system.instance("latin").reason(), "Stra\ufffde");
  const auto put_then = system.port("neighbour.newest").messages();
  system.eventually("it lives on", [&] { return system.port("neighbour.newest").messages() > put_then; });
}

TEST_P(QueryCalls, ReasonThatIsTooLongIsCutAtACharacterAndTheNextAnswerComes) {
  system.wire("caller.echo", "answerer.echo");
  begin("query", "manner=long");
  const std::string reason = end().payload();
  const std::size_t most = GetParam() == Transport::Process ? 5000 : 2047;
  ASSERT_EQ(reason.size(), 1 + 2 * most);
  EXPECT_EQ(reason.substr(reason.size() - 2), "\u00fc");
  EXPECT_EQ(outcome_of("query", "manner=promptly"), Outcome::Ok);
}

TEST_P(QueryCalls, ReceivedIdIsWrongTheSecondTime) {
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
  begin("query", "manner=never");
  const unsigned open = go;
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  EXPECT_EQ(system.wire("caller.echo", "second.echo").redirected(), 0U);
  begin("query", "manner=promptly");
  EXPECT_EQ(system.wait_for(outcomes, [](const auto&) { return true; }).number(), go) << "the open one has not ended";
  EXPECT_EQ(system.port("second.echo").messages(), 1U);
  EXPECT_EQ(system.read("answerer.abandoned").value(), 0);
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  const SeenSample ended = end_of(open);
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Ok);
  EXPECT_EQ(ended.payload(), std::to_string(open));
  EXPECT_EQ(system.port("second.echo").messages(), 1U);
}

TEST_P(Calls, OpenQueryThatIsToFinishOnTheOldProviderEndsDisconnectedWhenThatIsUnloaded) {
  wire_all();
  system.load_provider("answerer", "second");
  begin("query", "manner=never");
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  system.wire("caller.echo", "second.echo");
  system.unload("answerer");
  EXPECT_EQ(outcome(), Outcome::Disconnected);
}

TEST_P(Calls, ThatWaitEndDisconnectedWhenTheProviderHasFailed) {
  wire_all();
  system.wire("caller.samples", "source.newest");
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  begin("event");
  system.set("source", "fail_with=broken");
  EXPECT_EQ(outcome(), Outcome::Disconnected);
  for (const std::string port : {"caller.bell", "caller.samples"}) {
    system.eventually("lost", [&] { return system.port(port).connection() == control::LOST; });
    EXPECT_THAT(system.port(port).reason(), HasSubstr("has failed"));
  }
  EXPECT_EQ(outcome_of("latest"), Outcome::Disconnected);
  try {
    system.unwire("caller.samples");
    system.wire("caller.samples", "source.newest");
    ADD_FAILURE() << "wired";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'source' has failed: broken");
    EXPECT_EQ(error.text().next, "unload source, then load it again");
  }
  control::Change back;
  *back.mutable_wire()->mutable_client() = port_name("caller.samples");
  *back.mutable_wire()->mutable_provider() = port_name("source.newest");
  system.system().perform(back, true);
  EXPECT_EQ(system.port("caller.samples").connection(), control::WAITING);
}

TEST_P(Calls, WiresOfAClientThatHasFailedAreLost) {
  wire_all();
  system.wire("caller.samples", "source.newest");
  begin("throw");
  for (const std::string port : {"caller.echo", "caller.bell", "caller.samples"}) {
    system.eventually(port + " is lost", [&] { return system.port(port).connection() == control::LOST; });
    EXPECT_EQ(system.port(port).reason(), "'caller' has failed: asked to throw");
  }
  try {
    system.unwire("caller.samples");
    system.wire("caller.samples", "source.newest");
    ADD_FAILURE() << "wired";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'caller' has failed: asked to throw");
    EXPECT_EQ(error.text().next, "unload caller, then load it again");
  }
}

TEST_P(Calls, AlternativesOfAQueryServeWhenTheFirstHasFailed) {
  system.load_provider("answerer", "second");
  system.wire_to_several("caller.echo", {"answerer.echo", "second.echo"});
  ASSERT_EQ(outcome_of("query", "manner=promptly"), Outcome::Ok);
  EXPECT_NE(outcome_of("query", "manner=throw"), Outcome::Ok);
  system.eventually("the next one serves", [&] { return outcome_of("query", "manner=promptly") == Outcome::Ok; });
  EXPECT_EQ(system.port("second.echo").messages(), 1U);
}

TEST_P(Calls, WaitForAnUpdateGoesOnAndLatestIsStaleWhenAnAlternativeServes) {
  system.load_provider("source", "first", "period_ms=1");
  system.wire_to_several("caller.samples", {"first.newest", "source.newest"}, 0);
  const auto latest = [&] {
    begin("latest");
    return end().payload();
  };
  system.eventually("it is heard", [&] { return outcome_of("latest") == Outcome::Ok; });
  system.set("first", "count=1");  // it puts no more
  const auto last = std::to_string(system.port("first.newest").messages());
  system.eventually("its last", [&] { return latest().starts_with(last + " "); });
  EXPECT_THAT(latest(), Not(HasSubstr("stale")));
  begin("wait_update", "deadline_ms=60000");
  const unsigned waits = go;
  system.unload("first");
  system.eventually("the other one serves",
                    [&] { return system.read("caller.samples.serving").payload() == "source.newest"; });
  begin("latest");
  const auto kept = system.wait_for(outcomes, [](const auto&) { return true; });
  EXPECT_EQ(kept.number(), go) << "the wait has not ended";
  EXPECT_THAT(kept.payload(), StartsWith(last + " stale "));
  system.state("source", "active");
  const auto updated = end_of(waits);
  EXPECT_EQ(outcome_in(updated), Outcome::Ok);
  EXPECT_EQ(updated.payload(), "1");
  EXPECT_THAT(latest(), Not(HasSubstr("stale")));
}

TEST_P(Calls, OpenQueryEndsDisconnectedWhenItsProviderIsKilledThoughAnAlternativeServes) {
  system.load_in("red", "answerer", "first");
  system.wire_to_several("caller.echo", {"first.echo", "answerer.echo"}, 0);
  system.eventually("it serves", [&] { return system.read("caller.echo.serving").payload() == "first.echo"; });
  begin("query", "manner=never deadline_ms=60000");
  system.eventually("it is kept", [&] { return system.read("first.open").value() == 1; });
  ::kill(system.group("red").process(), SIGKILL);
  EXPECT_EQ(outcome(), Outcome::Disconnected);
  system.eventually("the other one answers", [&] { return outcome_of("query", "manner=promptly") == Outcome::Ok; });
}

TEST_P(Calls, OpenQueryOfAPortThatSaysSoEndsDisconnectedWhenItIsRewired) {
  system.wire("caller.failing_echo", "answerer.echo");
  system.load_provider("answerer", "second");
  begin("query_or_fail", "manner=never");
  system.wire("caller.failing_echo", "second.echo");
  const SeenSample ended = end();
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Disconnected);
  EXPECT_EQ(ended.payload(), "the port was wired to another provider");
  EXPECT_EQ(outcome_of("query_or_fail", "manner=promptly"), Outcome::Ok);
}

TEST_P(Calls, OpenQueryOfAPortThatSaysSoGoesToTheNewProviderWhenItIsRewired) {
  system.wire("caller.lookup", "answerer.lookup");
  system.load_provider("answerer", "second");
  begin("lookup", "manner=second");
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  const auto done = system.wire("caller.lookup", "second.lookup");
  EXPECT_EQ(done.switched(), 1U);
  EXPECT_EQ(done.redirected(), 1U);
  EXPECT_EQ(outcome(), Outcome::Ok);
  system.eventually("the old one knows", [&] { return system.read("answerer.abandoned").value() == 1; });
}

TEST_P(Calls, RewireToAProviderInAnotherModeKeepsTheWireAndTellsNotActive) {
  wire_all();
  system.load_provider("answerer", "second", "neutral");
  system.wire("caller.echo", "second.echo");
  EXPECT_EQ(outcome_of("query"), Outcome::NotActive);
}

// ---- send -----------------------------------------------------------------------------------------------------

TEST_P(SendCalls, AcknowledgedSendEndsWhenTheProvidersHullHasIt) {
  wire_all();
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Ok);
  system.eventually("handled", [&] { return system.port("sink.orders").messages() == 1; });
}

TEST_P(SendCalls, AcknowledgedSendToAProviderThatIsNotActiveSaysSo) {
  wire_all();
  system.state("sink", "neutral");
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::NotActive);
  EXPECT_EQ(system.port("sink.orders").messages(), 0U);
}

TEST_P(SendCalls, SeveralClientsSendToOneProvider) {
  wire_all();
  system.load_client("caller", "other");
  system.wire("other.orders", "sink.orders");
  EXPECT_EQ(outcome_of("send"), Outcome::Ok);
  system.set("other", "call=send go=1");
  system.eventually("both", [&] { return system.port("sink.orders").messages() == 2; });
}

TEST_P(SendCalls, SendWhileThePortWaitsIsDisconnected) {
  system.wire("caller.orders", "nobody.orders");
  EXPECT_EQ(system.port("caller.orders").connection(), control::WAITING);
  EXPECT_EQ(outcome_of("send"), Outcome::Disconnected);
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Disconnected);
}

TEST_P(SendCalls, QueuedSendToAProviderThatIsNotActiveIsCountedThere) {
  wire_all();
  system.state("sink", "neutral");
  EXPECT_EQ(outcome_of("send"), Outcome::Ok) << "it says nothing about the handler";
  system.eventually("counted", [&] { return system.read("sink.orders.not_active").value() == 1; });
  EXPECT_EQ(system.port("sink.orders").messages(), 0U);
}

// ---- event ----------------------------------------------------------------------------------------------------

TEST_P(Event, ContinuousActivationDeliversEachEventInOrder) {
  wire_all();
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  const auto before = system.port("source.newest").messages();
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  const auto first = system.wait_for(rings, [](const auto&) { return true; });
  EXPECT_GE(first.value(), static_cast<double>(before));
  const auto last = system.wait_for(rings, [](const auto& one) { return one.number() == 100; });
  EXPECT_EQ(last.value() - first.value(), 99) << "one for each state, none missing";
}

TEST_P(Event, SingleActivationFiresOnce) {
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

TEST_P(Event, SingleActivationWhoseEventFindsNoRoomFiresWithALaterOne) {
  constexpr std::size_t kSize = 600'000;
  wire_all();
  system.set("source", "period_ms=2");
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1 payload=500000 ring_ms=100"), Outcome::Ok);
  system.eventually("no room", [&] { return system.port("caller.handled_bell").dropped() > 10; });
  ASSERT_EQ(outcome_of("activate_handled", "every=1 single=true payload=" + std::to_string(kSize)), Outcome::Ok);
  const auto dropped = system.port("caller.handled_bell").dropped();
  system.eventually("its event has found none",
                    [&] { return system.port("caller.handled_bell").dropped() > dropped + 10; });
  system.state("source", "neutral");
  system.set("caller", "ring_ms=0");
  system.set("source", "period_ms=100");
  system.state("source", "active");
  system.wait_for(rings, [](const auto& one) { return one.payload() == std::to_string(kSize); });
  const auto then = system.port("caller.rings").messages();
  system.eventually("more", [&] { return system.port("caller.rings").messages() > then + 5; });
  const auto later = system.take(rings);
  EXPECT_TRUE(std::none_of(later.begin(), later.end(), [](const auto& one) {
    return one.payload() == std::to_string(kSize);
  })) << "once";
}

TEST_P(Event, SingleActivationWhoseEventFindsItsClientInNoModeFiresWithALaterOne) {
  wire_all();
  system.set("source", "period_ms=5");
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate_handled", "every=400 single=true"), Outcome::Ok);
  system.state("caller", "neutral");
  system.eventually("missed", [&] { return system.read("caller.handled_bell.not_active").value() == 1; });
  const auto rings = system.watch("caller.rings");
  system.state("caller", "active");
  system.wait_for(rings, [](const auto& one) { return one.number() == 1; });
  const auto states_then = system.port("source.newest").messages();
  system.eventually("more states", [&] { return system.port("source.newest").messages() > states_then + 450; });
  EXPECT_EQ(system.port("caller.rings").messages(), 1U);
}

TEST_P(Event, TestKeepsStateInItsOwnCopyOfTheActivation) {
  wire_all();
  system.state("source", "active");
  ASSERT_EQ(outcome_of("activate", "every=3"), Outcome::Ok);
  for (const std::string seen : {"of 3", "of 6", "of 9"}) {
    begin("event");
    EXPECT_THAT(end().payload(), HasSubstr(seen));
  }
}

TEST_P(Event, TestThatThrowsEndsThatActivationAloneAndSaysWhy) {
  wire_all();
  system.set("source", "period_ms=1");
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  const auto number = system.port("source.newest").messages() + 2000;
  ASSERT_EQ(outcome_of("activate", "every=0 throw_at=" + std::to_string(number)), Outcome::Ok);
  begin("event", "every=1 throw_at=0 deadline_ms=60000");
  const auto ended = end();
  EXPECT_EQ(outcome_in(ended), Outcome::Rejected);
  EXPECT_THAT(ended.payload(), HasSubstr("asked to throw"));
  EXPECT_EQ(system.instance("source").mode(), "active");
  system.wait_for(rings, [&](const auto& one) { return one.value() > static_cast<double>(number) + 10; });
}

TEST_P(Event, TestThatHasThrownIsToldToWhoWaitsLaterBehindTheEventsBeforeIt) {
  wire_all();
  system.set("source", "period_ms=1");
  system.state("source", "active");
  const auto number = system.port("source.newest").messages() + 2000;
  const auto throwing = "throw_at=" + std::to_string(number);
  ASSERT_EQ(outcome_of("activate", "every=50 " + throwing), Outcome::Ok);
  system.eventually("it has thrown", [&] { return system.port("source.newest").messages() > number + 50; });
  int events = 0;
  SeenSample last;
  while (outcome_in(last = (begin("event"), end())) == Outcome::Ok) {
    EXPECT_THAT(last.payload(), testing::EndsWith(" of " + std::to_string(50 * ++events)));
  }
  EXPECT_GT(events, 0);
  EXPECT_EQ(outcome_in(last), Outcome::Rejected);
  EXPECT_THAT(last.payload(), HasSubstr("asked to throw"));
  EXPECT_EQ(outcome_of("event"), Outcome::WrongId) << "told once";
}

TEST_P(Event, TestThatHasThrownTakesNoEventFromAHandlerThatIsBehind) {
  wire_all();
  system.set("source", "period_ms=1");
  system.state("source", "active");
  system.set("caller", "ring_ms=2");
  const auto rings = system.watch("caller.rings");
  const auto number = system.port("source.newest").messages() + 2000;
  ASSERT_EQ(outcome_of("activate_handled", "every=1 throw_at=" + std::to_string(number)), Outcome::Ok);
  system.wait_for(rings, [&](const auto& one) { return one.value() == static_cast<double>(number) - 1; });
  EXPECT_THAT(system.logged("caller", "caller.handled_bell: an activation has ended: rejected"),
              HasSubstr("asked to throw"));
  EXPECT_EQ(system.port("caller.handled_bell").dropped(), 0U);
}

TEST_P(Event, DeactivatedActivationFiresNoMore) {
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
  system.set("source", "period_ms=10000");
  system.state("source", "active");
  system.eventually("its first put", [&] { return system.port("source.newest").messages() == 1; });
  system.load_provider("source", "second");
  ASSERT_EQ(outcome_of("activate", "every=1"), Outcome::Ok);
  begin("event");
  system.wire("caller.bell", "second.bell");
  EXPECT_EQ(outcome(), Outcome::Ok) << "of the second, for the first puts nothing for 10 s";
  system.set("source", "period_ms=5");
  system.state("source", "neutral");
  system.state("source", "active");
  eventually_lets_go("source");
}

TEST_P(Event, ActivationMovesToTheNewProvider) {
  wire_all();
  system.load_provider("source", "second");
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  system.wait_for(rings, [](const auto& one) { return one.number() == 1; });
  system.wire("caller.handled_bell", "second.bell");
  eventually_lets_go("source");
  system.state("source", "neutral");
  const auto so_far = system.port("caller.rings").messages();
  system.eventually("events of the new provider", [&] { return system.port("caller.rings").messages() > so_far + 5; });
}

TEST_P(Event, ActivationThatMovedToAProviderThatIsNotActiveIsMadeAgainOnceItIs) {
  wire_all();
  system.load_provider("source", "second", "neutral period_ms=1");
  system.state("source", "active");
  const auto rings = system.watch("caller.rings");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  system.wait_for(rings, [](const auto& one) { return one.number() == 1; });
  ASSERT_EQ(outcome_of("activate", "every=1"), Outcome::Ok);
  system.wire("caller.handled_bell", "second.bell");
  system.wire("caller.bell", "second.bell");
  system.eventually("both are refused", [&] { return system.read("second.bell.not_active").value() >= 2; });
  system.state("source", "neutral");
  const auto so_far = system.port("caller.rings").messages();
  system.state("second", "active");
  system.eventually("events of the new provider", [&] { return system.port("caller.rings").messages() > so_far + 5; });
  EXPECT_EQ(outcome_of("event"), Outcome::Ok);
}

/// Events that have arrived, and wait for a handler that is busy.
class ArrivedEvents : public Calls {
 protected:
  static constexpr std::uint64_t kFired = 20;
  ArrivedEvents() {
    system.set("source", "period_ms=1000 count=" + std::to_string(kFired));
    system.set("caller", "ring_ms=25");
    system.wire("caller.handled_bell", "source.bell");
  }
  /// By a state put to each, after which there are no more.
  void fire() {
    system.state("source", "active");
    EXPECT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
    system.set("source", "period_ms=1");  // only now: or all might be put before the activation is made
    system.eventually("all are put", [&] { return system.port("source.newest").messages() == kFired; });
    // The last is counted there before it is put to the activation: what is set now comes behind both.
    system.set("source", "period_ms=2");
    fired = static_cast<std::uint64_t>(system.read("source.tested").value());
    EXPECT_GT(fired, 0U);
    // Its answer is sent behind them, and overtakes them only where they wait.
    EXPECT_EQ(outcome_of("activate_handled", "every=0"), Outcome::Ok);
  }
  void expect_all_handled() {
    system.eventually("all are handled", [&] { return system.port("caller.rings").messages() >= fired; });
    EXPECT_EQ(system.port("caller.rings").messages(), fired);
  }
  std::uint64_t fired = 0;
};

TEST_P(ArrivedEvents, AreHandledThoughTheirPortIsRewired) {
  system.load_provider("source", "second", "count=1");
  system.eventually("its only put", [&] { return system.port("second.newest").messages() == 1; });
  fire();
  system.wire("caller.handled_bell", "second.bell");
  expect_all_handled();
}

TEST_P(ArrivedEvents, AreHandledThoughTheirPortIsUnwired) {
  fire();
  system.unwire("caller.handled_bell");
  expect_all_handled();
}

TEST_P(Event, ActivationAtAProviderThatIsNotActiveIsNotMade) {
  wire_all();
  EXPECT_EQ(outcome_of("activate"), Outcome::NotActive);
}

FIONA_OVER_EVERY_TRANSPORT(Calls);
FIONA_OVER_EVERY_TRANSPORT(QueryCalls);
FIONA_OVER_EVERY_TRANSPORT(SendCalls);
FIONA_OVER_EVERY_TRANSPORT(Event);
FIONA_OVER_EVERY_TRANSPORT(ArrivedEvents);

}  // namespace
}  // namespace fiona::conformance
