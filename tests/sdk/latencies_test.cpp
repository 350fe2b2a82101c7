#include "fiona/latencies.hpp"

#include <gtest/gtest.h>

#include <chrono>

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;

constexpr TimePoint at(Duration time) { return TimePoint(time); }

double share(Duration found, Duration truth) {
  return static_cast<double>(found.count()) / static_cast<double>(truth.count());
}

TEST(Latencies, BeforeAnythingArrivesThereAreNone) { EXPECT_FALSE(Latencies().recent(at(1s))); }

TEST(Latencies, QuantilesAreRightToOnePartInTen) {
  for (const Duration scale : {Duration(20us), Duration(3ms), Duration(1s)}) {
    Latencies latencies;
    for (int i = 1; i <= 1000; ++i) latencies.add(i * scale / 1000 + scale, at(1s));  // evenly from 1 to 2 scales
    const auto found = latencies.recent(at(2s));
    ASSERT_TRUE(found);
    EXPECT_NEAR(share(found->p50, 3 * scale / 2), 1, 0.1);
    EXPECT_NEAR(share(found->p99, 199 * scale / 100), 1, 0.1);
  }
}

TEST(Latencies, AFewSlowOnesShowInTheLastHundredthOnly) {
  Latencies latencies;
  for (int i = 0; i < 98; ++i) latencies.add(100us, at(1s));
  for (int i = 0; i < 2; ++i) latencies.add(50ms, at(1s));
  const auto found = latencies.recent(at(1s));
  ASSERT_TRUE(found);
  EXPECT_NEAR(share(found->p50, 100us), 1, 0.15);
  EXPECT_NEAR(share(found->p99, 50ms), 1, 0.15);
}

TEST(Latencies, WhatIsTwentySecondsOldIsForgotten) {
  Latencies latencies;
  latencies.add(1s, at(0s));
  EXPECT_TRUE(latencies.recent(at(19s)));
  EXPECT_FALSE(latencies.recent(at(20s)));
  latencies.add(1ms, at(21s));
  latencies.add(1ms, at(32s));
  const auto found = latencies.recent(at(32s));
  ASSERT_TRUE(found);
  EXPECT_LT(found->p99, 2ms);
}

TEST(Latencies, WhatCannotBeIsCountedAtTheEnds) {
  Latencies latencies;
  latencies.add(-5ms, at(1s));
  EXPECT_LT(latencies.recent(at(1s))->p99, 1us);
  latencies.add(Duration::max(), at(1s));
  EXPECT_GT(latencies.recent(at(1s))->p99, 100s);
}

}  // namespace
}  // namespace fiona::sdk_test
