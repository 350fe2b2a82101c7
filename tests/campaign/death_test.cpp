// Promises R1, R2 and R4: a component that ends its process, or hangs, hurts nobody else, and is found in time; what
// cannot be loaded is refused in time. Each kind of the zoo, in a group with a station that others look at, beside
// traffic that must not notice. FIONA_DEATHS sets how often each kind.
#include <gtest/gtest.h>

#include <iostream>

#include <fmt/format.h>

#include "../ends_as_without_sanitizer.hpp"
#include "campaign.hpp"
#include "fiona/error.hpp"
#include "os/limits.hpp"
#include "os/process.hpp"

namespace fiona::conformance {
namespace {

/// After 1.0 s of work it hangs; when that began, and that it is over, is seen at a look, every 100 ms each.
constexpr double kHangs_ms = 1000 + 2 * 100;
constexpr double kGone_ms = 2500;
constexpr double kBadLoad_ms = 2000;
constexpr int kMostRefusals = 10;  // of each kind

class Deaths : public testing::Test {
 protected:
  Deaths() {
    tests::end_as_without_sanitizer();
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

  /// A group of its own, so that each end is its first, with a station that others look at.
  void open(const std::string& group) {
    system.load_in(group, "station", "station");
    for (const std::string lookout : {"inside", "outside"}) look(lookout, "station");
    for (const std::string lookout : {"inside", "outside"}) await_sight(lookout);
  }
  void die(const std::string& library, const std::string& group) {
    open(group);
    const pid_t process = system.group(group).process();
    const Passing passing(process);
    const std::int64_t loaded_ns = now_ns();
    load_patient(library, group);
    system.eventually("it is seen that it died", [&] { return system.instance("patient").mode() == "failed"; });
    const std::int64_t seen_ns = now_ns();
    system.unload("patient");  // or it would die again
    system.eventually("the kernel tells it too", [&] { return passing.at_ns() > 0; });
    seen.add(ms(passing.at_ns(), seen_ns));
    mend(group, process, passing.at_ns(), loaded_ns);
  }
  /// It hangs 20 ms after it was loaded, or when it is unloaded. For what it waits for a processor it is excused.
  void hang(const std::string& library, const std::string& group) {
    open(group);
    const pid_t process = system.group(group).process();
    const Passing passing(process);
    load_patient(library, group);
    const bool at_its_end = library == "blocks-in-destructor";
    const std::int64_t begun_ns = now_ns() + (at_its_end ? 0 : 20'000'000);
    if (at_its_end) system.unload("patient");
    const auto before = os::time_waiting_for_cpu(process);
    std::chrono::nanoseconds waited{0};
    system.eventually("it is seen that it hangs", [&] {
      waited = std::max(waited, os::time_waiting_for_cpu(process) - before);  // 0: it has gone
      return system.instance("station").mode() == "failed";
    });
    const double waited_ms = static_cast<double>(waited.count()) / 1e6;
    const double in_all_ms = ms(begun_ns, now_ns());
    longest_hang_ms = std::max(longest_hang_ms, in_all_ms);
    hung.add(in_all_ms - waited_ms);
    if (!at_its_end) system.unload("patient");  // or it would hang again
    system.eventually("it has gone", [&] { return passing.at_ns() > 0; });
    gone.add(ms(begun_ns, passing.at_ns()) - waited_ms);
    mend(group, process, passing.at_ns(), begun_ns);
  }
  /// It is back, active and looked at again, and those who look were told.
  void mend(const std::string& group, pid_t process, std::int64_t ended_ns, std::int64_t since_ns) {
    system.eventually("it is back", [&] {
      const auto now = system.group(group);
      return now.alive() && now.process() != process && system.instance("station").mode() == "active";
    });
    back.add(ms(ended_ns, now_ns()));
    for (const std::string lookout : {"inside", "outside"}) {
      await_sight(lookout);
      const Sighting sight = take_sighting(system, lookout);
      EXPECT_GE(sight.lost_ns, since_ns) << lookout << " was not told";
      lost.add(std::max(0.0, ms(ended_ns, sight.lost_ns)));
    }
    system.unload("station");
  }
  void refuse(const std::string& library, const std::string& group) {
    const std::int64_t begun_ns = now_ns();
    EXPECT_THROW(load_patient(library, group), Error) << library << " was loaded";
    refused.add(ms(begun_ns, now_ns()));
  }
  void tell(const std::string& what, double bound_ms, const Times& times) const {
    expect_within(what, bound_ms, times, full, pulse);
  }

  std::string next_cage() {
    worst_ms = std::max(worst_ms, system.port("stopwatch.samples").latency_p99_ms());
    return fmt::format("cage{}", ++cages);
  }
  void begin() {
    system.eventually("traffic", [&] { return system.port("stopwatch.samples").messages() > 500; });
    calm_ms = system.port("stopwatch.samples").latency_p99_ms();
    take_sighting(system, "witness");
  }
  void expect_others_noticed_nothing() {
    next_cage();
    const Sighting witness = sighting(system, "witness");
    expect_all_answered(witness);
    EXPECT_EQ(system.port("stopwatch.samples").dropped(), 0U);
    std::cout << fmt::format(
        "{} groups; others: {} answers, {} messages, 0 lost; p99 of a message {:.2f} ms in calm, {:.2f} ms at worst "
        "(bound + {:.0f} ms); the machine stood still for {:.0f} ms at most\n",
        cages - 1, witness.asked - witness.open, system.port("stopwatch.samples").messages(), calm_ms, worst_ms,
        kOthersLater_ms, pulse.longest_ms());
    EXPECT_LE(worst_ms, calm_ms + allowed(kOthersLater_ms, full) + pulse.longest_ms());
  }

  const int rounds = number_from("FIONA_DEATHS", 1);
  const bool full = number_from("FIONA_DEATHS", 0) > 0;
  RunningSystem system{RunningSystem::RestartsGroups()};
  Pulse pulse;
  int cages = 0;
  double calm_ms = 0, worst_ms = 0, longest_hang_ms = 0;
  Times seen, lost, back, hung, gone, refused;
};

TEST_F(Deaths, OfEachKindAreSeenToldAndMendedAndNobodyElseNotices) {
  begin();
  for (int round = 0; round < rounds; ++round) {
    for (const std::string library :
         {"reads-nowhere", "aborts", "overflows-stack", "frees-twice", "exits", "kills-itself", "throws-from-thread"}) {
      die(library, next_cage());
      ASSERT_FALSE(HasFatalFailure());
    }
  }
  tell("death seen", kDeathSeen_ms, seen);
  tell("those who looked at it told", kDeathTold_ms, lost);
  tell("group back, and active", kBackAfterDeath_ms, back);
  expect_others_noticed_nothing();
}

TEST_F(Deaths, OfWhatHangsComeInTimeAndNobodyElseNotices) {
  begin();
  for (int round = 0; round < rounds; ++round) {
    for (const std::string library :
         {"loops", "locks-itself-out", "blocks-in-destructor", "stops-itself", "ignores-sigterm"}) {
      hang(library, next_cage());
      ASSERT_FALSE(HasFatalFailure());
    }
  }
  tell("hang seen", kHangs_ms, hung);
  tell("its process gone", kGone_ms, gone);
  std::cout << fmt::format("with what they waited for a processor {:.0f} ms at most\n", longest_hang_ms);
  tell("those who looked at it told", kDeathTold_ms, lost);
  tell("group back, and active", kBackAfterDeath_ms, back);
  expect_others_noticed_nothing();
}

TEST_F(Deaths, OfWhatCannotBeLoadedAreRefusedInTimeAndNobodyElseNotices) {
  begin();
  for (int round = 0; round < std::min(rounds, kMostRefusals); ++round) {
    for (const std::string library :
         {"traps-when-opened", "throws-when-opened", "exits-when-opened", "hangs-when-opened", "missing-symbol",
          "no-entry", "other-abi", "other-strings", "null-entry", "null-declare", "throws-in-factory"}) {
      refuse(library, "");
      refuse(library, next_cage());
    }
    refuse("blocks-in-constructor", next_cage());
  }
  tell("bad load refused", kBadLoad_ms, refused);
  expect_others_noticed_nothing();
}

}  // namespace
}  // namespace fiona::conformance
