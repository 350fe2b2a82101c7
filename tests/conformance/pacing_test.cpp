// A put that waits for room (docs/patterns.md, Push newest).
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <utility>

#include "fiona/result.hpp"
#include "served_host.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

/// So many messages of this size are far more than inbox, lane and window hold together.
constexpr int kCount = 60;
constexpr int kPayload = 500'000;
/// What fits in front of a handler, and the one that it has.
constexpr std::uint64_t kFit = 4 * 1024 * 1024 / kPayload + 1;

class Pacing : public testing::TestWithParam<Transport> {
 protected:
  /// A subscriber that does not come to the end of its first sample, until its time is changed.
  void load_stuck() {
    system.load_client("sipper", "sipper", "sip_ms=60000");
    system.wire("sipper.samples", "pourer.samples");
    system.wire("sipper.never", "pourer.never");
  }
  void load_pourer(const std::string& parameters) {
    system.load_provider(
        "pourer", "pourer",
        "neutral count=" + std::to_string(kCount) + " payload=" + std::to_string(kPayload) + parameters);
  }
  std::uint64_t put() { return system.port("pourer.samples").messages(); }
  void wait_until_full() {
    std::uint64_t before = 0;
    system.eventually("it waits", [&] {
      const std::uint64_t now = put();
      return now == std::exchange(before, now) && now + 2 >= kFit && system.read("pourer.waits").value() == 1;
    });
  }
  SeenSample end(std::uint64_t outcome) {
    return system.wait_for(outcome, [](const auto& s) { return s.value() != 0 || s.number() == kCount; });
  }
  static Outcome outcome_of(const SeenSample& sample) { return static_cast<Outcome>(sample.value()); }

  RunningSystem system{GetParam()};
};

TEST_P(Pacing, PutThatWaitsForRoomLosesNothingToASlowSubscriber) {
  load_pourer("");
  system.load_client("sipper", "sipper", "sip_ms=5");
  system.wire("sipper.samples", "pourer.samples");
  system.wire("sipper.never", "pourer.never");
  const auto report = system.watch("sipper.report");
  system.state("pourer", "active");
  const auto last = system.wait_for(report, [](const auto& s) { return s.number() == kCount; });
  EXPECT_EQ(last.value(), 0) << "none out of order";
  EXPECT_EQ(system.port("sipper.samples").dropped(), 0U);
  EXPECT_EQ(system.port("pourer.samples").dropped(), 0U);
}

TEST_P(Pacing, PutThatDoesNotWaitLosesTheOldestAndCountsThem) {
  system.load_provider("source", "source", "neutral period_ms=0.1 count=60 payload=500000");
  system.load_provider("pourer", "pourer", "neutral");
  system.load_client("sipper", "sipper", "sip_ms=60000");
  system.wire("sipper.samples", "source.newest");
  system.wire("sipper.never", "pourer.never");
  system.state("source", "active");
  system.eventually("lost", [&] { return system.port("sipper.samples").dropped() > 0; });
}

// What goes when there is no room: of each push the oldest, or with a put that waits nothing; of events the newest in
// front of a handler, and the oldest where nobody has waited for them.
class FullPorts : public Pacing {
 protected:
  void load_events(const std::string& port, const std::string& parameters) {
    system.load_client("caller", "caller", "deadline_ms=30000 payload=" + std::to_string(kPayload) + " " + parameters);
    system.load_provider("prompter", "prompter");
    system.wire("caller." + port, "prompter.bell");
    outcomes = system.watch("caller.outcome");
    const std::string call = port == "bell" ? "activate" : "activate_handled";
    ASSERT_EQ(static_cast<Outcome>(end_of(call).value()), Outcome::Ok);
  }
  SeenSample end_of(const std::string& call) {
    system.set("caller", "call=" + call + " go=" + std::to_string(++go));
    return system.wait_for(outcomes, [this](const auto& one) { return one.number() == go; });
  }
  std::uint64_t outcomes = 0;
  std::uint64_t go = 0;
};

TEST_P(FullPorts, OfEachPushLoseTheOldestAndKeepTheNewest) {
  system.load_client("sink", "sink", "work_ms=500");
  system.load_provider("source", "source",
                       "neutral period_ms=1 count=" + std::to_string(kCount) + " payload=" + std::to_string(kPayload));
  const auto reports = system.watch("sink.report");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("all put", [&] { return system.port("source.newest").messages() == kCount; });
  system.set("sink", "work_ms=0");
  double sum = 0;
  double newest = 0;  // the number of the newest that the handler has had
  std::uint64_t handled = 0;
  system.eventually("the newest is handled", [&] {
    for (const auto& one : system.take(reports)) {
      newest = one.value() - std::exchange(sum, one.value());
      handled = one.number();
    }
    return newest == kCount;
  });
  const auto dropped = [&] { return system.port("sink.each").dropped(); };
  EXPECT_GT(dropped(), 0U);
  system.eventually("the others are counted", [&] { return dropped() + handled == kCount; });
}

