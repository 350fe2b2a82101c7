// What a call that waits returns when a component makes it from a thread of its own (docs/patterns.md, the table of
// pending calls).
#include <gtest/gtest.h>
#include <signal.h>

#include <map>
#include <string>
#include <vector>

#include "fiona/result.hpp"
#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

class OwnThreadCalls : public testing::TestWithParam<Transport> {
 protected:
  OwnThreadCalls() {
    system.load_client("thread-caller", "caller");
    system.load_provider("source", "source");
    system.load_provider("source", "quiet", "neutral");
    system.load_provider("answerer", "answerer");
    system.load_provider("sink", "sink");
    outcomes = system.watch("caller.outcome");
  }
  void wire_all() {
    system.wire("caller.samples", "quiet.newest");
    system.wire("caller.echo", "answerer.echo");
    system.wire("caller.bell", "source.bell");
    system.wire("caller.orders", "sink.orders");
    ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  }
  void begin(const std::string& call, const std::string& parameters) {
    system.set("caller", "call=" + call + " " + parameters + " go=" + std::to_string(++go));
  }
  /// Returns once its thread waits.
  void begin_to_wait(const std::string& call) {
    begin(call, "manner=never deadline_ms=60000");
    system.eventually("it has begun", [&] { return system.read("caller.begun").value() == go; });
  }
  Outcome outcome() {
    const auto end = system.wait_for(outcomes, [&](const SeenSample& one) { return one.number() == go; });
    return static_cast<Outcome>(static_cast<int>(end.value()));
  }
  Outcome outcome_of(const std::string& call, const std::string& parameters = "") {
    begin(call, parameters);
    return outcome();
  }

  const std::vector<std::string> waits{"wait_update", "query", "event"};
  RunningSystem system{GetParam()};
  std::uint64_t outcomes = 0;
  unsigned go = 0;
};

TEST_P(OwnThreadCalls, WithoutAWireEndUnwired) {
  for (const std::string call : {"wait_update", "query", "activate", "send_acknowledged"})
    EXPECT_EQ(outcome_of(call), Outcome::Unwired) << call;
}

TEST_P(OwnThreadCalls, EndWithWhatTheyWaitFor) {
  wire_all();
  EXPECT_EQ(outcome_of("query", "manner=promptly"), Outcome::Ok);
  EXPECT_EQ(outcome_of("query", "manner=error"), Outcome::Rejected);
  EXPECT_EQ(outcome_of("send_acknowledged"), Outcome::Ok);
  ASSERT_EQ(outcome_of("activate", "every=1"), Outcome::Ok);
  EXPECT_EQ(outcome_of("event"), Outcome::Ok);
  begin_to_wait("wait_update");
  system.state("quiet", "active");
  EXPECT_EQ(outcome(), Outcome::Ok);
}

TEST_P(OwnThreadCalls, EndAtTheirDeadline) {
  wire_all();
  for (const std::string& call : waits)
    EXPECT_EQ(outcome_of(call, "manner=never deadline_ms=30"), Outcome::Timeout) << call;
}

TEST_P(OwnThreadCalls, EndCancelledByEachOfTheThreeFlags) {
  wire_all();
  for (const std::string flag : {"port", "pattern", "instance"}) {
    for (const std::string& call : waits) {
      begin_to_wait(call);
      system.set("caller", "cancel=" + flag);
      EXPECT_EQ(outcome(), Outcome::Cancelled) << call << ", " << flag;
      system.set("caller", "cancel=none");
    }
  }
}

TEST_P(OwnThreadCalls, EndDisconnectedWhenThePortIsUnwired) {
  wire_all();
  const std::map<std::string, std::string> ports{{"wait_update", "samples"}, {"query", "echo"}, {"event", "bell"}};
  for (const auto& [call, port] : ports) {
    begin_to_wait(call);
    system.unwire("caller." + port);
    EXPECT_EQ(outcome(), Outcome::Disconnected) << call;
  }
}

TEST_P(OwnThreadCalls, EndDisconnectedWhenTheProviderIsUnloaded) {
  wire_all();
  const std::map<std::string, std::string> providers{
      {"wait_update", "quiet"}, {"query", "answerer"}, {"event", "source"}};
  for (const auto& [call, provider] : providers) {
    begin_to_wait(call);
    system.unload(provider);
    EXPECT_EQ(outcome(), Outcome::Disconnected) << call;
  }
}

TEST_P(OwnThreadCalls, GoOnOnTheNewProviderOrEndOnTheOldWhenTheyAreRewired) {
  wire_all();
  system.load_provider("source", "second");
  system.load_provider("answerer", "other");
  begin_to_wait("wait_update");
  system.wire("caller.samples", "second.newest");
  EXPECT_EQ(outcome(), Outcome::Ok);
  begin_to_wait("query");
  system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
  system.wire("caller.echo", "other.echo");
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  EXPECT_EQ(outcome(), Outcome::Ok);
}

/// The thread is let go at once, and its work called again in the next mode.
TEST_P(OwnThreadCalls, HoldUpNoChangeOfMode) {
  wire_all();
  for (const std::string mode : {"neutral", "deactivated"}) {
    for (const std::string& call : waits) {
      begin_to_wait(call);
      system.state("caller", mode);
      EXPECT_EQ(system.instance("caller").mode(), mode) << call;
      system.state("caller", "active");
      EXPECT_EQ(outcome_of("query", "manner=promptly"), Outcome::Ok) << "after " << call << ", " << mode;
    }
  }
}

