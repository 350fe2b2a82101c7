// Promise R1: a component that ends its process hurts nobody else. Each kind of death of the zoo, in a group with a
// station that others look at, beside traffic that must not notice. FIONA_DEATHS sets how often each kind.
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <iostream>
#include <thread>

#include <fmt/format.h>

#include "campaign.hpp"
#include "fiona/result.hpp"
#include "os/process.hpp"

namespace fiona::conformance {
namespace {

constexpr double kSeen_ms = 50;
constexpr double kLost_ms = 200;
constexpr double kBack_ms = 500;
constexpr double kLater_ms = 5;

/// When a process ends, as the kernel tells it.
class Passing {
 public:
  explicit Passing(pid_t process)
      : process_(static_cast<int>(::syscall(SYS_pidfd_open, process, 0))), watch_([this] {
          pollfd end{process_.get(), POLLIN, 0};
          if (::poll(&end, 1, 20'000) == 1) at_ns_ = now_ns();
        }) {}
  ~Passing() { watch_.join(); }
  std::int64_t at_ns() const { return at_ns_; }  ///< 0: not yet

 private:
  const os::Descriptor process_;
  std::atomic<std::int64_t> at_ns_{0};
  std::thread watch_;
};

class Deaths : public testing::Test {
 protected:
  Deaths() {
    // Under a sanitizer they are to end as they do without.
    ::setenv("ASAN_OPTIONS", "handle_segv=0:handle_sigbus=0:abort_on_error=1:allocator_may_return_null=0", 0);
    system.load_in("", "pacer", "pacer", "period_ms=1 count=100000000");
    system.load_in("well", "stopwatch", "stopwatch", "count=100000000");
    system.wire("stopwatch.samples", "pacer.samples");
    system.load_in("well", "station", "sound");
    system.load_in("", "lookout", "witness");
    look("witness", "sound");
    system.load_in("well", "lookout", "outside");
    system.load_in("", "lookout", "inside");
    await_sight("witness");
  }
  void look(const std::string& lookout, const std::string& station) {
    for (const std::string port : {"timed", "samples", "echo"}) system.wire(lookout + "." + port, station + "." + port);
  }
  void await_sight(const std::string& lookout) {
    system.eventually(lookout + " sees", [&] { return sighting(system, lookout).sees; });
  }
  void load_patient(const std::string& library, const std::string& group) {
    control::Change change;
    change.mutable_load()->set_plugin(fmt::format("{}/lib{}.so", ZOO_DIRECTORY, library));
    change.mutable_load()->set_instance("patient");
    change.mutable_load()->set_group(group);
    system.system().perform(change);
  }
  static double ms(std::int64_t from_ns, std::int64_t to_ns) { return static_cast<double>(to_ns - from_ns) / 1e6; }

  /// One death in a group of its own, so that each is its first.
  void die(const std::string& library, const std::string& group) {
    system.load_in(group, "station", "station");
    for (const std::string lookout : {"inside", "outside"}) look(lookout, "station");
    for (const std::string lookout : {"inside", "outside"}) await_sight(lookout);
    const pid_t process = system.group(group).process();
    const Passing passing(process);
    const std::int64_t loaded_ns = now_ns();
    load_patient(library, group);
    system.eventually("it is seen that it died", [&] { return system.instance("patient").mode() == "failed"; });
    const std::int64_t seen_ns = now_ns();
    system.unload("patient");  // or it would die again
    system.eventually("the kernel tells it too", [&] { return passing.at_ns() > 0; });
    seen.add(ms(passing.at_ns(), seen_ns));
    system.eventually("it is back", [&] {
      const auto now = system.group(group);
      return now.alive() && now.process() != process && system.instance("station").mode() == "active";
    });
    back.add(ms(passing.at_ns(), now_ns()));
    for (const std::string lookout : {"inside", "outside"}) {
      await_sight(lookout);
      const Sighting sight = take_sighting(system, lookout);
      EXPECT_GE(sight.lost_ns, loaded_ns) << lookout << " was not told";
      lost.add(std::max(0.0, ms(passing.at_ns(), sight.lost_ns)));
    }
    system.unload("station");
  }
  void tell(const std::string& what, double bound_ms, const Times& times) const {
    std::cout << times.text(what, bound_ms) << "\n";
    EXPECT_LE(times.longest(), allowed(bound_ms, full) + pulse.longest_ms()) << what;
  }

  const bool full = number_from("FIONA_DEATHS", 0) > 0;
  RunningSystem system{RunningSystem::RestartsGroups()};
  Pulse pulse;
  Times seen, lost, back;
};

TEST_F(Deaths, OfEachKindAreSeenToldAndMendedAndNobodyElseNotices) {
  system.eventually("traffic", [&] { return system.port("stopwatch.samples").messages() > 500; });
  const double calm_ms = system.port("stopwatch.samples").latency_p99_ms();
  take_sighting(system, "witness");
  double worst_ms = 0;
  int deaths = 0;
  for (int round = 0; round < number_from("FIONA_DEATHS", 1); ++round) {
    for (const std::string library :
         {"reads-nowhere", "aborts", "overflows-stack", "frees-twice", "exits", "kills-itself", "throws-from-thread"}) {
      die(library, fmt::format("cage{}", ++deaths));
      ASSERT_FALSE(HasFatalFailure());
      worst_ms = std::max(worst_ms, system.port("stopwatch.samples").latency_p99_ms());
    }
  }
  tell("death seen", kSeen_ms, seen);
  tell("those who looked at it told", kLost_ms, lost);
  tell("group back, and active", kBack_ms, back);
  const Sighting witness = sighting(system, "witness");
  const auto ok = static_cast<std::size_t>(Outcome::Ok);
  ASSERT_GT(witness.outcomes.size(), ok);
  EXPECT_EQ(witness.outcomes[ok] + witness.open, witness.asked) << "answers lost by who did not die";
  EXPECT_EQ(system.port("stopwatch.samples").dropped(), 0U);
  std::cout << fmt::format(
      "{} deaths; others: {} answers, {} messages, 0 lost; p99 of a message {:.2f} ms in calm, {:.2f} ms at worst "
      "(bound "
      "+ {:.0f} ms); the machine stood still for {:.0f} ms at most\n",
      deaths, witness.outcomes[ok], system.port("stopwatch.samples").messages(), calm_ms, worst_ms, kLater_ms,
      pulse.longest_ms());
  EXPECT_LE(worst_ms, calm_ms + allowed(kLater_ms, full) + pulse.longest_ms());
}

}  // namespace
}  // namespace fiona::conformance
