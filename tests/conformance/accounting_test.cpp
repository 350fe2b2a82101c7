// What was sent is what was delivered, superseded, dropped and counted, or told to the sender (docs/patterns.md, Shared
// rules): the sum, for each way in which a message may end.
#include <gtest/gtest.h>

#include <signal.h>

#include <chrono>
#include <sstream>
#include <thread>
#include <utility>

#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;

class Accounting : public OverTransports {
 protected:
  /// Puts so many samples of this payload, once all is wired.
  void put(int count, int payload = 0, int period_ms = 1) {
    system.load_provider("source", "source",
                         "neutral period_ms=" + std::to_string(period_ms) + " count=" + std::to_string(count) +
                             " payload=" + std::to_string(payload));
  }
  /// What has come to a port, and what became of it.
  std::uint64_t accounted(const std::string& port) {
    const auto status = system.port(port);
    return status.messages() + status.superseded() + status.dropped() + status.refused() + status.not_active();
  }
  void expect_sum(const std::string& port, std::uint64_t sent) {
    system.eventually("nothing waits any more",
                      [&] { return accounted(port) >= sent && system.read(port + ".queue_depth").value() == 0; });
    EXPECT_EQ(accounted(port), sent) << system.port(port).ShortDebugString();
  }
  /// The numbers of a report like "ok=180 disconnected=20".
  static std::map<std::string, std::uint64_t> counts(const std::string& text) {
    std::map<std::string, std::uint64_t> all;
    std::istringstream words(text);
    for (std::string word; words >> word;)
      all[word.substr(0, word.find('='))] = std::stoull(word.substr(word.find('=') + 1));
    return all;
  }
};

TEST_P(Accounting, OfAHandlerThatIsTooSlowForEachAddsUp) {
  put(120, 100'000, 12);  // a process that gets no processor for a second takes what is put in it
  system.load_client("sink", "sink", "work_ms=300");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("all put", [&] { return system.port("source.newest").messages() == 120; });
  system.set("sink", "work_ms=0");
  expect_sum("sink.each", 120);
  EXPECT_GT(system.port("sink.each").dropped(), 0U);
}

TEST_P(Accounting, OfASlotThatNobodyReadsAddsUp) {
  put(100);
  system.load_client("caller", "caller");
  system.wire("caller.samples", "source.newest");
  system.state("source", "active");
  expect_sum("caller.samples", 100);
  EXPECT_EQ(system.port("caller.samples").superseded(), 99U);
}

TEST_P(Accounting, OfASlotIsNotReadByWhoHasGivenUpWaitingForIt) {
  put(100);
  system.load_client("caller", "caller");
  system.wire("caller.samples", "source.newest");
  const auto outcomes = system.watch("caller.outcome");
  system.set("caller", "call=wait_update deadline_ms=1 go=1");
  system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; });
  system.state("source", "active");
  expect_sum("caller.samples", 100);
  EXPECT_EQ(system.port("caller.samples").superseded(), 99U);
}

TEST_P(Accounting, OfAHandlerThatTakesTheNewestAddsUp) {
  put(200);
  system.load_client("sink", "sink", "work_ms=10");
  system.wire("sink.newest", "source.newest");
  system.state("source", "active");
  expect_sum("sink.newest", 200);
  EXPECT_GT(system.port("sink.newest").superseded(), 0U);
}

TEST_P(Accounting, OfAModeThatDoesNotServeThePortAddsUp) {
  put(100);
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.state("sink", "neutral");
  system.state("source", "active");
  expect_sum("sink.each", 100);
  EXPECT_EQ(system.read("sink.each.not_active").value(), 100);
  system.state("sink", "active");
  system.set("source", "count=150");
  system.state("source", "neutral");
  system.state("source", "active");
  expect_sum("sink.each", 150);
  EXPECT_EQ(system.port("sink.each").messages(), 50U);
}