FIONA_OVER_EVERY_TRANSPORT(OwnThreadCalls);

// ---- a provider whose process stands still, is killed, or hangs -----------------------------------------------

/// A caller for each call, named after it, so that all wait at once.
class OwnThreadFarFromItsProvider : public testing::TestWithParam<Transport> {
 protected:
  OwnThreadFarFromItsProvider() {
    for (const std::string name : {"source", "quiet"}) system.load_client("source", name, "neutral");
    system.load_client("answerer", "answerer");
    system.load_client("sink", "sink");
    system.state("source", "active");
    for (const auto& call : calls) {
      system.load_provider("thread-caller", call);
      outcomes[call] = system.watch(call + ".outcome");
      system.wire(call + ".samples", "quiet.newest");
      system.wire(call + ".echo", "answerer.echo");
      system.wire(call + ".bell", "source.bell");
      system.wire(call + ".orders", "sink.orders");
    }
    begin("event", "activate", "every=0");
    eventually_all_ended({"event"}, Outcome::Ok);
    far = system.far_process();
  }
  ~OwnThreadFarFromItsProvider() override { ::kill(far, SIGCONT); }

  void begin(const std::string& caller, const std::string& call, const std::string& parameters) {
    system.set(caller, "call=" + call + " " + parameters + " go=" + std::to_string(++begun[caller]));
  }
  void begin_each(const std::vector<std::string>& some, const std::string& parameters) {
    for (const auto& call : some) begin(call, call, "manner=never every=0 " + parameters);
    for (const auto& call : some) {
      system.eventually(call + " has begun", [&] { return system.read(call + ".begun").value() == begun[call]; });
    }
  }
  /// All calls wait for it; as many as can have begun before: it is given up when it has stood still for a second.
  void stop_under_all(const std::string& parameters) {
    begin_each({"wait_update", "query", "event"}, parameters);
    stop_process(far);
    begin_each({"send_acknowledged", "activate"}, parameters);  // which it would acknowledge
  }
  /// The newest call of each of these, so, and once; those before have had their ends before.
  void eventually_all_ended(const std::vector<std::string>& callers, Outcome outcome) {
    for (const auto& caller : callers) {
      const auto end = system.wait_for(outcomes[caller], [](const auto&) { return true; });
      EXPECT_EQ(end.number(), begun[caller]) << caller;
      EXPECT_EQ(static_cast<Outcome>(static_cast<int>(end.value())), outcome) << caller;
    }
  }
  void expect_no_other_ends() {
    for (const auto& call : calls) EXPECT_TRUE(system.take(outcomes[call]).empty()) << call;
  }

  const std::vector<std::string> calls{"wait_update", "query", "event", "send_acknowledged", "activate"};
  RunningSystem system{GetParam()};
  std::map<std::string, std::uint64_t> outcomes;
  std::map<std::string, unsigned> begun;
  pid_t far = 0;
};

TEST_P(OwnThreadFarFromItsProvider, EndsItsCallsAtTheirDeadlineOnceWhileItStandsStill) {
  stop_under_all("deadline_ms=300");
  eventually_all_ended(calls, Outcome::Timeout);
  ::kill(far, SIGCONT);
  // Behind what is late by now; a host that stood still for long has to join again.
  for (const auto& call : calls) {
    Outcome ended = Outcome::Disconnected;
    system.eventually("its answers come again", [&] {
      begin(call, "query", "manner=promptly deadline_ms=10000");
      const auto end = system.wait_for(outcomes[call], [](const auto&) { return true; });
      EXPECT_EQ(end.number(), begun[call]) << call;
      ended = static_cast<Outcome>(static_cast<int>(end.value()));
      return ended == Outcome::Ok;
    });
  }
  expect_no_other_ends();
}

TEST_P(OwnThreadFarFromItsProvider, EndsItsCallsDisconnectedOnceWhenItIsKilled) {
  stop_under_all("deadline_ms=100000");
  expect_no_other_ends();
  ::kill(far, SIGKILL);
  eventually_all_ended(calls, Outcome::Disconnected);
  for (const auto& call : calls) begin(call, "send_acknowledged", "deadline_ms=100000");
  eventually_all_ended(calls, Outcome::Disconnected);
  expect_no_other_ends();
}

TEST_P(OwnThreadFarFromItsProvider, EndsAQueryAtItsDeadlineOnceWhileItHangs) {
  // It hangs for half a second, and on a busy machine may have come back before it is asked.
  system.eventually("the deadline comes while it hangs", [&] {
    const auto asked = system.port("answerer.echo").messages();
    begin("event", "query", "manner=hang deadline_ms=60000");
    system.eventually("it hangs", [&] { return system.port("answerer.echo").messages() > asked; });
    begin("query", "query", "manner=promptly deadline_ms=30");
    const auto end = system.wait_for(outcomes["query"], [](const auto&) { return true; });
    EXPECT_EQ(end.number(), begun["query"]);
    eventually_all_ended({"event"}, Outcome::Ok);
    return static_cast<Outcome>(static_cast<int>(end.value())) == Outcome::Timeout;
  });
  begin("query", "query", "manner=promptly deadline_ms=60000");
  eventually_all_ended({"query"}, Outcome::Ok);
  expect_no_other_ends();
}

FIONA_OVER(OwnThreadFarFromItsProvider, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
