#include "fiona/building/declination.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <numbers>

namespace fiona::building {
namespace {

using std::chrono::milliseconds;

/// A date as a decimal year.
milliseconds in_year(double year) {
  return milliseconds(static_cast<std::int64_t>((year - 1970.0) * 365.2425 * 86400'000));
}

double declination_deg(double latitude_deg, double longitude_deg, double year) {
  return declination_rad(latitude_deg, longitude_deg, in_year(year)) * 180.0 / std::numbers::pi;
}

/// Table of test values of the World Magnetic Model 2025's report, height 0.
TEST(Declination, IsThatOfTheModelsOwnTestValues) {
  EXPECT_NEAR(declination_deg(80, 0, 2025.0), 1.28, 0.005);
  EXPECT_NEAR(declination_deg(0, 120, 2025.0), -0.16, 0.005);
  EXPECT_NEAR(declination_deg(-80, 240, 2025.0), 68.78, 0.005);
  EXPECT_NEAR(declination_deg(80, 0, 2027.5), 2.59, 0.005);
  EXPECT_NEAR(declination_deg(0, 120, 2027.5), -0.24, 0.005);
  EXPECT_NEAR(declination_deg(-80, 240, 2027.5), 68.49, 0.005);
}

TEST(Declination, OfADateThatTheModelIsNotMadeForIsThatOfItsNearerEnd) {
  EXPECT_EQ(declination_deg(48, 10, 1970.0), declination_deg(48, 10, 2025.0));
  EXPECT_EQ(declination_deg(48, 10, 2040.0), declination_deg(48, 10, 2030.0));
  EXPECT_NE(declination_deg(48, 10, 2025.0), declination_deg(48, 10, 2030.0));
}

}  // namespace
}  // namespace fiona::building
