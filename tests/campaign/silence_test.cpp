// Promise R9: silence is never taken for safety. Providers are killed, stopped and cut off; those who look at them are
// told in time, and meanwhile are not given what is older than two periods as a value of now. FIONA_SILENCES sets how
// often, FIONA_SEED which. What a person's page shows of it comes with that page.
#include <gtest/gtest.h>
#include <signal.h>

#include <iostream>
#include <random>

#include <fmt/format.h>

#include "cable.hpp"
#include "campaign.hpp"

namespace fiona::conformance {
namespace {

constexpr double kDeath_ms = 300;
constexpr double kHang_ms = 1000;
constexpr double kCut_ms = 1500;
constexpr double kLate_ms = 100;
constexpr int kStations = 4;

class Silence : public testing::Test {
 protected:
  Silence() {
    RecordProperty("seed", static_cast<int>(seed));
    std::cout << "seed " << seed << "\n";
  }
  int pick(int below) { return std::uniform_int_distribution<int>(0, below - 1)(random); }

  static void look(RunningSystem& system, const std::string& lookout, const std::string& station) {
    for (const std::string port : {"timed", "samples", "echo"}) system.wire(lookout + "." + port, station + "." + port);
  }
  static void await_sight(RunningSystem& system, const std::string& lookout) {
    system.eventually(
        lookout + " sees", [&] { return sighting(system, lookout).sees; }, std::chrono::seconds(20));
  }
  /// One that joins late has the current value soon.
  void join_late(RunningSystem& system, const std::string& lookout, const std::string& station) {
    take_sighting(system, lookout);
    const std::int64_t begun_ns = now_ns();
    system.wire(lookout + ".last", station + ".last");
    system.eventually("the last value comes", [&] { return sighting(system, lookout).last_ns > 0; });
    late.add(static_cast<double>(sighting(system, lookout).last_ns - begun_ns) / 1e6);
    system.unwire(lookout + ".last");
  }
  /// Milliseconds from then until the lookout was told. It must have nothing old in hand meanwhile.
  double told_ms(RunningSystem& system, const std::string& lookout, std::int64_t since_ns) {
    Sighting seen;
    system.eventually(
        lookout + " is told", [&] { return (seen = sighting(system, lookout)).lost_ns >= since_ns; },
        std::chrono::seconds(15));
    EXPECT_FALSE(seen.sees);
    return static_cast<double>(seen.lost_ns - since_ns) / 1e6;
  }
  void check_sight(RunningSystem& system, const std::string& lookout) {
    const Sighting seen = take_sighting(system, lookout);
    EXPECT_LE(seen.oldest_shown_ms, kTwoPeriods_ms + clock_error_ms + pulse.longest_ms())
        << lookout << " was given an old value for one of now";
    oldest_shown_ms = std::max(oldest_shown_ms, seen.oldest_shown_ms);
  }
  void tell(const std::string& what, double bound_ms, const Times& times, bool in_full) {
    expect_within(what, bound_ms, times, in_full, pulse);
  }
  void tell_rest(bool in_full) {
    tell("current value to a late joiner", kLate_ms, late, in_full);
    std::cout << fmt::format(
        "oldest value given for one of now: {:.1f} ms (bound {:.0f} ms: two periods, and {:.0f} ms that clocks may "
        "differ); "
        "the machine stood still for {:.0f} ms at most\n",
        oldest_shown_ms, kTwoPeriods_ms + clock_error_ms, clock_error_ms, pulse.longest_ms());
  }

  const unsigned seed =
      static_cast<unsigned>(number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000)));
  std::mt19937 random{seed};
  const bool full = number_from("FIONA_SILENCES", 0) > 0;
  Pulse pulse;
  Times late;
  double clock_error_ms = 0;  ///< of what comes from another host
  double oldest_shown_ms = 0;
};

