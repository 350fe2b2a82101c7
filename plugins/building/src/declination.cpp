#include "fiona/building/declination.hpp"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/SphericalHarmonic.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace fiona::building {
namespace {

using GeographicLib::SphericalHarmonic;

constexpr int kDegree = 12;
constexpr double kRadius_m = 6371200.0;  // the model's sphere
constexpr double kFirstYear = 2025.0, kLastYear = 2030.0;
constexpr double kYear_s = 365.2425 * 86400;

/// Schmidt semi-normalised coefficients, in nT, and how they change in a year.
struct Coefficient {
  double g, h, g_per_year, h_per_year;
};

/// Degree 1 to 12; of each degree the orders from 0 on.
constexpr std::array<Coefficient, 90> kModel = {{
    {-29351.8, 0, 12, 0}, {-1410.8, 4545.4, 9.7, -21.5},
    {-2556.6, 0, -11.6, 0}, {2951.1, -3133.6, -5.2, -27.7}, {1649.3, -815.1, -8, -12.1},
    {1361, 0, -1.3, 0}, {-2404.1, -56.6, -4.2, 4}, {1243.8, 237.5, 0.4, -0.3}, {453.6, -549.5, -15.6, -4.1},
    {895, 0, -1.6, 0}, {799.5, 278.6, -2.4, -1.1}, {55.7, -133.9, -6, 4.1}, {-281.1, 212, 5.6, 1.6},
    {12.1, -375.6, -7, -4.4},
    {-233.2, 0, 0.6, 0}, {368.9, 45.4, 1.4, -0.5}, {187.2, 220.2, 0, 2.2}, {-138.7, -122.9, 0.6, 0.4},
    {-142, 43, 2.2, 1.7}, {20.9, 106.1, 0.9, 1.9},
    {64.4, 0, -0.2, 0}, {63.8, -18.4, -0.4, 0.3}, {76.9, 16.8, 0.9, -1.6}, {-115.7, 48.8, 1.2, -0.4},
    {-40.9, -59.8, -0.9, 0.9}, {14.9, 10.9, 0.3, 0.7}, {-60.7, 72.7, 0.9, 0.9},
    {79.5, 0, 0, 0}, {-77, -48.9, -0.1, 0.6}, {-8.8, -14.4, -0.1, 0.5}, {59.3, -1, 0.5, -0.8}, {15.8, 23.4, -0.1, 0},
    {2.5, -7.4, -0.8, -1}, {-11.1, -25.1, -0.8, 0.6}, {14.2, -2.3, 0.8, -0.2},
    {23.2, 0, -0.1, 0}, {10.8, 7.1, 0.2, -0.2}, {-17.5, -12.6, 0, 0.5}, {2, 11.4, 0.5, -0.4},
    {-21.7, -9.7, -0.1, 0.4}, {16.9, 12.7, 0.3, -0.5}, {15, 0.7, 0.2, -0.6}, {-16.8, -5.2, 0, 0.3},
    {0.9, 3.9, 0.2, 0.2},
    {4.6, 0, 0, 0}, {7.8, -24.8, -0.1, -0.3}, {3, 12.2, 0.1, 0.3}, {-0.2, 8.3, 0.3, -0.3}, {-2.5, -3.3, -0.3, 0.3},
    {-13.1, -5.2, 0, 0.2}, {2.4, 7.2, 0.3, -0.1}, {8.6, -0.6, -0.1, -0.2}, {-8.7, 0.8, 0.1, 0.4},
    {-12.9, 10, -0.1, 0.1},
    {-1.3, 0, 0.1, 0}, {-6.4, 3.3, 0, 0}, {0.2, 0, 0.1, 0}, {2, 2.4, 0.1, -0.2}, {-1, 5.3, 0, 0.1},
    {-0.6, -9.1, -0.3, -0.1}, {-0.9, 0.4, 0, 0.1}, {1.5, -4.2, -0.1, 0}, {0.9, -3.8, -0.1, -0.1},
    {-2.7, 0.9, 0, 0.2}, {-3.9, -9.1, 0, 0},
    {2.9, 0, 0, 0}, {-1.5, 0, 0, 0}, {-2.5, 2.9, 0, 0.1}, {2.4, -0.6, 0, 0}, {-0.6, 0.2, 0, 0.1},
    {-0.1, 0.5, -0.1, 0}, {-0.6, -0.3, 0, 0}, {-0.1, -1.2, 0, 0.1}, {1.1, -1.7, -0.1, 0}, {-1, -2.9, -0.1, 0},
    {-0.2, -1.8, -0.1, 0}, {2.6, -2.3, -0.1, 0},
    {-2, 0, 0, 0}, {-0.2, -1.3, 0, 0}, {0.3, 0.7, 0, 0}, {1.2, 1, 0, -0.1}, {-1.3, -1.4, 0, 0.1}, {0.6, 0, 0, 0},
    {0.6, 0.6, 0.1, 0}, {0.5, -0.1, 0, 0}, {-0.1, 0.8, 0, 0}, {-0.4, 0.1, 0, 0}, {-0.2, -1, -0.1, 0},
    {-1.3, 0.1, 0, 0}, {-0.7, 0.2, -0.1, -0.1},
}};

/// The field's potential at a date, over the sphere's radius.
class Potential {
 public:
  explicit Potential(double year) : cosines_(size(kDegree)), sines_(size(kDegree) - (kDegree + 1)) {
    const Coefficient* next = kModel.data();
    for (int degree = 1; degree <= kDegree; ++degree) {
      for (int order = 0; order <= degree; ++order, ++next) {
        cosines_[place(degree, order)] = next->g + (year - kFirstYear) * next->g_per_year;
        if (order == 0) continue;
        sines_[place(degree, order) - (kDegree + 1)] = next->h + (year - kFirstYear) * next->h_per_year;
      }
    }
  }

  /// Its gradient at a geocentric place, in metres.
  std::array<double, 3> gradient(double x, double y, double z) const {
    const SphericalHarmonic sum(cosines_, sines_, kDegree, kRadius_m, SphericalHarmonic::SCHMIDT);
    std::array<double, 3> result{};
    sum(x, y, z, result[0], result[1], result[2]);
    return result;
  }

 private:
  // As SphericalHarmonic keeps them: by order, and of each order by degree; without sines of order 0.
  static std::size_t size(int degree) { return static_cast<std::size_t>((degree + 1) * (degree + 2) / 2); }
  static std::size_t place(int degree, int order) {
    return static_cast<std::size_t>(order * kDegree - order * (order - 1) / 2 + degree);
  }

  std::vector<double> cosines_, sines_;
};

}  // namespace

double declination_rad(double latitude_deg, double longitude_deg, std::chrono::milliseconds since_1970) {
  const double year = 1970.0 + std::chrono::duration<double>(since_1970).count() / kYear_s;
  double x = 0.0, y = 0.0, z = 0.0;
  std::vector<double> local_in_earth(9);  // rows of a rotation from east, north, up
  GeographicLib::Geocentric::WGS84().Forward(latitude_deg, longitude_deg, 0.0, x, y, z, local_in_earth);
  const auto slope = Potential(std::clamp(year, kFirstYear, kLastYear)).gradient(x, y, z);
  double east = 0.0, north = 0.0;  // the field is the potential's downward slope
  for (std::size_t i = 0; i < 3; ++i) {
    east -= local_in_earth[3 * i] * slope[i];
    north -= local_in_earth[3 * i + 1] * slope[i];
  }
  return std::atan2(east, north);
}

}  // namespace fiona::building
