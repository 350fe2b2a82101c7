// Promise R3: a component that takes what it can get is bounded, and a stream of 50 Hz between others does not notice.
// Each kind of the zoo in a group of its own, with limits. FIONA_HOGS_S sets for how long each.
#include <gtest/gtest.h>
#include <unistd.h>

#include <iostream>

#include <fmt/format.h>

#include "campaign.hpp"

namespace fiona::conformance {
namespace {

constexpr double kHogLate_ms = 20;
constexpr double kHogGrowth_MiB = 5;

class Hogs : public testing::Test {
 protected:
  Hogs() {
    system.load_in("", "pacer", "pacer", "period_ms=20 count=100000000");
    system.load_in("well", "stopwatch", "stopwatch", "count=100000000");
    system.wire("stopwatch.samples", "pacer.samples");
    system.eventually("traffic", [&] { return heard() > 50; });
  }
  std::uint64_t heard() { return system.port("stopwatch.samples").messages(); }
  void load_hog(const std::string& library) {
    control::Change change;
    control::Load& load = *change.mutable_load();
    load.set_plugin(fmt::format("{}/lib{}.so", ZOO_DIRECTORY, library));
    load.set_instance("hog");
    load.set_group("cage");
    load.add_rights("confined");
    system.system().perform(change);
  }

  const int seconds = number_from("FIONA_HOGS_S", 1);
  const bool full = number_from("FIONA_HOGS_S", 0) > 0;
  RunningSystem system{RunningSystem::EndsHungGroups(),
                       os::Limits{.memory = 256U << 20U, .threads = 64, .descriptors = 200, .cores = 0.5}};
  Pulse pulse;
};

TEST_F(Hogs, OfEachKindAreBoundedAndAStreamBetweenOthersDoesNotNotice) {
  if (!os::kLimitsMemory) GTEST_SKIP() << "a sanitizer takes memory of its own";
  const double calm_ms = system.port("stopwatch.samples").latency_p99_ms();
  const double before_mib = holdings({::getpid()}).resident_mib;
  double worst_ms = 0;
  std::string worst;
  for (const std::string library : {"takes-4-gib", "leaks", "maps-shared-memory", "spins", "forks",
                                    "starts-10000-threads", "leaks-descriptors", "floods-log", "floods-stderr"}) {
    load_hog(library);
    const auto since = heard();
    let_be(system, std::chrono::seconds(seconds));
    EXPECT_GE(heard() - since, static_cast<std::uint64_t>(seconds) * 50 / 2) << "beside " << library;
    const double p99_ms = system.port("stopwatch.samples").latency_p99_ms();
    if (p99_ms > worst_ms) worst = library;
    worst_ms = std::max(worst_ms, p99_ms);
    system.unload("hog");
    EXPECT_EQ(system.port("stopwatch.samples").dropped(), 0U) << "beside " << library;
  }
  const double grown_mib = holdings({::getpid()}).resident_mib - before_mib;
  std::cout << fmt::format(
      "9 hogs, {} s each: p99 of a stream of 50 Hz between others {:.2f} ms in calm, {:.2f} ms at worst, beside {} "
      "(bound {:.0f} ms); 0 of {} messages lost; the host's memory {:+.1f} MiB (bound {:.0f} MiB); the machine stood "
      "still for {:.0f} ms at most\n",
      seconds, calm_ms, worst_ms, worst, kHogLate_ms, heard(), grown_mib, kHogGrowth_MiB, pulse.longest_ms());
  EXPECT_LE(worst_ms, allowed(kHogLate_ms, full) + pulse.longest_ms());
  EXPECT_LE(grown_mib, allowed(kHogGrowth_MiB, full));
}

}  // namespace
}  // namespace fiona::conformance