TEST_P(Accounting, OfAWireThatIsCutHasAllUntilTheCutAndNothingAfterIt) {
  put(0);
  system.load_client("listener", "listener");
  system.wire("listener.samples", "source.newest");
  system.state("source", "active");
  system.eventually("some", [&] { return system.port("listener.samples").messages() > 20; });
  system.unwire("listener.samples");
  const auto put_then = system.port("source.newest").messages();
  const auto heard = [&] { return system.read("listener.samples_heard").value(); };
  double heard_then = -1;
  // Twice the same: one may be on its way to the inbox.
  system.eventually("what had arrived is heard", [&] {
    const double before = std::exchange(heard_then, heard());
    return before == heard_then && system.read("listener.samples.queue_depth").value() == 0 &&
           heard_then == static_cast<double>(system.port("listener.samples").messages());
  });
  EXPECT_LE(heard_then, static_cast<double>(put_then));
  system.eventually("more", [&] { return system.port("source.newest").messages() > put_then + 20; });
  EXPECT_EQ(heard(), heard_then) << "nothing after the cut";
  EXPECT_FALSE(system.read("listener.disorder").has_value);
}

TEST_P(Accounting, OfAFullSendQueueIsToldToTheSender) {
  system.load_client("sink", "sink", "work_ms=500");
  system.load_provider("caller", "caller");
  system.load_provider("source", "source", "neutral period_ms=1");
  system.wire("caller.orders", "sink.orders");
  system.wire("sink.each", "source.newest");
  const auto outcomes = system.watch("caller.outcome");
  // What lets the orders wait: a handler that takes long, where they are queued before it; else a process that stands.
  system.state("source", "active");
  system.eventually("at work", [&] { return system.port("sink.each").messages() > 0; });
  const pid_t far = GetParam() == Transport::Process ? 0 : system.far_process();
  if (far != 0) stop_process(far);
  // In one process nearly twice what a queue has room for; else there is also what is on its way.
  const std::uint64_t burst = far == 0 ? 25 : 50;
  system.set("caller", "call=send_burst go=1 payload=300000 every=" + std::to_string(burst));
  auto ends = counts(system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; }).payload());
  if (far != 0) ::kill(far, SIGCONT);
  const auto taken = ends["ok"];
  EXPECT_GT(taken, 0U);
  EXPECT_GT(ends["rejected"], 0U) << "a full queue is an outcome, not a wait";
  EXPECT_EQ(taken + ends["rejected"], burst);
  EXPECT_EQ(system.port("caller.orders").dropped(), burst - taken);
  system.state("source", "neutral");
  system.eventually("handled", [&] { return system.port("sink.orders").messages() == taken; });
  EXPECT_EQ(system.port("sink.orders").refused(), 0U) << "what was taken arrives";
}

TEST_P(Accounting, OfAcknowledgedSendsHasOneOutcomeForEach) {
  system.load_client("sink", "sink");
  system.load_provider("caller", "caller");
  system.wire("caller.orders", "sink.orders");
  const auto outcomes = system.watch("caller.outcome");
  system.set("caller", "call=send_many go=1 every=500");
  const auto ended = counts(system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; }).payload());
  std::uint64_t sum = 0;
  for (const auto& [outcome, count] : ended) sum += count;
  EXPECT_EQ(sum, 500U);
  system.eventually("those that were taken are handled",
                    [&] { return system.port("sink.orders").messages() == ended.at("ok"); });
}

class AccountingOfTheKilled : public Accounting {
 protected:
  /// A caller, and at the other end of its wire a sink whose process stands still; its outcomes.
  std::uint64_t wire_to_one_that_is_stopped() {
    system.load_client("sink", "sink");
    system.load_provider("caller", "caller");
    system.wire("caller.orders", "sink.orders");
    const auto outcomes = system.watch("caller.outcome");
    far = system.far_process();
    stop_process(far);
    return outcomes;
  }

  pid_t far = 0;
};

TEST_P(AccountingOfTheKilled, SendsThatWereNotAcknowledgedAreToldAndThereAreNoOthers) {
  const auto outcomes = wire_to_one_that_is_stopped();
  system.set("caller", "call=send_many go=1 every=300");
  system.eventually("sent", [&] { return system.read("caller.orders.rate").has_value; });
  ::kill(far, SIGKILL);
  const auto ended = counts(system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; }).payload());
  EXPECT_EQ(ended.at("disconnected"), 300U) << "unknown: it may have had them, and could not say so";
}

