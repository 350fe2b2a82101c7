// Promise R19: what a bad way between two hosts does, and what it does not. Pulled cables, loss, a slow way (veth, nft,
// tbf), delay, packets late and twice (a relay of our own). FIONA_PARTITIONS=1: all of them, and for as long as the
// promise says; FIONA_SEED what chance does in the relay.
#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "cable.hpp"
#include "campaign.hpp"
#include "fiona/result.hpp"
#include "relay.hpp"

namespace fiona::conformance {
namespace {

constexpr double kBeyondDeadline_ms = 100;
constexpr double kMaxAge_ms = 500;
/// Where nothing comes: on either side.
constexpr double kShown_ms = 1500;
constexpr const char* kSilentLeader = "which leads, has been silent for";

bool partitions_in_full() { return number_from("FIONA_PARTITIONS", 0) > 0; }

/// What is wrong with the way, for how long, and what follows from it. A second may pass unnoticed: silence is called
/// so after one.
struct Trouble {
  std::string name;
  int seconds = 0;
  bool pulled = false;       ///< the cable
  bool shown = false;        ///< both sides must show it
  double back_ms = 5000;     ///< until all is well again
  double round_trip_ms = 0;  ///< of the way
  std::string station{};     ///< parameters of the stations
  int there_percent = 0;     ///< lost on the way there
  int here_percent = 0;
  std::string rate{};
  double answered = 0;  ///< of the questions that end meanwhile: the least share that comes through
  double heard_hz = 0;  ///< the same, of the samples
};
void PrintTo(const Trouble& trouble, std::ostream* out) { *out << trouble.name; }

class Partition : public testing::Test {
 protected:
  /// Two hosts; on each a station, and a lookout for the other's.
  void meet(const Network& network, const std::string& parameters) {
    other = std::make_unique<OtherHost>(
        directory.path, "far", OtherHost::Choice{.listen = network.there() + ":0", .network = network.network()});
    system = std::make_unique<RunningSystem>(other->led_from(directory.path / "test"));
    system->join("far");
    system->load_in("", "station", "near", parameters);
    system->load_in("far", "station", "away", parameters);
    system->load_in("", "lookout", "here");
    system->load_in("far", "lookout", "there");
    for (const std::string port : {"timed", "samples", "echo"}) {
      system->wire("here." + port, "away." + port);
      system->wire("there." + port, "near." + port);
    }
    system->eventually(
        "both see", [&] { return both_see(); }, std::chrono::seconds(20));
    for (const std::string lookout : {"here", "there"}) take_sighting(*system, lookout);
  }
  /// Of a lookout over there as well, if it can be asked.
  std::optional<Sighting> seen_by(const std::string& lookout) {
    try {
      return sighting(*system, lookout);
    } catch (const Error&) {
      return std::nullopt;
    }
  }
  bool both_see() {
    const auto here = seen_by("here");
    const auto there = here && here->sees ? seen_by("there") : std::nullopt;
    return there && there->sees;
  }
  /// When a fault was shown first, in milliseconds since it began; 0: not.
  struct Shown {
    double here_ms = 0, there_ms = 0;
  };
  void suffer(const Trouble& trouble, const std::function<void()>& begin, const std::function<void()>& end) {
    const std::size_t said_before = other->said().size();
    take_sighting(*system, "here");
    begin();
    const auto begun = Steady::now();
    Shown shown;
    system->eventually(
        "it ends",
        [&] {
          const bool here = system->host("far").state() != "joined";
          const bool there = shown.there_ms == 0 && other->said().find(kSilentLeader, said_before) != std::string::npos;
          const double so_far_ms = std::chrono::duration<double, std::milli>(Steady::now() - begun).count();
          if (here && shown.here_ms == 0) shown.here_ms = so_far_ms;
          if (there) shown.there_ms = so_far_ms;
          return so_far_ms > 1000.0 * trouble.seconds;
        },
        std::chrono::seconds(trouble.seconds + 60));
    const std::int64_t ended_ns = now_ns();
    const double lasted_s = std::chrono::duration<double>(Steady::now() - begun).count();
    expect_some_come_through(trouble, sighting(*system, "here"), lasted_s);
    end();
    system->eventually(
        "all is well again", [&] { return both_see(); }, std::chrono::seconds(60));
    tell(trouble, shown, ended_ns);
  }
  /// While it lasts, on this side.
  static void expect_some_come_through(const Trouble& trouble, const Sighting& seen, double lasted_s) {
    const double ended = static_cast<double>(seen.asked - seen.open);
    const auto ok = static_cast<std::size_t>(Outcome::Ok);
    const double answered = seen.outcomes.size() > ok ? static_cast<double>(seen.outcomes[ok]) / ended : 0;
    const double heard_hz = static_cast<double>(seen.heard) / lasted_s;
    std::cout << fmt::format(
        "  meanwhile {:.0f} % of {:.0f} questions answered (at least {:.0f}), {:.1f} samples a second heard (at least "
        "{:.1f})\n",
        100 * answered, ended, 100 * trouble.answered, heard_hz, trouble.heard_hz);
    EXPECT_GE(answered, trouble.answered);
    EXPECT_GE(heard_hz, trouble.heard_hz);
  }
  void tell(const Trouble& trouble, const Shown& shown, std::int64_t ended_ns) {
    const bool full = partitions_in_full();
    double back_ms = 0;
    let_be(*system, std::chrono::milliseconds(500));  // the last questions end
    for (const std::string lookout : {"here", "there"}) {
      const Sighting seen = sighting(*system, lookout);
      back_ms = std::max(back_ms, static_cast<double>(seen.seen_ns - ended_ns) / 1e6);
      std::cout << fmt::format(
          "  {}: {} questions, outcomes {}; longest {:.1f} ms beyond its deadline (bound {:.0f}); oldest of now {:.1f} "
          "ms "
          "(bound {:.0f}), oldest heard {:.1f} ms of {} (bound {:.0f})\n",
          lookout, seen.asked, fmt::join(seen.outcomes, "/"), seen.longest_over_ms, kBeyondDeadline_ms,
          seen.oldest_shown_ms, kTwoPeriods_ms + error_ms(trouble), seen.oldest_heard_ms, seen.heard,
          kMaxAge_ms + error_ms(trouble));
      EXPECT_LE(seen.longest_over_ms, allowed(kBeyondDeadline_ms, full) + pulse.longest_ms()) << lookout;
      EXPECT_LE(seen.oldest_shown_ms, kTwoPeriods_ms + error_ms(trouble) + pulse.longest_ms()) << lookout;
      EXPECT_LE(seen.oldest_heard_ms, kMaxAge_ms + error_ms(trouble) + pulse.longest_ms()) << lookout;
      EXPECT_LT(seen.open, 20U) << lookout << ": questions that never end add up";
      EXPECT_GT(seen.asked, 0U);
    }
    const auto text = [](double ms) { return ms > 0 ? fmt::format("after {:.0f} ms", ms) : "not"; };
    std::cout << fmt::format(
        "  {} for {} s: shown here {}, there {} (bound {:.0f}); all well again {:.0f} ms after its end (bound {:.0f}); "
        "the "
        "machine stood still for {:.0f} ms at most\n",
        trouble.name, trouble.seconds, text(shown.here_ms), text(shown.there_ms), kShown_ms, std::max(0.0, back_ms),
        trouble.back_ms, pulse.longest_ms());
    EXPECT_LE(back_ms, allowed(trouble.back_ms, full) + pulse.longest_ms());
    if (!trouble.shown) return;
    for (const double shown_ms : {shown.here_ms, shown.there_ms}) {
      EXPECT_GT(shown_ms, 0) << other->said();
      EXPECT_LE(shown_ms, allowed(kShown_ms, full) + pulse.longest_ms());
    }
  }
  static double error_ms(const Trouble& trouble) {
    return allowed(kClockError_ms, partitions_in_full()) + trouble.round_trip_ms / 2;
  }

