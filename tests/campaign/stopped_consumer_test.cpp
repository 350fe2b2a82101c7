// Promise R10: a consumer that stands still hurts itself only, whatever it takes: samples, events or answers. One
// supplier, in this process or on another host, one customer that is well and one whose process is stopped.
// FIONA_STOPPED_S sets for how long; then a
// sample is 1 MiB at 100 Hz, else what a sanitizer keeps up with. Of a page that stands still tells
// tests/plugins/web_slow_reader_test.cpp.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <iostream>

#include <fmt/format.h>

#include "../conformance/stopped_process.hpp"
#include "campaign.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

/// That a put or an answer may be kept from going on, and that it may take, beside what the machine adds.
constexpr double kBlocked_ms = 1;
/// What a wire declares (docs/architecture.md, The way of a message): that waits for room, and that is on its way; and
/// what allocators keep. The promise has the first alone: docs/promises.md, What is not held yet.
constexpr double kWaits_mib = 4, kOnItsWay_mib = 4, kAllocators_mib = 1;
constexpr double kWire_mib = kWaits_mib + kOnItsWay_mib + kAllocators_mib;
/// What a host holds that relays it, of each lane (docs/decisions/0008-hosts-over-tcp.md).
constexpr double kRelayed_mib = 4;
/// Events and answers are no stream of large samples: a stop of so long is as good as one of ten minutes.
constexpr int kLongest_s = 60;
constexpr std::uint32_t kEvent_bytes = 128 * 1024;
constexpr std::uint64_t kQuestions = 96;
constexpr std::uint32_t kAnswer_bytes = 256 * 1024;

/// Over ipc the supplier is in the host's own process; over tcp in that of another host, and what it sends is relayed.
class StoppedConsumer : public testing::TestWithParam<Transport> {
 protected:
  void load(std::uint32_t payload, std::uint64_t puts) {
    count = puts;
    system.load_in(GetParam() == Transport::Tcp ? "far" : "", "supplier", "supplier",
                   fmt::format("neutral payload={} period_ms={} count={}", payload, period_ms, puts));
    for (const std::string customer : {"frozen", "well"}) system.load_in(customer, "customer", customer);
  }
  void wire(const std::string& port, const std::string& supplied) {
    for (const std::string customer : {"frozen", "well"}) {
      system.wire(customer + "." + port, "supplier." + supplied);
      system.eventually("connected",
                        [&] { return system.port(customer + "." + port).connection() == control::CONNECTED; });
    }
  }
  /// Nothing is asked of the frozen group until `go_on`: that would wait for it.
  void stop() {
    frozen = system.group("frozen").process();
    all = processes(system);
    before = holdings(all);
    stop_process(frozen);
  }
  void stand_still(int seconds) {
    for (int second = 0; second < seconds; ++second) {
      let_be(system, std::chrono::seconds(1));
      grown_mib = std::max(grown_mib, holdings(all).memory_mib() - before.memory_mib());
    }
  }
  void go_on() { ::kill(std::exchange(frozen, 0), SIGCONT); }
  void TearDown() override {
    if (frozen != 0) go_on();  // or nothing would end
  }
  std::uint64_t read(const std::string& probe) { return static_cast<std::uint64_t>(system.read(probe).value()); }

  /// What has reached a customer, and what it was told that it has not, is all that was put.
  void await_sum(const std::string& port) {
    system.eventually(
        "all was received or counted as lost: " + port,
        [&] {
          const auto status = system.port(port);
          return status.messages() + status.dropped() >= count;
        },
        std::chrono::seconds(stopped_s + 60));
    const auto status = system.port(port);
    EXPECT_EQ(status.messages() + status.dropped(), count) << port;
    EXPECT_EQ(status.peer().instance(), "supplier") << "whose they were";
  }
  void expect_others_were_not_hurt(const std::string& what) {
    const double blocked_ms = system.read("supplier.blocked").value();
    const double ran_p99_ms = system.read("supplier.ran_p99").value();
    std::cout << fmt::format(
        "{}: a call was blocked for {:.2f} ms at most (bound {:.0f} ms), took {:.2f} ms of a processor (p99, bound "
        "{:.0f} ms), and {:.2f} ms at most with what it waited for one; memory of all processes {:+.1f} MiB (bound "
        "{:.0f} "
        "MiB)\n",
        what, blocked_ms, kBlocked_ms, ran_p99_ms, kBlocked_ms, system.read("supplier.longest").value(), grown_mib,
        most_mib);
    EXPECT_LE(ran_p99_ms, allowed(kBlocked_ms, in_full));
    if (FIONA_SANITIZED) return;  // its allocator keeps memory, and has locks that threads wait for
    EXPECT_LE(blocked_ms, allowed(kBlocked_ms, in_full)) << "the supplier waits for who stands still";
    EXPECT_LE(grown_mib, most_mib);
  }

