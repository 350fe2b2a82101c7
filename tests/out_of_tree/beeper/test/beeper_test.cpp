#include <gtest/gtest.h>
#include <fiona/testing/bench.hpp>

#include "beeper.hpp"

namespace {

using namespace std::chrono_literals;
using acme::beeper::Beeper;
using acme::beeper::Beeps;

TEST(Beeper, BeepsOnceAPauseAndThenEndsTheRun) {
  fiona::testing::Bench<Beeper> bench;
  bench.set("beeps", 3);
  bench.start();
  bench.advance(150ms);
  EXPECT_EQ(bench.take<Beeps>("beeps").size(), 2U);
  EXPECT_FALSE(bench.run_end().has_value());
  bench.advance(100ms);
  ASSERT_EQ(bench.take<Beeps>("beeps").size(), 1U);
  EXPECT_EQ(bench.run_end()->first, 0);
}

}  // namespace
