// Promise R10: a consumer that stands still hurts itself only. One publisher, one consumer that is well and one whose
// process is stopped. FIONA_STOPPED_S sets for how long; then it is 1 MiB at 100 Hz, else what a sanitizer keeps up
// with.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <iostream>

#include <fmt/format.h>

#include "campaign.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

TEST(StoppedConsumer, HurtsItselfOnlyAndKnowsWhatItMissed) {
  const int stopped_s = number_from("FIONA_STOPPED_S", 3);
  const bool in_full = number_from("FIONA_STOPPED_S", 0) > 0;
  const double period_ms = in_full ? 10 : 20;
  const auto count = static_cast<std::uint64_t>((stopped_s + 2) * 1000 / period_ms);
  RunningSystem system;
  system.load_provider(
      "pacer", "pacer",
      fmt::format("neutral payload={} period_ms={} count={}", in_full ? 1048576 : 262144, period_ms, count));
  system.load_in("frozen", "sink", "frozen");
  system.load_in("well", "sink", "well");
  for (const char* sink : {"frozen", "well"}) {
    system.wire(std::string(sink) + ".each", "pacer.samples");
    system.eventually("connected",
                      [&] { return system.port(std::string(sink) + ".each").connection() == control::CONNECTED; });
  }
  const pid_t process = system.group("frozen").process();
  const std::vector<pid_t> all = processes(system.system());
  const auto well = system.watch("well.report");
  system.state("pacer", "active");
  system.wait_for(well, [](const auto& one) { return one.number() > 10; });
  const Holdings before = holdings(all);
  ASSERT_EQ(::kill(process, SIGSTOP), 0);
  const auto stopped_until = std::chrono::steady_clock::now() + std::chrono::seconds(stopped_s);
  // Nothing is asked of the group meanwhile: that would wait for it.
  system.eventually(
      "the end of the stop", [&] { return std::chrono::steady_clock::now() > stopped_until; },
      std::chrono::seconds(stopped_s + 10));
  const Holdings during = holdings(all);
  ::kill(process, SIGCONT);

  const auto adds_up = [&](const std::string& port) {
    const auto status = system.port(port);
    return status.messages() + status.dropped() == count;
  };
  system.eventually(
      "each message was received or counted as lost", [&] { return adds_up("frozen.each") && adds_up("well.each"); },
      std::chrono::seconds(stopped_s + 60));
  EXPECT_EQ(system.port("well.each").dropped(), 0U);
  if (!kKeepsWhatIsFreed) {
    EXPECT_LT(during.resident_mib - before.resident_mib, 24) << "two windows of 4 MiB, and what the allocator keeps";
  }
  const auto dropped = system.port("frozen.each").dropped();
  EXPECT_GT(dropped, 0U);
  const double longest_ms = system.read("pacer.longest_put").value();
  EXPECT_LT(longest_ms, stopped_s * 1000 / 2.0) << "the publisher does not wait for it";
  std::cout << fmt::format(
      "{} s stopped: {} of {} messages lost by it, none by the other; longest put {:.2f} ms; memory of all processes "
      "{:+.1f} MiB\n",
      stopped_s, dropped, count, longest_ms, during.resident_mib - before.resident_mib);
}

}  // namespace
}  // namespace fiona::conformance