TEST_F(Silence, OfAGroupThatIsKilledOrHangsIsToldInTime) {
  const int rounds = full ? number_from("FIONA_SILENCES", 0) * 7 / 10 : 6;
  RunningSystem system(host::HostOptions{}, RunningSystem::EndsHungGroups());
  const auto station = [](int i) { return fmt::format("station{}", i); };
  const auto inside = [](int i) { return fmt::format("inside{}", i); };
  const auto outside = [](int i) { return fmt::format("outside{}", i); };
  for (int i = 0; i < kStations; ++i) {
    system.load_in(fmt::format("g{}", i), "station", station(i));
    system.load_in("", "lookout", inside(i));
    system.load_in("well", "lookout", outside(i));
    for (const auto& lookout : {inside(i), outside(i)}) look(system, lookout, station(i));
  }
  for (int i = 0; i < kStations; ++i) {
    for (const auto& lookout : {inside(i), outside(i)}) await_sight(system, lookout);
  }
  Times death, hang;
  for (int round = 0; round < rounds; ++round) {
    const int i = pick(kStations);
    const bool hangs = full ? pick(2) == 1 : round % 2 == 1;
    join_late(system, round % 2 == 0 ? inside(i) : outside(i), station(i));
    let_be(system, std::chrono::milliseconds(pick(60)));
    const pid_t process = system.group(fmt::format("g{}", i)).process();
    const std::int64_t begun_ns = now_ns();
    ASSERT_EQ(::kill(process, hangs ? SIGSTOP : SIGKILL), 0);
    for (const auto& lookout : {inside(i), outside(i)}) (hangs ? hang : death).add(told_ms(system, lookout, begun_ns));
    const std::string reason = system.port(inside(i) + ".timed").reason();
    EXPECT_NE(reason.find(hangs ? "stood still for" : "killed by signal 9"), std::string::npos) << reason;
    for (const auto& lookout : {inside(i), outside(i)}) check_sight(system, lookout);
    system.unload(station(i));
    system.load_in(fmt::format("g{}", i), "station", station(i));
    for (const auto& lookout : {inside(i), outside(i)}) await_sight(system, lookout);
  }
  tell("loss told after the death of a group", kDeath_ms, death, full);
  tell("loss told after a group has hung", kHang_ms, hang, full);
  tell_rest(full);
}

TEST_F(Silence, OfAnotherHostThatIsKilledOrHangsOrIsCutOffIsToldInTime) {
  const int rounds = full ? number_from("FIONA_SILENCES", 0) * 3 / 10 : 3;
  Cable cable;
  if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
  const TemporaryDirectory directory;
  OtherHost other(directory.path, "far", {.listen = cable.there() + ":0", .network = cable.network()});
  RunningSystem system(other.led_from(directory.path / "test"), RunningSystem::EndsHungGroups());
  const auto load_far = [&] {
    system.load_in("far", "station", "away");
    system.load_in("far", "lookout", "there");
    look(system, "there", "near");
  };
  system.join("far");
  system.load_in("", "station", "near");
  load_far();
  system.load_in("", "lookout", "here");
  system.load_in("well", "lookout", "beside");
  for (const std::string lookout : {"here", "beside"}) look(system, lookout, "away");
  for (const std::string lookout : {"here", "beside", "there"}) await_sight(system, lookout);
  clock_error_ms = kClockError_ms;
  Times death, hang, cut, cut_there, back;
  enum Fate { Dies, Hangs, IsCutOff };
  for (int round = 0; round < rounds; ++round) {
    const Fate fate = static_cast<Fate>(full ? pick(3) : round % 3);
    join_late(system, round % 2 == 0 ? "here" : "beside", "away");
    let_be(system, std::chrono::milliseconds(pick(60)));
    const std::int64_t begun_ns = now_ns();
    if (fate == IsCutOff) {
      cable.pull();
    } else {
      ASSERT_EQ(::kill(other.process(), fate == Dies ? SIGKILL : SIGSTOP), 0);
    }
    for (const std::string lookout : {"here", "beside"}) {
      (fate == Dies ? death : fate == Hangs ? hang : cut).add(told_ms(system, lookout, begun_ns));
      check_sight(system, lookout);
    }
    if (fate == IsCutOff) let_be(system, std::chrono::milliseconds(1500));  // the other side notices as well
    if (fate == Dies) other.restart();
    if (fate == Hangs) ::kill(other.process(), SIGCONT);
    if (fate == IsCutOff) cable.plug();
    const std::int64_t healed_ns = now_ns();
    if (fate == Dies) {
      system.join("far");
      for (const std::string gone : {"away", "there"}) {
        system.eventually("known to be gone",
                          [&] { return system.instance(gone).reason() == "host 'far' was started anew"; });
        system.unload(gone);
      }
      load_far();
    }
    for (const std::string lookout : {"here", "beside"}) await_sight(system, lookout);
    if (fate != Dies) back.add(static_cast<double>(sighting(system, "here").seen_ns - healed_ns) / 1e6);
    system.eventually("the far side is back",
                      [&] { return system.port("there.timed").connection() == control::CONNECTED; });
    await_sight(system, "there");
    if (fate == IsCutOff) cut_there.add(static_cast<double>(sighting(system, "there").lost_ns - begun_ns) / 1e6);
    check_sight(system, "there");
  }
  tell("loss told after the death of another host", kCut_ms, death, full);
  tell("loss told after another host has hung", kCut_ms, hang, full);
  tell("loss told after a cut", kCut_ms, cut, full);
  tell("loss told after a cut, on the other side", kCut_ms, cut_there, full);
  tell("seen again after a hang or cut", 5000, back, full);
  tell_rest(full);
}

}  // namespace
}  // namespace fiona::conformance
