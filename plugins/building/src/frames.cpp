#include "fiona/building/frames.hpp"

#include <cmath>

#include "local_frame.hpp"

namespace fiona::building {

Point Placement::place(Point p) const {
  const double c = std::cos(turn_rad), s = std::sin(turn_rad);
  return by + Point{c * p.x_m - s * p.y_m, s * p.x_m + c * p.y_m};
}

Placement::Covariance Placement::place(const Covariance& of) const {
  const double c = std::cos(turn_rad), s = std::sin(turn_rad);
  return {c * c * of.xx_m2 - 2 * c * s * of.xy_m2 + s * s * of.yy_m2,
          c * s * (of.xx_m2 - of.yy_m2) + (c * c - s * s) * of.xy_m2,
          s * s * of.xx_m2 + 2 * c * s * of.xy_m2 + c * c * of.yy_m2};
}

Placement placement_of(const Reference& frame, const Reference& in) {
  constexpr double kBase_m = 100.0;
  const LocalFrame from(frame), to(in);
  const Point origin = to.to_local(from.to_wgs84({}));
  const Point along = to.to_local(from.to_wgs84({kBase_m, 0.0})) - origin;
  return {origin, std::atan2(along.y_m, along.x_m)};
}

}  // namespace fiona::building
