// Nothing stays behind of instances that come and go: load, wire, hear, unwire, unload, again and again, each time
// under new names. FIONA_CYCLES sets how often.
#include <gtest/gtest.h>

#include <iostream>

#include <fmt/format.h>

#include "campaign.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

/// One cycle in so many has its consumers in another group than the others.
constexpr int kOtherGroup = 25;

class Cycles : public testing::TestWithParam<Transport> {
 protected:
  /// So that the processes stay when the last of those that come and go has gone.
  Cycles() {
    system.load_provider("source", "stays_here", "neutral");
    system.load_client("sink", "stays_there", "neutral");
  }
  /// Two pairs: one that pushes, one that asks, so that there is a wire of either kind.
  void run(int cycle) {
    const std::string source = fmt::format("source{}", cycle), sink = fmt::format("sink{}", cycle);
    const std::string answerer = fmt::format("answerer{}", cycle), asker = fmt::format("asker{}", cycle);
    system.load_provider("source", source, "period_ms=1");
    system.load_provider("answerer", answerer);
    load_consumer("sink", sink, "", cycle);
    load_consumer("asker", asker, "period_ms=1", cycle);
    system.wire(sink + ".each", source + ".newest");
    system.wire(asker + ".echo", answerer + ".echo");
    system.eventually("heard and answered", [&] {
      return system.port(sink + ".each").messages() > 0 && system.port(asker + ".outcome").messages() > 0;
    });
    if (cycle % 2 == 0) {  // else unloading cuts what is left
      system.unwire(sink + ".each");
      system.unwire(asker + ".echo");
    }
    for (const auto& one : {sink, asker, source, answerer}) system.unload(one);
  }
  void load_consumer(const std::string& component, const std::string& name, const std::string& parameters, int cycle) {
    if (cycle % kOtherGroup == 0) return system.load_in("other", component, name, parameters);
    system.load_client(component, name, parameters);
  }

  RunningSystem system{GetParam()};
};

TEST_P(Cycles, OfLoadWireUnwireUnloadLeaveNothingBehind) {
  const int cycles = number_from("FIONA_CYCLES", 60);
  Holdings warm;
  for (int i = 1; i <= cycles + kWarmUp; ++i) {
    run(i);
    if (i == kWarmUp) warm = holdings(processes(system));
  }
  Holdings after;
  try {
    system.eventually("what has ended is let go of", [&] {
      after = holdings(processes(system));
      return after.descriptors <= warm.descriptors && after.sockets <= warm.sockets;
    });
  } catch (const std::exception&) {  // told below
  }
  EXPECT_EQ(system.system().snapshot().instances_size(), 2);
  EXPECT_LE(after.descriptors, warm.descriptors);
  EXPECT_LE(after.sockets, warm.sockets);
  EXPECT_LE(after.threads, warm.threads);
  if (!kKeepsWhatIsFreed) {
    EXPECT_LT(after.resident_mib - warm.resident_mib, 8) << "whatever the number of cycles";
  }
  std::cout << fmt::format(
      "{} cycles: descriptors {} {:+d}, sockets {} {:+d}, threads {} {:+d}, resident {:.1f} MiB {:+.1f}\n", cycles,
      warm.descriptors, after.descriptors - warm.descriptors, warm.sockets, after.sockets - warm.sockets, warm.threads,
      after.threads - warm.threads, warm.resident_mib, after.resident_mib - warm.resident_mib);
}

INSTANTIATE_TEST_SUITE_P(Over, Cycles, testing::Values(Transport::Process, Transport::Ipc, Transport::Tcp),
                         [](const auto& tested) { return to_string(tested.param); });

}  // namespace
}  // namespace fiona::conformance
