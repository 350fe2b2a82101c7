// What a call that waits returns while the process of its provider stands still, or when it is killed
// (docs/patterns.md, the table of pending calls).
#include <gtest/gtest.h>
#include <signal.h>

#include <map>
#include <string>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

class FarProvider : public testing::TestWithParam<Transport> {
 protected:
  FarProvider() {
    system.load_provider("caller", "caller");
    for (const std::string name : {"source", "quiet"}) system.load_client("source", name, "neutral");
    system.load_client("answerer", "answerer");
    system.load_client("sink", "sink");
    outcomes = system.watch("caller.outcome");
    system.wire("caller.samples", "quiet.newest");
    system.wire("caller.echo", "answerer.echo");
    system.wire("caller.bell", "source.bell");
    system.wire("caller.orders", "sink.orders");
    system.state("source", "active");
    far = system.far_process();
  }
  ~FarProvider() override { go_on(); }

  unsigned begin(const std::string& call, const std::string& parameters = "") {
    system.set("caller", "call=" + call + " go=" + std::to_string(++go) + (parameters.empty() ? "" : " " + parameters));
    return go;
  }
  SeenSample end_of(unsigned number) {
    return system.wait_for(outcomes, [&](const SeenSample& one) { return one.number() == number; });
  }
  Outcome outcome_of(unsigned number) { return static_cast<Outcome>(static_cast<int>(end_of(number).value())); }
  /// It stands anew for each: one that does so for a second is given up.
  void expect_cancelled_by_each_flag(const std::string& call) {
    for (const std::string flag : {"port", "pattern", "instance"}) {
      stop();
      const unsigned waits = begin(call);
      system.set("caller", "cancel=" + flag);
      EXPECT_EQ(outcome_of(waits), Outcome::Cancelled) << flag;
      system.set("caller", "cancel=none");
      go_on();
      wait_until_it_answers();
    }
  }
  void stop() { stop_process(far); }
  void go_on() { ::kill(far, SIGCONT); }
  /// To its host and to the caller.
  void wait_until_it_answers() {
    system.eventually("it answers", [&] {
      try {
        static_cast<void>(system.read("source.tested"));
      } catch (const Error&) {  // a host that stood still for long has to join again
        return false;
      }
      return outcome_of(begin("send_acknowledged")) == Outcome::Ok;
    });
  }
  /// The far source puts states again, and none of them to an activation.
  void expect_none_activated() {
    system.eventually("no activation at the source", [&] {
      try {
        const double tested = system.read("source.tested").value();
        const auto put = system.port("source.newest").messages();
        system.eventually("more states", [&] { return system.port("source.newest").messages() > put + 10; });
        return system.read("source.tested").value() == tested;
      } catch (const Error&) {  // a host that stood still for long has to join again
        return false;
      }
    });
  }

  RunningSystem system{GetParam()};
  pid_t far = 0;
  std::uint64_t outcomes = 0;
  unsigned go = 0;
};

TEST_P(FarProvider, CallsThatWaitEndDisconnectedWhenItsProcessIsKilled) {
  ASSERT_EQ(outcome_of(begin("activate", "every=0")), Outcome::Ok);
  system.set("quiet", "count=1");
  system.state("quiet", "active");
  system.eventually("put", [&] { return system.port("caller.samples").messages() == 1; });
  ASSERT_EQ(outcome_of(begin("latest")), Outcome::Ok);
  stop();
  const unsigned waits[] = {begin("wait_update", "deadline_ms=100000 manner=never"), begin("query"), begin("event"),
                            begin("send_acknowledged")};
  ::kill(far, SIGKILL);
  std::map<unsigned, Outcome> ended;
  system.eventually("all have ended", [&] {
    for (const auto& one : system.take(outcomes))
      ended[static_cast<unsigned>(one.number())] = static_cast<Outcome>(static_cast<int>(one.value()));
    return ended.size() == 4;
  });
  for (const unsigned one : waits) EXPECT_EQ(ended[one], Outcome::Disconnected) << one;
  EXPECT_EQ(outcome_of(begin("latest")), Outcome::Disconnected) << "and never the old value";
}

