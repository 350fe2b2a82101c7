#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "heading_filter.hpp"
#include "step_detector.hpp"
#include "step_tracker.hpp"

namespace fiona::steps {
namespace {

using Eigen::AngleAxisd;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using std::chrono::milliseconds;

constexpr double kDegree = std::numbers::pi / 180.0;
const Vector3d kFieldWorld_gauss(0.0, 0.2, -0.43);  // middle Europe: north and down

/// What a phone held flat reads while its top edge points `heading_rad` counter-clockwise from east.
ImuSample flat_phone(milliseconds time, double heading_rad, double rate_dps = 0.0) {
  const Matrix3d world_from_phone =
      AngleAxisd(heading_rad - std::numbers::pi / 2, Vector3d::UnitZ()).toRotationMatrix();
  return {time, Vector3d(0, 0, 1), Vector3d(0, 0, rate_dps), world_from_phone.transpose() * kFieldWorld_gauss};
}

/// Steps found in `seconds` of a vertical bounce of that frequency and amplitude.
std::vector<DetectedStep> steps_of_bounce(double hertz, double amplitude_g, double seconds) {
  StepDetector detector;
  std::vector<DetectedStep> steps;
  for (int t_ms = 0; t_ms < seconds * 1000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    sample.acceleration_g.z() += amplitude_g * std::sin(2 * std::numbers::pi * hertz * t_ms / 1000.0);
    if (const auto step = detector.feed(sample)) steps.push_back(*step);
  }
  return steps;
}

TEST(StepDetector, WalkingAtTwoHertzGivesTwoStepsASecond) {
  EXPECT_NEAR(steps_of_bounce(2.0, 0.25, 10.0).size(), 20.0, 1.0);
}

TEST(StepDetector, StandingStillGivesNoStep) { EXPECT_EQ(steps_of_bounce(2.0, 0.0, 10.0).size(), 0u); }

TEST(StepDetector, ATrembleOfTheHandIsNoStep) { EXPECT_EQ(steps_of_bounce(9.0, 0.1, 10.0).size(), 0u); }

TEST(StepDetector, AStrongerBounceIsALongerStep) {
  EXPECT_GT(steps_of_bounce(2.0, 0.5, 5.0).back().length_m, steps_of_bounce(2.0, 0.15, 5.0).back().length_m);
}

TEST(StepDetector, StepLengthsAreThoseOfAWalker) {
  const double length_m = steps_of_bounce(1.9, 0.25, 5.0).back().length_m;
  EXPECT_GT(length_m, 0.4);
  EXPECT_LT(length_m, 1.0);
}

TEST(StepDetector, AGapInTheSamplesIsNoStep) {
  StepDetector detector;
  EXPECT_FALSE(detector.feed(flat_phone(milliseconds(0), 0)));
  ImuSample late = flat_phone(milliseconds(5000), 0);
  late.acceleration_g *= 3.0;
  EXPECT_FALSE(detector.feed(late));
}

TEST(StepDetector, TimeThatGoesBackIsIgnored) {
  StepDetector detector;
  detector.feed(flat_phone(milliseconds(100), 0));
  ImuSample earlier = flat_phone(milliseconds(50), 0);
  earlier.acceleration_g *= 9.0;
  EXPECT_FALSE(detector.feed(earlier));
}

TEST(HeadingFilter, IsSilentUntilAligned) { EXPECT_FALSE(HeadingFilter().is_aligned()); }

TEST(HeadingFilter, FreeFallAlignsNothing) {
  HeadingFilter filter;
  filter.feed({milliseconds(0), Vector3d::Zero(), Vector3d::Zero(), kFieldWorld_gauss});
  EXPECT_FALSE(filter.is_aligned());
}

TEST(HeadingFilter, AlignsToTheCompassAtOnce) {
  for (const double heading : {-3.0, -1.0, 0.0, 0.5, 2.5}) {
    HeadingFilter filter;
    filter.feed(flat_phone(milliseconds(0), heading));
    EXPECT_NEAR(filter.heading_rad(), heading, 1e-6);
  }
}

TEST(HeadingFilter, AfterAPauseItIsNotAlignedUntilThereIsAFieldAgain) {
  HeadingFilter filter;
  for (int t_ms = 0; t_ms < 5000; t_ms += 20) filter.feed(flat_phone(milliseconds(t_ms), 0.5));
  const auto after = [&filter](int t_ms, double heading, double field) {
    ImuSample sample = flat_phone(milliseconds(t_ms), heading);
    sample.field_gauss *= field;
    filter.feed(sample);
    return filter.is_aligned();
  };
  for (int t_ms = 8000; t_ms < 9000; t_ms += 20) EXPECT_FALSE(after(t_ms, 2.0, 0.0));
  EXPECT_TRUE(after(9000, 2.0, 1.0));
  EXPECT_NEAR(filter.heading_rad(), 2.0, 1e-6);
}

TEST(HeadingFilter, WhatSteelDoesToTheFieldTurnsTheCompassAtOnceAndTheHeadingSlowly) {
  HeadingFilter filter;
  int t_ms = 0;
  for (; t_ms < 5000; t_ms += 20) filter.feed(flat_phone(milliseconds(t_ms), 0.5));
  const auto beside_steel = [&t_ms] {
    ImuSample sample = flat_phone(milliseconds(t_ms += 20), 0.5);
    sample.field_gauss = Eigen::AngleAxisd(-20 * kDegree, Vector3d::UnitZ()) * sample.field_gauss;
    return sample;
  };
  filter.feed(beside_steel());
  EXPECT_NEAR(filter.compass_rad(), 0.5 + 20 * kDegree, 1 * kDegree);
  EXPECT_NEAR(filter.heading_rad(), 0.5, 1 * kDegree);
  for (int i = 0; i < 500; ++i) filter.feed(beside_steel());
  EXPECT_GT(filter.heading_rad(), 0.5 + 14 * kDegree);
}

TEST(HeadingFilter, ATurnToTheLeftIsCounterClockwise) {
  HeadingFilter filter;
  for (int t_ms = 0; t_ms <= 1000; t_ms += 10) filter.feed(flat_phone(milliseconds(t_ms), 0.09 * t_ms * kDegree, 90.0));
  EXPECT_NEAR(filter.heading_rad(), 90 * kDegree, 2 * kDegree);
}

TEST(HeadingFilter, AnUprightPhoneLooksWhereItsBackPoints) {
  // Top edge to the ceiling, back to the north.
  const Matrix3d world_from_phone = AngleAxisd(std::numbers::pi / 2, Vector3d::UnitX()).toRotationMatrix();
  HeadingFilter filter;
  filter.feed({milliseconds(0), world_from_phone.transpose() * Vector3d::UnitZ(), Vector3d::Zero(),
               world_from_phone.transpose() * kFieldWorld_gauss});
  EXPECT_NEAR(filter.heading_rad(), std::numbers::pi / 2, 1e-6);
}

TEST(HeadingFilter, PassingIronDoesNotTurnTheHeading) {
  HeadingFilter filter;
  for (int t_ms = 0; t_ms < 10'000; t_ms += 20) filter.feed(flat_phone(milliseconds(t_ms), 0.0));
  for (int t_ms = 10'000; t_ms < 14'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    sample.field_gauss += Vector3d(0.9, 0.6, 0.0);
    filter.feed(sample);
  }
  EXPECT_NEAR(filter.heading_rad(), 0.0, 3 * kDegree);
}

TEST(HeadingFilter, DoubtGrowsWhileIronIsNear) {
  HeadingFilter filter;
  for (int t_ms = 0; t_ms < 60'000; t_ms += 20) filter.feed(flat_phone(milliseconds(t_ms), 0.0));
  const double calm = filter.heading_sd_rad();
  for (int t_ms = 60'000; t_ms < 63'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    sample.field_gauss *= 2.5;
    filter.feed(sample);
  }
  EXPECT_GT(filter.heading_sd_rad(), calm);
}

TEST(StepTracker, AWalkNorthGoesNorth) {
  StepTracker tracker;
  double east_m = 0.0, north_m = 0.0;
  for (int t_ms = 0; t_ms < 10'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 90 * kDegree);
    sample.acceleration_g.z() += 0.25 * std::sin(2 * std::numbers::pi * 1.8 * t_ms / 1000.0);
    if (const auto step = tracker.feed(sample)) {
      east_m += step->length_m * std::cos(step->heading_rad);
      north_m += step->length_m * std::sin(step->heading_rad);
    }
  }
  EXPECT_GT(north_m, 8.0);
  EXPECT_NEAR(east_m, 0.0, 0.2);
}

/// What a lift adds to the weight of one who stands in it: from 10 s on it speeds up by 0.8 m/s^2 to 1 m/s, and slows
/// down likewise when it has carried them so far.
double lift_g(double t_s, double rise_m) {
  constexpr double kSpeedsUp_s = 1.25, kAcceleration_g = 0.8 / 9.80665;
  const double since_s = t_s - 10.0, up = std::copysign(kAcceleration_g, rise_m);
  if (since_s >= 0.0 && since_s < kSpeedsUp_s) return up;
  const double slows_s = since_s - std::abs(rise_m);
  return slows_s >= 0.0 && slows_s < kSpeedsUp_s ? -up : 0.0;
}

/// Walks for 5 s, stands until it is 40 s, and walks again: the steps, as a phone with a bias and noise has them.
std::vector<Step> steps_about(double rise_m, double bias_g = 0.0) {
  StepTracker tracker;
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0.0, 0.012);
  std::vector<Step> steps;
  for (int t_ms = 0; t_ms < 45'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    const bool walks = t_ms < 5000 || t_ms > 40'000;
    sample.acceleration_g.z() += bias_g + noise(random) + (rise_m != 0.0 ? lift_g(t_ms / 1000.0, rise_m) : 0.0) +
                                 (walks ? 0.25 * std::sin(2 * std::numbers::pi * 1.8 * t_ms / 1000.0) : 0.0);
    if (const auto step = tracker.feed(sample)) steps.push_back(*step);
  }
  return steps;
}

TEST(StepTracker, TheFirstStepOutOfALiftTellsHowFarItHasCarriedThem) {
  for (const double rise_m : {3.3, -3.3, 7.0, -16.0}) {
    for (const double bias_g : {0.0, 0.03, -0.03}) {
      const auto steps = steps_about(rise_m, bias_g);
      const auto out =
          std::find_if(steps.begin(), steps.end(), [](const Step& one) { return one.time.count() > 5500; });
      ASSERT_NE(out, steps.end());
      EXPECT_GT(out->time.count(), 40'000) << "a lift that starts was taken for a step";
      ASSERT_TRUE(out->risen_m);
      EXPECT_NEAR(*out->risen_m, rise_m, 0.1 * std::abs(rise_m)) << bias_g;
      EXPECT_FALSE(std::next(out)->risen_m) << "who walks does not feel a lift";
    }
  }
}

TEST(StepTracker, WhoOnlyStoodWasNotCarried) {
  const auto steps = steps_about(0.0);
  const auto out = std::find_if(steps.begin(), steps.end(), [](const Step& one) { return one.time.count() > 5500; });
  ASSERT_NE(out, steps.end());
  EXPECT_EQ(out->risen_m, 0.0);
}

/// Half a metre up within a second: a lift goes further.
TEST(RideDetector, APhoneThatIsRaisedIsNoLift) {
  RideDetector detector;
  for (int t_ms = 0; t_ms < 10'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    if (t_ms >= 5000 && t_ms < 6000) sample.acceleration_g.z() += 0.3 * std::sin(2 * std::numbers::pi * t_ms / 1000.0);
    detector.feed(sample);
  }
  const auto risen_m = detector.step(milliseconds(10'000));
  ASSERT_TRUE(risen_m);
  EXPECT_LT(std::abs(*risen_m), 1.0);
}

/// Another hand, and another axis' error: heavier for good, by what a lift's start adds for a second.
TEST(RideDetector, APhoneThatIsHeldOtherwiseIsNoLift) {
  RideDetector detector;
  for (int t_ms = 0; t_ms < 40'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    if (t_ms >= 10'000 && t_ms < 20'000) sample.acceleration_g.z() += 0.03;
    detector.feed(sample);
  }
  EXPECT_EQ(detector.step(milliseconds(40'000)), 0.0);
}

/// The last valley before a pause is none of the first peak after it.
TEST(StepDetector, WhatComesAfterAPauseIsMeasuredFromThen) {
  StepDetector detector;
  int steps = 0;
  for (int t_ms = 0; t_ms < 20'000; t_ms += 20) {
    ImuSample sample = flat_phone(milliseconds(t_ms), 0.0);
    if (t_ms < 5000) sample.acceleration_g.z() += 0.25 * std::sin(2 * std::numbers::pi * 1.8 * t_ms / 1000.0);
    if (t_ms >= 12'000 && t_ms < 13'000) sample.acceleration_g.z() += 0.08;
    steps += detector.feed(sample) && t_ms > 6000 ? 1 : 0;
  }
  EXPECT_EQ(steps, 0);
}

TEST(StepDetector, AWeakFirstStepIsToldWithTheSecond) {
  const double together_m = steps_of_bounce(1.5, 0.04, 5.0).front().length_m;
  EXPECT_NEAR(together_m, 2.0 * steps_of_bounce(1.5, 0.04, 5.0).back().length_m, 0.1);
}

}  // namespace
}  // namespace fiona::steps