  /// For ten minutes over ipc.
  const int stopped_s = GetParam() == Transport::Tcp ? std::min(kLongest_s, number_from("FIONA_STOPPED_S", 3))
                                                     : number_from("FIONA_STOPPED_S", 3);
  const bool in_full = number_from("FIONA_STOPPED_S", 0) > 0;
  const double period_ms = in_full ? 10 : 20;
  const double most_mib = kWire_mib + (GetParam() == Transport::Tcp ? kRelayed_mib : 0);
  RunningSystem system{GetParam()};
  std::uint64_t count = 0;
  pid_t frozen = 0;
  std::vector<pid_t> all;
  Holdings before;
  double grown_mib = 0;  ///< at most, of all processes, while it stands still
};

TEST_P(StoppedConsumer, OfSamplesHurtsItselfOnlyAndKnowsWhatItMissed) {
  const std::uint32_t payload = in_full ? 1048576 : 262144;
  load(payload, static_cast<std::uint64_t>((stopped_s + 3) * 1000 / period_ms));
  wire("samples", "samples");
  system.state("supplier", "active");
  system.eventually("it runs", [&] { return system.port("well.samples").messages() > 40; });
  stop();
  stand_still(stopped_s);
  EXPECT_GT(read("supplier.samples.dropped"), 0U) << "told while it lasts, by who is well";
  go_on();
  await_sum("frozen.samples");
  await_sum("well.samples");
  const auto lost_by_other = system.port("well.samples").dropped();
  EXPECT_EQ(lost_by_other, 0U);
  const auto dropped = system.port("frozen.samples").dropped();
  EXPECT_GT(dropped, 0U);
  EXPECT_LE(read("supplier.samples.dropped"), dropped)
      << "it knows of all, and of those that its own queue had no room for";
  std::cout << fmt::format("{} s stopped: {} of {} samples lost by it, {} by the other\n", stopped_s, dropped, count,
                           lost_by_other);
  expect_others_were_not_hurt("samples");
}

TEST_P(StoppedConsumer, OfEventsHurtsItselfOnlyAndKnowsWhatItMissed) {
  const int seconds = std::min(stopped_s, kLongest_s);
  load(0, 0);
  wire("bell", "bell");
  system.state("supplier", "active");
  for (const std::string customer : {"frozen", "well"}) {
    system.set(customer, fmt::format("payload={} rings=true", kEvent_bytes));
    system.eventually("activated", [&] { return system.read(customer + ".activated").payload() == "ok"; });
  }
  count = static_cast<std::uint64_t>((seconds + 3) * 1000 / period_ms);
  system.set("supplier", fmt::format("count={}", count));
  system.eventually("it runs", [&] { return system.port("well.bell").messages() > 40; });
  stop();
  stand_still(seconds);
  EXPECT_GT(read("supplier.bell.dropped"), 0U) << "told while it lasts, by who is well";
  go_on();
  await_sum("frozen.bell");
  await_sum("well.bell");
  EXPECT_EQ(system.port("well.bell").dropped(), 0U);
  const auto dropped = system.port("frozen.bell").dropped();
  EXPECT_GT(dropped, 0U);
  EXPECT_LE(read("supplier.bell.dropped"), dropped)
      << "it knows of all, and of those that its own queue had no room for";
  for (const std::string customer : {"frozen", "well"})
    EXPECT_FALSE(system.read(customer + ".disorder").has_value) << customer << ": an event came twice, or late";
  std::cout << fmt::format("{} s stopped: {} of {} events lost by it, none by the other\n", seconds, dropped, count);
  expect_others_were_not_hurt("events");
}

TEST_P(StoppedConsumer, OfAnswersHurtsItselfOnlyAndEachOfItsQuestionsHasOneOutcome) {
  const int seconds = std::min(stopped_s, kLongest_s);
  load(kAnswer_bytes, 0);
  wire("echo", "echo");
  system.state("supplier", "active");
  system.set("frozen", fmt::format("manner=held questions={}", kQuestions));
  system.eventually("all are asked", [&] { return read("supplier.waiting") == kQuestions; });
  system.set("well", "asks=true");
  system.eventually("it runs", [&] { return read("well.ok") > 20; });
  stop();
  system.set("supplier", "answers=true");
  stand_still(seconds);
  const auto answered_meanwhile = read("well.ok");
  go_on();
  const auto ended = [&] { return read("frozen.ok") + read("frozen.refused") + read("frozen.other"); };
  system.eventually("all have ended", [&] { return ended() >= kQuestions; });
  EXPECT_EQ(ended(), kQuestions);
  EXPECT_EQ(read("frozen.other"), 0U) << "each is answered, or refused with a reason";
  EXPECT_GT(read("frozen.refused"), 0U) << "more than a wire holds";
  EXPECT_EQ(system.read("frozen.last_reason").payload(), "the answers before it have not been taken yet");
  EXPECT_FALSE(system.read("frozen.wrong").has_value);
  EXPECT_GT(answered_meanwhile, static_cast<std::uint64_t>(seconds * 20));
  EXPECT_EQ(read("well.refused") + read("well.other"), 0U);
  std::cout << fmt::format(
      "{} s stopped: {} of {} answers refused; the other had {} meanwhile, none refused, the longest after {:.1f} ms\n",
      seconds, read("frozen.refused"), kQuestions, answered_meanwhile, system.read("well.longest_answer").value());
  expect_others_were_not_hurt("answers");
}

FIONA_OVER(StoppedConsumer, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
