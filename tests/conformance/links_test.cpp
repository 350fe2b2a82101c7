// What holds for the links between the processes of a system (docs/architecture.md, the way of a message).
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <string>
#include <vector>

#include "campaign.hpp"
#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using testing::HasSubstr;

class Links : public testing::TestWithParam<Transport> {
 protected:
  std::uint64_t sent_bytes() { return system.group(system.providers_group()).links().sent_bytes(); }
  bool crosses() const { return GetParam() != Transport::Process; }
  /// Each where clients live.
  void load_sinks(int count) {
    for (; sinks < count; ++sinks) system.load_client("sink", "sink" + std::to_string(sinks));
    wire_sinks();
  }
  void wire_sinks() {
    for (; wired < sinks; ++wired) system.wire("sink" + std::to_string(wired) + ".each", "source.newest");
  }
  void load_source(std::size_t payload) {
    system.load_provider("source", "source", "neutral period_ms=5 payload=" + std::to_string(payload));
  }
  /// Puts so many more samples, and waits until each of the sinks has them all; what has crossed for them, in bytes.
  std::uint64_t bytes_of(std::uint64_t count) {
    std::vector<std::uint64_t> before;
    for (int i = 0; i < sinks; ++i) before.push_back(system.port("sink" + std::to_string(i) + ".each").messages());
    const std::uint64_t sent_before = sent_bytes();
    put += count;
    system.set("source", "count=" + std::to_string(put));
    system.state("source", "active");
    for (int i = 0; i < sinks; ++i) {
      const std::string port = "sink" + std::to_string(i) + ".each";
      const std::uint64_t all = before[static_cast<std::size_t>(i)] + count;
      system.eventually("received", [&] { return system.port(port).messages() == all; });
      EXPECT_EQ(system.port(port).dropped(), 0U);
    }
    system.state("source", "neutral");
    return sent_bytes() - sent_before;
  }
  std::uint64_t push_to(int count_of_sinks, int count, std::size_t payload) {
    load_source(payload);
    load_sinks(count_of_sinks);
    return bytes_of(static_cast<std::uint64_t>(count));
  }

  std::uint64_t put = 0;
  int sinks = 0;
  int wired = 0;
  RunningSystem system{GetParam()};
};

/// What goes around them, of each crossing.
constexpr double kMostAround = 0.03;

void expect_crossings(std::uint64_t bytes, int crossings, double payload) {
  EXPECT_GE(static_cast<double>(bytes), crossings * payload);
  EXPECT_LE(static_cast<double>(bytes), (crossings + kMostAround) * payload);
}

TEST_P(Links, PushToEightSubscribersInOneProcessCrossesOnceAsToOne) {
  constexpr std::size_t kPayload = 100'000;
  constexpr int kCount = 20;
  const std::uint64_t to_one = push_to(1, kCount, kPayload);
  load_sinks(8);
  const std::uint64_t to_eight = bytes_of(kCount);
  expect_crossings(to_one, crosses() ? 1 : 0, kPayload * kCount);
  expect_crossings(to_eight, crosses() ? 1 : 0, kPayload * kCount);
}

TEST_P(Links, PushToEightSubscribersInTwoProcessesCrossesOnceToEach) {
  constexpr std::size_t kPayload = 100'000;
  constexpr int kCount = 20;
  load_source(kPayload);
  for (; sinks < 4; ++sinks) system.load_in("beside", "sink", "sink" + std::to_string(sinks));
  load_sinks(8);
  expect_crossings(bytes_of(kCount), crosses() ? 2 : 1, kPayload * kCount);
}

TEST_P(Links, ProcessesOfAHostHaveMemoryForTheirLargeObjects) {
  constexpr std::size_t kPayload = 100'000;
  push_to(1, 20, kPayload);
  EXPECT_EQ(system.group(system.providers_group()).links().memory_bytes() > 10 * kPayload,
            GetParam() == Transport::Ipc);
}

