// How far another host's timeline is ahead, from beats over ways that are quick, slow, and slow in one direction only.
#include "clock_offset.hpp"

#include <gtest/gtest.h>

namespace fiona::host {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kSecond = 1000 * kMs;

/// Two hosts, the other's timeline so far ahead of ours, and the time by ours.
struct Pair {
  ClockOffset ours;
  ClockOffset theirs;
  std::int64_t ahead_ns = 0;
  std::int64_t now_ns = 100 * kSecond;

  /// A beat there and one back, which take so long.
  void beat(std::int64_t there_ns, std::int64_t back_ns) {
    const auto out = ours.beat(now_ns);
    now_ns += there_ns;
    theirs.heard(out, now_ns + ahead_ns);
    const auto home = theirs.beat(now_ns + ahead_ns);
    now_ns += back_ns;
    ours.heard(home, now_ns);
  }
};

TEST(ClockOffset, IsFoundByOneRoundTripToHalfOfIt) {
  Pair pair;
  pair.ahead_ns = 7 * kSecond;
  pair.beat(3 * kMs, kMs);
  EXPECT_NEAR(static_cast<double>(pair.ours.ahead_ns()), 7.0 * kSecond, 2.0 * kMs);
}

TEST(ClockOffset, OfAQuickWayIsNotSpoiltByOneThatIsSlowInOneDirectionForAMinute) {
  Pair pair;
  pair.ahead_ns = -kSecond;
  pair.beat(kMs / 10, kMs / 10);
  for (int i = 0; i < 60; ++i) pair.beat(kSecond, kMs / 10);
  EXPECT_NEAR(static_cast<double>(pair.ours.ahead_ns()), -1.0 * kSecond, 1.0 * kMs);
}

TEST(ClockOffset, FollowsClocksThatWanderApart) {
  Pair pair;
  for (int i = 0; i < 3600; ++i) {
    pair.beat(kMs, kMs);
    pair.now_ns += kSecond;
    pair.ahead_ns += 40'000;  // 40 millionths
  }
  EXPECT_NEAR(static_cast<double>(pair.ours.ahead_ns()), static_cast<double>(pair.ahead_ns), 2.0 * kMs);
}

TEST(ClockOffset, FollowsAClockThatJumpsThoughTheWayHasBecomeSlow) {
  Pair pair;
  pair.beat(kMs, kMs);
  pair.ahead_ns = 30 * kSecond;
  pair.beat(200 * kMs, 200 * kMs);
  EXPECT_NEAR(static_cast<double>(pair.ours.ahead_ns()), 30.0 * kSecond, 200.0 * kMs);
}

TEST(ClockOffset, BeatThatCannotBeTrueChangesNothing) {
  Pair pair;
  pair.beat(kMs, kMs);
  const auto before = pair.ours.ahead_ns();
  wire::Beat beat;
  beat.set_now_ns(INT64_MAX);
  beat.set_echo_ns(1);
  pair.ours.heard(beat, pair.now_ns);
  beat.set_now_ns(5);
  beat.set_heard_ns(9);  // heard after it was sent
  pair.ours.heard(beat, pair.now_ns);
  EXPECT_EQ(pair.ours.ahead_ns(), before);
}

}  // namespace
}  // namespace fiona::host