TEST_P(FullPorts, OfAPushThatWaitsForRoomLoseNothing) {
  load_pourer("");
  system.load_client("sipper", "sipper", "sip_ms=60000");
  system.wire("sipper.samples", "pourer.samples");
  system.wire("sipper.never", "pourer.never");
  system.state("pourer", "active");
  std::uint64_t before = 0;
  system.eventually("it waits", [&] {
    const auto now = system.port("pourer.samples").messages();
    return now == std::exchange(before, now) && now > 0 && system.read("pourer.waits").value() == 1;
  });
  EXPECT_LE(before, kFit);
  EXPECT_EQ(system.port("sipper.samples").dropped() + system.port("pourer.samples").dropped(), 0U);
}

TEST_P(FullPorts, OfEventsWithAHandlerRefuseTheNewestAndKeepTheOldest) {
  load_events("handled_bell", "ring_ms=500");
  const auto rings = system.watch("caller.rings");
  for (int i = 0; i < kCount; ++i) {
    ASSERT_EQ(system.call("prompter.prompt", "manner=event").outcome(), "ok");
    system.eventually("the first is handled", [&] { return system.port("caller.handled_bell").messages() > 0; });
  }
  system.eventually("some are refused", [&] { return system.port("caller.handled_bell").dropped() > 0; });
  if (GetParam() == Transport::Process) {  // between processes one that is not quick enough may keep some from leaving
    EXPECT_EQ(system.port("prompter.bell").dropped(), 0U) << "counted once";
  }
  system.set("caller", "ring_ms=0");
  std::vector<double> states;
  system.eventually("those that found room are handled", [&] {
    for (const auto& one : system.take(rings)) states.push_back(one.value());
    return states.size() >= kFit;
  });
  for (std::size_t i = 0; i < kFit; ++i) EXPECT_EQ(states[i], static_cast<double>(i + 1));
}

TEST_P(FullPorts, OfEventsWithoutAHandlerLoseTheOldestAndKeepTheNewest) {
  constexpr std::uint64_t kEvents = 24;
  load_events("bell", "");
  for (std::uint64_t i = 1; i <= kEvents; ++i) {
    ASSERT_EQ(system.call("prompter.prompt", "manner=event").outcome(), "ok");
    system.eventually("it has come", [&] { return system.port("caller.bell").messages() == i; });
  }
  EXPECT_EQ(system.port("prompter.bell").dropped(), 0U) << "none was refused";
  constexpr std::uint64_t kKept = kFit - 1;
  system.eventually("the others are counted", [&] { return system.port("caller.bell").dropped() == kEvents - kKept; });
  for (std::uint64_t i = kEvents - kKept + 1; i <= kEvents; ++i) {
    const auto number = std::to_string(i);
    EXPECT_EQ(end_of("event").payload(), number + " of " + number);
  }
}

TEST_P(Pacing, PutWithoutRoomInTimeEndsWithTimeoutAndIsNotPut) {
  load_pourer(" deadline_ms=50");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  const auto last = end(outcome);
  EXPECT_EQ(outcome_of(last), Outcome::Timeout);
  EXPECT_EQ(put(), last.number());
  EXPECT_LE(put(), kFit);
  EXPECT_EQ(system.port("sipper.samples").dropped() + system.port("pourer.samples").dropped(), 0U);
}

TEST_P(Pacing, PutThatWaitsGoesOnWhenTheSubscriberIsUnwired) {
  load_pourer("");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  wait_until_full();
  system.unwire("sipper.samples");
  EXPECT_EQ(end(outcome).number(), static_cast<std::uint64_t>(kCount));
}

TEST_P(Pacing, PutThatWaitsGoesOnWhenTheSubscriberIsUnloaded) {
  load_pourer("");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  wait_until_full();
  system.unload("sipper");
  EXPECT_EQ(end(outcome).number(), static_cast<std::uint64_t>(kCount));
}

TEST_P(Pacing, PutThatWaitsEndsNotActiveWithItsMode) {
  load_pourer("");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  wait_until_full();
  system.state("pourer", "neutral");
  EXPECT_EQ(outcome_of(system.wait_for(outcome, [](const auto& s) { return s.value() != 0; })), Outcome::NotActive);
}