  TemporaryDirectory directory;
  Pulse pulse;
  std::unique_ptr<OtherHost> other;
  std::unique_ptr<RunningSystem> system;
};

// ---- a cable --------------------------------------------------------------------------------------------------

class PartitionOfACable : public Partition, public testing::WithParamInterface<Trouble> {};

TEST_P(PartitionOfACable, EndsQuestionsInTimeShowsNothingOldAndIsOverInTime) {
  const Trouble& trouble = GetParam();
  Cable cable;
  if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
  if (trouble.there_percent + trouble.here_percent > 0 && !shell("command -v nft"))
    GTEST_SKIP() << "this test needs the program nft (Debian package nftables)";
  if (!trouble.rate.empty() && !shell("command -v tc"))
    GTEST_SKIP() << "this test needs the program tc (Debian package iproute2)";
  meet(cable, trouble.station);
  suffer(
      trouble,
      [&] {
        if (trouble.pulled) cable.pull();
        cable.lose(trouble.there_percent, trouble.here_percent);
        cable.limit(trouble.rate);
      },
      [&] {
        cable.plug();
        cable.lose(0, 0);
        cable.limit("");
      });
}

/// A question comes back at once with (1 - loss)². What is lost comes again after 200 ms of its 300 at the earliest,
/// holds up what is behind it, and if it is lost again and again the connection ends for a while.
double answered_at(int loss_percent) {
  switch (loss_percent) {
    case 1: return 0.9;
    case 5: return 0.5;
    case 20: return 0.1;
    default: return 0.02;
  }
}

std::vector<Trouble> cable_troubles() {
  const std::string loud = "period_ms=10 payload=2000";  // 1.6 Mbit/s
  const std::string quiet = "period_ms=50 payload=1000";
  const double short_ms = 2000;
  const double queue_ms = 400;  // of tbf, both ways
  const double few_hz = 1;      // those that come before all that has to wait is too old, again and again
  if (!partitions_in_full()) {
    return {{.name = "Pulled1s", .seconds = 1, .pulled = true, .back_ms = short_ms},
            {.name = "OneWayThere", .seconds = 3, .shown = true, .there_percent = 100},
            {.name = "OneWayHere", .seconds = 3, .shown = true, .here_percent = 100},
            {.name = "Loss20",
             .seconds = 3,
             .round_trip_ms = 400,
             .there_percent = 20,
             .here_percent = 20,
             .answered = 0.01,  // of some sixty at least one: three seconds may have one end of the connection
             .heard_hz = few_hz},
            {.name = "Slow",
             .seconds = 3,
             .round_trip_ms = queue_ms,
             .station = loud,
             .rate = "1mbit",
             .heard_hz = few_hz}};
  }
  std::vector<Trouble> all{{.name = "Pulled1s", .seconds = 1, .pulled = true, .back_ms = short_ms},
                           {.name = "Pulled10s", .seconds = 10, .pulled = true, .shown = true},
                           {.name = "Pulled60s", .seconds = 60, .pulled = true, .shown = true},
                           {.name = "OneWayThere", .seconds = 10, .shown = true, .there_percent = 100},
                           {.name = "OneWayHere", .seconds = 10, .shown = true, .here_percent = 100}};
  for (const int percent : {1, 5, 20, 30}) {
    all.push_back({.name = fmt::format("Loss{}", percent),
                   .seconds = 60,
                   .round_trip_ms = 400,
                   .there_percent = percent,
                   .here_percent = percent,
                   .answered = answered_at(percent)});
  }
  all.push_back({.name = "Slow",
                 .seconds = 60,
                 .round_trip_ms = queue_ms,
                 .station = quiet,
                 .rate = "1mbit",
                 .answered = 0.9,
                 .heard_hz = 15});  // of 20
  all.push_back({.name = "SlowAndOverloaded",
                 .seconds = 60,
                 .round_trip_ms = queue_ms,
                 .station = loud,
                 .rate = "1mbit",
                 .heard_hz = few_hz});
  all.push_back({.name = "Pulled10min", .seconds = 600, .pulled = true, .shown = true});
  return all;
}

INSTANTIATE_TEST_SUITE_P(By, PartitionOfACable, testing::ValuesIn(cable_troubles()),
                         [](const auto& one) { return one.param.name; });

// ---- a long way -----------------------------------------------------------------------------------------------

struct LongWay {
  Trouble trouble;
  Relay::Weather weather;
};
void PrintTo(const LongWay& way, std::ostream* out) { *out << way.trouble.name; }

class PartitionOfARelay : public Partition, public testing::WithParamInterface<LongWay> {};

TEST_P(PartitionOfARelay, EndsQuestionsInTimeShowsNothingOldAndIsOverInTime) {
  const Trouble& trouble = GetParam().trouble;
  const auto seed =
      static_cast<unsigned>(number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000)));
  std::cout << "seed " << seed << "\n";
  Relay relay(seed);
  if (!relay.missing().empty()) GTEST_SKIP() << relay.missing();
  meet(relay, trouble.station);
  const Relay::Counts before = relay.counts();
  suffer(
      trouble, [&] { relay.set(GetParam().weather); }, [&] { relay.set({}); });
  const Relay::Counts after = relay.counts();
  std::cout << fmt::format("  packets: {}, of them late {}, twice {}, lost {}\n", after.carried - before.carried,
                           after.late - before.late, after.twice - before.twice, after.lost - before.lost);
  EXPECT_GT(after.carried, before.carried);
}

std::vector<LongWay> long_ways() {
  const int seconds = partitions_in_full() ? 60 : 3;
  const double most = 0.9;         // of the questions; none where the way takes longer than they may
  const double a_quarter_hz = 50;  // of the samples
  return {{{.name = "Delay", .seconds = seconds, .round_trip_ms = 600, .heard_hz = a_quarter_hz},
           {.delay_ms = 200, .jitter_ms = 100}},
          {{.name = "Late", .seconds = seconds, .round_trip_ms = 60, .answered = most, .heard_hz = a_quarter_hz},
           {.late = 0.2}},
          {{.name = "Twice", .seconds = seconds, .answered = most, .heard_hz = a_quarter_hz}, {.twice = 0.3}}};
}

INSTANTIATE_TEST_SUITE_P(By, PartitionOfARelay, testing::ValuesIn(long_ways()),
                         [](const auto& one) { return one.param.trouble.name; });

}  // namespace
}  // namespace fiona::conformance