TEST_P(Links, SubscribersThatShareACrossingEachHaveTheirPrescaleAndComeAndGoAlone) {
  system.load_provider("source", "source", "neutral period_ms=1 count=90");
  for (const std::string name : {"all", "third", "gone"}) system.load_client("sink", name);
  system.wire("all.each", "source.newest");
  system.wire("third.each", "source.newest", 3);
  system.wire("gone.each", "source.newest");
  const auto sum = system.watch("third.report");
  system.unwire("gone.each");
  system.state("source", "active");
  system.eventually("received", [&] {
    return system.port("all.each").messages() == 90 && system.port("third.each").messages() == 30;
  });
  const auto last = system.wait_for(sum, [](const auto& one) { return one.number() == 30; });
  EXPECT_EQ(last.value(), 30 * (1 + 88) / 2.0) << "the first, then every third";
  EXPECT_EQ(system.port("gone.each").messages(), 0U);
}

TEST_P(Links, LateSubscriberOfAServiceWithLastValueIsGivenItAloneThoughItSharesTheCrossing) {
  system.load_provider("source", "source", "period_ms=1 count=1");
  system.load_client("sink", "first");
  system.wire("first.last", "source.last");
  system.eventually("given", [&] { return system.port("first.last").messages() == 1; });
  system.load_client("sink", "late");
  system.wire("late.last", "source.last");
  system.eventually("given", [&] { return system.port("late.last").messages() == 1; });
  EXPECT_EQ(system.port("first.last").messages(), 1U);
}

TEST_P(Links, SlowConsumerLosesInItsOwnNameAndNobodyElseLoses) {
  system.load_client("sink", "slow", "work_ms=200");
  system.load_client("sink", "quick");
  system.load_provider("source", "source", "neutral period_ms=12 count=200 payload=100000");
  system.wire("slow.each", "source.newest");
  system.wire("quick.each", "source.newest");
  system.state("source", "active");
  system.eventually("received", [&] { return system.port("quick.each").messages() == 200; });
  EXPECT_EQ(system.port("quick.each").dropped(), 0U);
  EXPECT_EQ(system.port("source.newest").dropped(), 0U);
  system.eventually("all accounted for", [&] {
    const auto port = system.port("slow.each");
    return port.dropped() > 50 && port.messages() + port.dropped() >= 200 - 22;
  });
}

TEST_P(Links, ObjectsLargerThanEveryWindowArriveWhole) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral count=1 payload=6000000");
  system.wire("sink.each", "source.newest");
  const auto report = system.watch("sink.report");
  for (const std::uint64_t put : {1, 2}) {  // the next one when the last has come: nothing waits for room here
    system.set("source", "count=" + std::to_string(put));
    system.state("source", "active");
    EXPECT_EQ(system.wait_for(report, [put](const auto& one) { return one.number() == put; }).payload(), "6000000");
    system.state("source", "neutral");
  }
}

TEST_P(Links, ObjectAboveTheCapOfALinkIsRefusedAtTheSenderAndCounted) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=1 payload=80000000");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  if (!crosses()) return system.eventually("received", [&] { return system.port("sink.each").messages() == 1; });
  system.eventually("refused", [&] { return system.port("source.newest").refused() == 1; });
  EXPECT_EQ(system.port("sink.each").messages(), 0U);
  EXPECT_EQ(system.group(system.providers_group()).links().too_large(), 1U);
}

