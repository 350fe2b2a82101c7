// Promise R10: a consumer that stands still hurts itself only. One publisher of 1 MiB at 100 Hz, one consumer that is
// well and one whose process is stopped. FIONA_STOPPED_S sets for how long.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <iostream>

#include <fmt/format.h>

#include "campaign.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

constexpr double kPeriod_ms = 10;

TEST(StoppedConsumer, HurtsItselfOnlyAndKnowsWhatItMissed) {
  const int stopped_s = number_from("FIONA_STOPPED_S", 3);
  const auto count = static_cast<std::uint64_t>((stopped_s + 2) * 1000 / kPeriod_ms);
  RunningSystem system;
  system.load_provider("pacer", "pacer", fmt::format("neutral payload=1048576 period_ms={} count={}", kPeriod_ms, count));
  system.load_in("frozen", "sink", "frozen");
  system.load_in("well", "sink", "well");
  for (const char* sink : {"frozen", "well"}) {
    system.wire(std::string(sink) + ".each", "pacer.samples");
    system.eventually("connected", [&] { return system.port(std::string(sink) + ".each").connection() == control::CONNECTED; });
  }
  const auto well = system.watch("well.report");
  const auto frozen = system.watch("frozen.report");
  const pid_t process = system.group("frozen").process();
  const std::vector<pid_t> all = processes(system.system());
  system.state("pacer", "active");
  const auto is = [](std::uint64_t number) { return [number](const SeenSample& one) { return one.number() == number; }; };
  const std::chrono::seconds patience(stopped_s + 30);
  system.wait_for(well, is(50), patience);
  const Holdings before = holdings(all);
  ASSERT_EQ(::kill(process, SIGSTOP), 0);
  const auto stopped_until = 50 + static_cast<std::uint64_t>(stopped_s * 1000 / kPeriod_ms);
  system.wait_for(well, is(stopped_until), patience);
  const Holdings during = holdings(all);
  ::kill(process, SIGCONT);
  system.wait_for(well, is(count), patience);
  EXPECT_EQ(system.port("well.each").dropped(), 0U);
  EXPECT_LT(during.resident_mib - before.resident_mib, 24) << "two windows of 4 MiB, and what the allocator keeps";

  std::uint64_t seen = 0;
  system.eventually("each message was received or counted as lost", [&] {
    for (const auto& one : system.take(frozen)) seen = one.number();
    return seen + system.port("frozen.each").dropped() == count;
  });
  const auto dropped = system.port("frozen.each").dropped();
  EXPECT_GT(dropped, 0U);
  const double longest_ms = system.read("pacer.longest_put").value();
  EXPECT_LT(longest_ms, stopped_s * 1000 / 2.0) << "the publisher does not wait for it";
  std::cout << fmt::format("{} s stopped: {} of {} messages lost by it, none by the other; longest put {:.2f} ms; memory of all processes {:+.1f} MiB\n",
                           stopped_s, dropped, count, longest_ms, during.resident_mib - before.resident_mib);
}

}  // namespace
}  // namespace fiona::conformance
