#include "step_counter.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <fiona/testing/bench.hpp>
#include <numbers>

namespace {

using namespace std::chrono_literals;
using fiona::localisation::StepProvider;
using fiona::sensors::GetIMUService;
using CounterBench = fiona::testing::Bench<acme::StepCounter>;

/// Ten seconds of a device that swings up and down this far, twice a second; how many steps were put.
std::size_t steps_of(CounterBench& bench, double swing_g) {
  for (int sample = 0; sample < 500; ++sample) {
    fiona::sensors::GetIMU imu;
    imu.set_out_x_ac(0);
    imu.set_out_y_ac(0);
    imu.set_out_z_ac(1 + swing_g * std::sin(2 * std::numbers::pi * 2 * sample * 0.02));
    bench.put<GetIMUService>("imu", imu);
    bench.advance(20ms);
  }
  return bench.take<StepProvider>("steps").size();
}

TEST(StepCounter, WalkingAtTwoHertzGivesTwoStepsASecond) {
  CounterBench bench;
  bench.start();
  EXPECT_EQ(steps_of(bench, 0.3), 20u);
}

TEST(StepCounter, StandingStillGivesNoStep) {
  CounterBench bench;
  bench.start();
  EXPECT_EQ(steps_of(bench, 0.05), 0u);
}

TEST(StepCounter, LowerThresholdHearsASofterStep) {
  CounterBench bench;
  bench.set("threshold", 1.03);
  bench.start();
  EXPECT_EQ(steps_of(bench, 0.05), 20u);
}

TEST(StepCounter, ThresholdBelowGravityIsRefused) {
  CounterBench bench;
  try {
    bench.set("threshold", 0.9);
    FAIL() << "the parameter was taken";
  } catch (const fiona::Error& error) {
    EXPECT_EQ(error.text().what, "refused: threshold is 0.9, below 1.02 g");
  }
}

}  // namespace