TEST_P(Pacing, PutThatWaitsIsCancelledByEachOfTheThreeFlags) {
  load_pourer("");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  for (const std::string flag : {"port", "pattern", "instance"}) {
    system.state("pourer", "active");
    wait_until_full();
    system.set("pourer", "cancel=" + flag);
    EXPECT_EQ(outcome_of(end(outcome)), Outcome::Cancelled) << flag;
    system.state("pourer", "neutral");
    system.state("pourer", "active");
    EXPECT_EQ(outcome_of(end(outcome)), Outcome::Cancelled) << "a new one, " << flag;
    system.state("pourer", "neutral");
    system.set("pourer", "cancel=none");
  }
  EXPECT_LE(put(), kFit) << "what was cancelled is not put";
}

TEST_P(Pacing, PutThatWaitsGoesOnWhenTheSubscriberIsRewired) {
  load_pourer("");
  load_stuck();
  system.load_provider("source", "quiet", "neutral");
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  wait_until_full();
  system.wire("sipper.samples", "quiet.newest");
  EXPECT_EQ(end(outcome).number(), static_cast<std::uint64_t>(kCount));
}

class PacingOfTheKilled : public Pacing {};

TEST_P(PacingOfTheKilled, PutThatWaitsGoesOnWithoutTheSubscriberWhoseProcessHasGone) {
  load_pourer(" deadline_ms=60000");
  load_stuck();
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  wait_until_full();
  ::kill(system.far_process(), SIGKILL);
  EXPECT_EQ(end(outcome).number(), static_cast<std::uint64_t>(kCount));
}

TEST_P(Pacing, PutThatWaitsDoesNotWaitForASubscriberOfTheNewest) {
  load_pourer("");
  system.load_client("sink", "sink", "work_ms=50");
  system.wire("sink.newest", "pourer.samples");
  const auto outcome = system.watch("pourer.outcome");
  system.state("pourer", "active");
  EXPECT_EQ(end(outcome).number(), static_cast<std::uint64_t>(kCount));
  system.eventually("superseded", [&] {
    return system.port("sink.newest").superseded() + system.port("sink.newest").messages() +
               system.port("sink.newest").dropped() ==
           kCount;
  });
}

TEST_P(Pacing, PutWaitsForTheSlowestOfSeveralAndAllGetEach) {
  load_pourer("");
  for (const std::string name : {"slow", "quick"}) {
    system.load_client("sipper", name, name == "slow" ? "sip_ms=5" : "");
    system.wire(name + ".samples", "pourer.samples");
    system.wire(name + ".never", "pourer.never");
  }
  const auto slow = system.watch("slow.report");
  const auto quick = system.watch("quick.report");
  system.state("pourer", "active");
  for (const auto report : {slow, quick}) {
    EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() == kCount; }).value(), 0);
  }
}

TEST_P(Pacing, PutOfAMessageLargerThanAllRoomWaitsUntilNothingElseIsThere) {
  system.load_provider("pourer", "pourer", "neutral count=4 payload=6000000");
  system.load_client("sipper", "sipper", "sip_ms=5");
  system.wire("sipper.samples", "pourer.samples");
  system.wire("sipper.never", "pourer.never");
  const auto report = system.watch("sipper.report");
  system.state("pourer", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() == 4; }).value(), 0);
}

class PacingOfTheWatched : public testing::TestWithParam<Transport> {
 protected:
  std::uint64_t put() { return console.instance("pourer").ports(0).messages(); }

  ServedHost host{GetParam()};
  TestConsole console{host};
  TestConsole watcher{host};
};

TEST_P(PacingOfTheWatched, PutThatWaitsDoesNotWaitForAWatcherThatDoesNotRead) {
  auto load = TestConsole::load_of(
      "pourer", host.place(), "pourer",
      "deadline_ms=60000 count=" + std::to_string(kCount) + " payload=" + std::to_string(kPayload));
  load.mutable_load()->set_mode("neutral");
  console.change(load);
  auto watch = watcher.request();
  *watch.mutable_watch()->mutable_port() = port_name("pourer.samples");
  watcher.send(watch);
  watcher.last_entry();  // behind it: it watches by now
  console.state("pourer", "active");
  console.eventually("all are put", [&] { return put() == kCount; });
  int shown = 1;
  while (watcher.receive().sample().sequence() < kCount) ++shown;
  EXPECT_LT(shown, kCount) << "nothing was lost: he was not slow";
}

FIONA_OVER_EVERY_TRANSPORT(PacingOfTheWatched);
FIONA_OVER_EVERY_TRANSPORT(Pacing);
FIONA_OVER_EVERY_TRANSPORT(FullPorts);
FIONA_OVER(PacingOfTheKilled, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
