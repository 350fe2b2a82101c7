// Nothing stays behind of instances that come and go: load, wire, hear, unwire, unload, again and again, each time
// under new names. FIONA_CYCLES sets how often.
#include <gtest/gtest.h>

#include <iostream>

#include <fmt/format.h>

#include "campaign.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

/// One cycle in so many has its consumers in a group that comes and goes with it.
constexpr int kOtherGroup = 25;
/// In full; of all processes together.
constexpr double kGrowth_mib = 1;

class Cycles : public testing::TestWithParam<Transport> {
 protected:
  /// So that the processes stay when the last of those that come and go has gone.
  Cycles() {
    system.load_provider("source", "stays_here", "neutral");
    system.load_client("sink", "stays_there", "neutral");
    staying = processes(system).size();
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
    if (cycle % kOtherGroup != 0) return system.load_client(component, name, parameters);
    const bool is_led = GetParam() == Transport::Tcp && cycle % (2 * kOtherGroup) == 0;
    system.load_in(is_led ? "far/other" : "other", component, name, parameters);
  }
  /// Once the group that came and went has gone.
  Holdings settled() {
    std::vector<pid_t> all;
    system.eventually("no process is there but those that stay", [&] {
      all = processes(system);
      return all.size() == staying;
    });
    return holdings(all);
  }

  RunningSystem system{GetParam()};
  std::size_t staying = 0;
};

TEST_P(Cycles, OfLoadWireUnwireUnloadLeaveNothingBehind) {
  const int cycles = number_from("FIONA_CYCLES", 60);
  const bool in_full = number_from("FIONA_CYCLES", 0) > 0;
  Holdings warm;
  for (int i = 1; i <= cycles + kWarmUp; ++i) {
    run(i);
    if (i == kWarmUp) warm = settled();
  }
  Holdings after;
  try {
    system.eventually("what has ended is let go of", [&] {
      after = settled();
      return after.descriptors <= warm.descriptors && after.sockets <= warm.sockets;
    });
  } catch (const std::exception&) {  // told below
  }
  EXPECT_EQ(system.system().snapshot().instances_size(), 2);
  EXPECT_LE(after.descriptors, warm.descriptors);
  EXPECT_LE(after.sockets, warm.sockets);
  EXPECT_LE(after.threads, warm.threads);
  if (!kKeepsWhatIsFreed) {
    EXPECT_LE(after.memory_mib() - warm.memory_mib(), allowed(kGrowth_mib, in_full)) << "whatever the number of cycles";
  }
  std::cout << fmt::format(
      "{} cycles, {} processes: descriptors {} {:+d}, sockets {} {:+d}, threads {} {:+d}, memory {:.1f} MiB {:+.2f}\n",
      cycles, staying, warm.descriptors, after.descriptors - warm.descriptors, warm.sockets,
      after.sockets - warm.sockets, warm.threads, after.threads - warm.threads, warm.memory_mib(),
      after.memory_mib() - warm.memory_mib());
}

INSTANTIATE_TEST_SUITE_P(Over, Cycles, testing::Values(Transport::Process, Transport::Ipc, Transport::Tcp),
                         [](const auto& tested) { return to_string(tested.param); });

}  // namespace
}  // namespace fiona::conformance