TEST_P(Links, CarryNothingThatIsGarbledUnprovenOrNotGranted) {
  push_to(2, 20, 300'000);
  const auto snapshot = system.system().snapshot();
  for (const auto& one : snapshot.groups()) {
    EXPECT_EQ(one.links().garbled() + one.links().unproven() + one.links().not_granted(), 0U) << one.name();
    const bool has_end = crosses() && (one.name() == system.providers_group() || one.name() == "far");
    EXPECT_EQ(one.links().peers(), has_end ? 1U : 0U) << one.name();
  }
}

FIONA_OVER_EVERY_TRANSPORT(Links);

// ---- processes that end ---------------------------------------------------------------------------------------

class Processes : public testing::TestWithParam<Transport> {
 protected:
  /// It dies, and `seen` holds within 200 ms, or later by what a busy machine adds.
  template <class F>
  void expect_death_is_noticed(const std::string& group, F seen) {
    const Pulse pulse;
    const auto killed_ns = now_ns();
    ::kill(system.group(group).process(), SIGKILL);
    system.eventually("noticed", seen);
    EXPECT_LE(static_cast<double>(now_ns() - killed_ns) / 1e6, allowed(200, false) + pulse.longest_ms());
  }

  RunningSystem system{GetParam()};
};

TEST_P(Processes, DeathOfAGroupIsNoticedWithin200Milliseconds) {
  system.load_provider("source", "source", "period_ms=1");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("received", [&] { return system.port("sink.each").messages() > 5; });
  expect_death_is_noticed("far", [this] { return system.instance("sink").mode() == "failed"; });
  EXPECT_THAT(system.instance("sink").reason(), HasSubstr("killed by signal 9"));
}

TEST_P(Processes, DeathOfAGroupIsNoticedThoughAChildOfItsOwnHoldsItsSocket) {
  system.load_client("sink", "sink", "leave_child=true");
  expect_death_is_noticed("far", [this] { return system.instance("sink").mode() == "failed"; });
}

TEST_P(Processes, ClientThatDiesLeavesNothingAtItsProviderInAnotherGroup) {
  system.load_in("near", "source", "source", "period_ms=1");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("received", [&] { return system.port("sink.each").messages() > 5; });
  EXPECT_EQ(system.group("near").links().peers(), 1U);
  ::kill(system.group("far").process(), SIGKILL);
  system.eventually("noticed", [&] { return system.instance("sink").mode() == "failed"; });
  system.eventually("let go", [&] { return system.group("near").links().peers() == 0; });
  const auto sent = system.group("near").links().sent_bytes();
  const auto put = system.port("source.newest").messages();
  system.eventually("it goes on", [&] { return system.port("source.newest").messages() > put + 20; });
  EXPECT_EQ(system.group("near").links().sent_bytes(), sent) << "to nobody";
}

TEST_P(Processes, ProviderThatDiesIsLostToItsClientInAnotherGroup) {
  system.load_in("near", "source", "source", "period_ms=1");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("received", [&] { return system.port("sink.each").messages() > 5; });
  expect_death_is_noticed("near", [this] { return system.port("sink.each").connection() == control::LOST; });
}

TEST_P(Processes, RequestAboveTheCapOfALinkEndsWithASentence) {
  system.load_provider("answerer", "answerer");
  system.load_client("asker", "asker", "neutral count=1 payload=80000000");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.eventually("connected", [&] { return system.port("asker.echo").connection() == control::CONNECTED; });
  system.state("asker", "active");
  const auto end = system.wait_for(outcome, [](const auto&) { return true; });
  EXPECT_EQ(end.value(), static_cast<double>(Outcome::Rejected));
  EXPECT_EQ(end.payload(), "the message is larger than a link carries (64 MiB)");
}

TEST_P(Processes, GroupThatWouldUseUpTheDescriptorsIsRefusedInASentence) {
  rlimit before{};
  ::getrlimit(RLIMIT_NOFILE, &before);
  const rlimit small{110, before.rlim_max};
  ::setrlimit(RLIMIT_NOFILE, &small);
  std::string refusal;
  int made = 0;
  try {
    for (; made < 40; ++made) system.load_in("group" + std::to_string(made), "sink", "sink" + std::to_string(made));
  } catch (const Error& error) {
    refusal = error.what();
  }
  ::setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_GE(made, 2);
  EXPECT_THAT(refusal, HasSubstr("another group would bring the host to the end of its descriptors"));
  EXPECT_THAT(refusal, HasSubstr("ulimit -n"));
  for (int i = 0; i < made; ++i) EXPECT_EQ(system.instance("sink" + std::to_string(i)).mode(), "active");
}

FIONA_OVER(Processes, Transport::Ipc);

}  // namespace
}  // namespace fiona::conformance