TEST_P(AccountingOfTheKilled, SendsThatHaveNotLeftForItAreCountedAsDropped) {
  constexpr std::uint64_t kSent = 50;
  constexpr std::uint64_t kOnTheirWay = 14;  // of 300 kB: as many as there is credit for
  const auto outcomes = wire_to_one_that_is_stopped();
  system.set("caller", "call=send_burst go=1 every=50 payload=300000");
  system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; });
  ::kill(far, SIGKILL);
  system.eventually("counted", [&] { return system.port("caller.orders").dropped() >= kSent - kOnTheirWay; });
  EXPECT_LE(system.port("caller.orders").dropped(), kSent);
}

TEST_P(AccountingOfTheKilled, SamplesAndEventsThatHaveNotLeftForItAreCountedAsDropped) {
  constexpr std::uint64_t kPut = 50;
  constexpr std::uint64_t kOnTheirWay = 14;
  system.load_client("customer", "customer", "payload=300000");
  system.load_provider("supplier", "supplier", "period_ms=1 payload=300000");
  system.wire("customer.samples", "supplier.samples");
  system.wire("customer.bell", "supplier.bell");
  system.set("customer", "rings=true");
  system.eventually("activated", [&] { return system.read("customer.activated").payload() == "ok"; });
  far = system.far_process();
  stop_process(far);
  system.set("supplier", "count=50");
  system.eventually("some are lost", [&] { return system.read("supplier.samples.dropped").value() > 0; });
  system.eventually("all put", [&] { return system.read("supplier.puts").value() == kPut; });
  ::kill(far, SIGKILL);
  for (const char* port : {"supplier.samples", "supplier.bell"}) {
    const auto dropped = [&] { return system.port(port).dropped(); };
    system.eventually("counted", [&] { return dropped() >= kPut - kOnTheirWay; });
    EXPECT_LE(dropped(), kPut) << port;
  }
}

class AccountingOfTheCut : public Accounting {
 protected:
  /// Of all links.
  std::uint64_t late() {
    std::uint64_t all = 0;
    const auto snapshot = system.system().snapshot();
    for (const auto& group : snapshot.groups()) all += group.links().late();
    return all;
  }
};

TEST_P(AccountingOfTheCut, WhatIsOnItsWayIsDeliveredOrCountedByTheLinks) {
  constexpr std::uint64_t kPut = 10;
  put(kPut, 100'000);
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  const auto puts = system.watch("source.newest");  // behind the wire: what is seen here has been put for that
  const pid_t far = system.far_process();
  stop_process(far);
  system.state("source", "active");
  system.wait_for(puts, [](const auto& one) { return one.number() == kPut; });
  std::thread later([far] {  // it has both to read, the samples and that they are not for it any more
    std::this_thread::sleep_for(100ms);
    ::kill(far, SIGCONT);
  });
  system.unwire("sink.each");
  later.join();
  system.eventually("accounted for", [&] { return accounted("sink.each") + late() == kPut; });
}

/// There a send is ok before it can be known whether it finds room.
TEST(AccountingVirtual, OfMoreSendsThanAQueueHoldsAddsUp) {
  constexpr std::uint64_t kSends = 20'000;
  RunningSystem system(2, 20s);
  system.set("host", "clock=virtual");
  system.load_in("", "caller", "caller");
  system.load_in("", "sink", "sink");
  system.wire("caller.orders", "sink.orders");
  system.set("caller", "call=send_burst go=1 every=" + std::to_string(kSends));
  EXPECT_TRUE(system.let_pass(1s).has_met());
  const auto port = system.port("sink.orders");
  EXPECT_GT(port.refused(), 0U);
  EXPECT_EQ(port.refusal(), "the provider's queue is full");
  EXPECT_EQ(port.messages() + port.refused(), kSends);
}

FIONA_OVER_EVERY_TRANSPORT(Accounting);
FIONA_OVER(AccountingOfTheCut, Transport::Ipc, Transport::Tcp);
FIONA_OVER(AccountingOfTheKilled, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