TEST_P(FarProvider, SendWhileThePortIsLostIsDisconnected) {
  ::kill(far, SIGKILL);
  system.eventually("lost", [&] { return system.port("caller.orders").connection() == control::LOST; });
  EXPECT_EQ(outcome_of(begin("send")), Outcome::Disconnected);
  EXPECT_EQ(outcome_of(begin("send_acknowledged")), Outcome::Disconnected);
}

TEST_P(FarProvider, ActivateThatWaitsEndsAtItsDeadlineAndThereIsNoActivation) {
  stop();
  EXPECT_EQ(outcome_of(begin("activate", "deadline_ms=50")), Outcome::Timeout);
  go_on();
  expect_none_activated();
}

TEST_P(FarProvider, ActivateThatWaitsEndsCancelledByEachOfTheThreeFlagsAndThereIsNoActivation) {
  expect_cancelled_by_each_flag("activate");
  expect_none_activated();
}

TEST_P(FarProvider, ActivateThatWaitsEndsNotActiveWhenTheCallerLeavesItsMode) {
  stop();
  const unsigned waits = begin("activate");
  system.state("caller", "neutral");
  EXPECT_EQ(outcome_of(waits), Outcome::NotActive);
  go_on();
  expect_none_activated();
}

TEST_P(FarProvider, ActivateThatWaitsEndsDisconnectedWhenItIsUnwired) {
  stop();
  const unsigned waits = begin("activate");
  system.unwire("caller.bell");
  const SeenSample ended = end_of(waits);
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Disconnected);
  EXPECT_EQ(ended.payload(), "unwired") << "not because it stands still";
  go_on();
  expect_none_activated();
}

TEST_P(FarProvider, ActivateThatWaitsEndsDisconnectedWhenItsProcessIsKilled) {
  stop();
  const unsigned waits = begin("activate");
  ::kill(far, SIGKILL);
  EXPECT_EQ(outcome_of(waits), Outcome::Disconnected);
}

TEST_P(FarProvider, ActivateThatWaitsEndsOnTheNewProviderWhenItIsRewired) {
  system.load_provider("source", "second");
  stop();
  const unsigned waits = begin("activate");
  system.wire("caller.bell", "second.bell");
  EXPECT_EQ(outcome_of(waits), Outcome::Ok);
  EXPECT_EQ(outcome_of(begin("event")), Outcome::Ok);
  go_on();
  expect_none_activated();
}

TEST_P(FarProvider, AcknowledgedSendThatWaitsEndsAtItsDeadline) {
  stop();
  EXPECT_EQ(outcome_of(begin("send_acknowledged", "deadline_ms=50")), Outcome::Timeout);
}

TEST_P(FarProvider, AcknowledgedSendThatWaitsEndsCancelledByEachOfTheThreeFlags) {
  expect_cancelled_by_each_flag("send_acknowledged");
}

TEST_P(FarProvider, AcknowledgedSendThatWaitsEndsNotActiveWhenTheCallerLeavesItsMode) {
  stop();
  const unsigned waits = begin("send_acknowledged");
  system.state("caller", "neutral");
  EXPECT_EQ(outcome_of(waits), Outcome::NotActive);
}

TEST_P(FarProvider, AcknowledgedSendThatWaitsEndsDisconnectedWhenItIsUnwired) {
  stop();
  const unsigned waits = begin("send_acknowledged");
  system.unwire("caller.orders");
  const SeenSample ended = end_of(waits);
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Disconnected);
  EXPECT_EQ(ended.payload(), "unwired") << "not because it stands still";
}

TEST_P(FarProvider, AcknowledgedSendThatWaitsEndsOnTheOldProviderWhenItIsRewired) {
  system.load_provider("sink", "second");
  stop();
  const unsigned waits = begin("send_acknowledged");
  system.wire("caller.orders", "second.orders");
  go_on();
  EXPECT_EQ(outcome_of(waits), Outcome::Ok);
  system.eventually("handled", [&] { return system.port("sink.orders").messages() == 1; });
  EXPECT_EQ(system.port("second.orders").messages(), 0U);
}

FIONA_OVER(FarProvider, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
