// The place that a person is shown, and what is told in passing.
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/objects/landmark.hpp"
#include "landmarks.hpp"
#include "navigation_world.hpp"
#include "shown_position.hpp"

namespace fiona::guidance {
namespace {

using world::at;

TEST(ShownPosition, FollowsAWalkerAsLocalisationSays) {
  ShownPosition shown;
  for (int i = 0; i < 50; ++i) {
    const auto now = shown.follow({{0.26 * i, 0}, 0}, {1, 0, 1}, at(0.2 * i));
    EXPECT_DOUBLE_EQ(now.at.x_m, 0.26 * i);
    EXPECT_FALSE(now.blending);
  }
}

TEST(ShownPosition, AJumpIsBlendedWithinThreeSeconds) {
  ShownPosition shown;
  shown.follow({{0, 0}, 0}, {0.1, 0, 0.1}, at(0));
  double before = 0;
  for (double t = 0.2; t < 3.3; t += 0.2) {
    const auto now = shown.follow({{6, 0}, 0}, {0.1, 0, 0.1}, at(t));
    EXPECT_LE(now.at.x_m - before, 0.5);
    EXPECT_GE(now.at.x_m, before);
    EXPECT_EQ(now.blending, now.at.x_m < 6);
    before = now.at.x_m;
  }
  EXPECT_EQ(before, 6);
}

TEST(ShownPosition, WhatIsLessThanTwoSigmaIsNoJump) {
  ShownPosition shown;
  shown.follow({{0, 0}, 0}, {4, 0, 4}, at(0));
  EXPECT_FALSE(shown.follow({{3.9, 0}, 0}, {4, 0, 4}, at(0.2)).blending);
  EXPECT_TRUE(shown.follow({{8.1, 0}, 0}, {4, 0, 4}, at(0.4)).blending);
}

/// Whether the 95 % ellipse at `middle` contains a place.
bool covers(const ShownPosition::Shown& shown, building::Point place) {
  const building::Point d = place - shown.at;
  const Covariance& c = shown.covariance;
  const double det = c.xx_m2 * c.yy_m2 - c.xy_m2 * c.xy_m2;
  return (c.yy_m2 * d.x_m * d.x_m - 2 * c.xy_m2 * d.x_m * d.y_m + c.xx_m2 * d.y_m * d.y_m) / det <= 5.991 + 1e-6;
}

TEST(ShownPosition, TheEllipseCoversThatOfBeforeAndTheNewOneAllTheWay) {
  ShownPosition shown;
  const Covariance before{0.5, 0.2, 0.3};
  const Covariance after{0.4, -0.1, 0.9};
  shown.follow({{1, 2}, 0}, before, at(0));
  const auto on_ellipse = [](building::Point middle, const Covariance& c, double angle) {
    // Cholesky of the covariance, at the 95 % radius.
    const double a = std::sqrt(c.xx_m2), b = c.xy_m2 / a, e = std::sqrt(c.yy_m2 - b * b);
    const double u = std::sqrt(5.991) * std::cos(angle), v = std::sqrt(5.991) * std::sin(angle);
    return building::Point{middle.x_m + a * u, middle.y_m + b * u + e * v};
  };
  for (double t = 0.2; t < 3.0; t += 0.2) {
    const auto now = shown.follow({{5, -1}, 0}, after, at(t));
    for (double angle = 0; angle < 6.3; angle += 0.1) {
      EXPECT_TRUE(covers(now, on_ellipse({5, -1}, after, angle))) << t << " " << angle;
      if (t < 0.3) {
        EXPECT_TRUE(covers(now, on_ellipse({1, 2}, before, angle))) << angle;
      }
    }
    EXPECT_TRUE(covers(now, {1, 2})) << t;
  }
}

TEST(ShownPosition, AnotherLevelIsShownAtOnceAndIsAJump) {
  ShownPosition shown;
  shown.follow({{1, 2}, 0}, {0.5, 0, 0.5}, at(0));
  for (double t = 0.2; t < 3.3; t += 0.2) {
    const auto now = shown.follow({{1, 2}, 1}, {0.5, 0, 0.5}, at(t));
    EXPECT_EQ(now.at, (building::Point{1, 2}));
    EXPECT_EQ(now.blending, t < 3.1) << t;
  }
  for (double level = 1; level < 2; level += 0.1) {
    EXPECT_FALSE(shown.follow({{1, 2}, level}, {0.5, 0, 0.5}, at(4 + level)).blending) << "stairs";
  }
}

TEST(Landmarks, ATextIsThreeNumbersAndAName) {
  const auto lift = hmi::parse_landmark("12.5,-3,1 lift B");
  ASSERT_TRUE(lift);
  EXPECT_EQ(lift->x(), 12.5);
  EXPECT_EQ(lift->y(), -3);
  EXPECT_EQ(lift->level(), 1);
  EXPECT_EQ(lift->name(), "lift B");
  EXPECT_EQ(hmi::landmark_text(*lift), "12.5,-3,1 lift B");
  const auto nameless = hmi::parse_landmark("0,0,-0.5");
  ASSERT_TRUE(nameless);
  EXPECT_EQ(hmi::landmark_text(*nameless), "0,0,-0.5");
  for (const char* text : {"", "1,2", "1,2,", "a,b,c", "1;2;3", "1,2,3x", "nan,0,0", "1e999,0,0"}) {
    EXPECT_FALSE(hmi::parse_landmark(text)) << text;
  }
}

TEST(Landmarks, APointIsToldOnceInPassingAndAgainAfterOneWasAway) {
  const LevelPlan plan;
  Passing passing;
  passing.watch({{{{10, 0}, 0}, "statue"}});
  std::vector<double> told_m;
  for (double x : {0.0, 5.0, 8.0, 10.0, 12.0, 20.0, 10.0}) {
    if (!passing.follow(plan, {{x, 0}, 0}, 3.0).empty()) told_m.push_back(x);
  }
  EXPECT_THAT(told_m, ::testing::ElementsAre(8.0, 10.0));
}

TEST(Landmarks, APointIsNeverToldOnAnotherLevelOrThroughAWall) {
  LevelPlan plan;
  plan.plan.walls.push_back({.segment = {{-5, 1}, {5, 1}}, .level = 0.0});
  Passing passing;
  passing.watch({{{{0, 0}, 0}, "statue"}});
  EXPECT_TRUE(passing.follow(plan, {{0, 0}, 1}, 3.0).empty());
  EXPECT_TRUE(passing.follow(plan, {{0, 0}, 0.5}, 3.0).empty());
  EXPECT_TRUE(passing.follow(plan, {{0, 2}, 0}, 3.0).empty());
  EXPECT_EQ(passing.follow(plan, {{0, -2}, 0}, 3.0).size(), 1u);
}

}  // namespace
}  // namespace fiona::guidance
