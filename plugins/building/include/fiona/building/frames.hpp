#pragma once

#include "fiona/building/geometry.hpp"
#include "fiona/building/plan.hpp"

namespace fiona::building {

/// How the places of one local frame lie in another: turned, then moved. Both are planes that touch the earth, which as
/// far as a building reaches are the same one to within millimetres.
struct Placement {
  Point by{};             ///< in metres
  double turn_rad = 0.0;  ///< counter-clockwise

  /// In metres. [any thread]
  Point place(Point p) const;
  /// The covariance of a place: symmetric, in square metres.
  struct Covariance {
    double xx_m2, xy_m2, yy_m2;
  };
  Covariance place(const Covariance& covariance) const;
};

/// Where the places of `frame` lie in the other one; levels are the building's, and the same in both. [any thread]
Placement placement_of(const Reference& frame, const Reference& in);

}  // namespace fiona::building
