#include "shown_position.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::guidance {

using building::Point;

double Covariance::sigma_m() const {
  const double mean = (xx_m2 + yy_m2) / 2.0;
  return std::sqrt(std::max(0.0, mean + std::hypot((xx_m2 - yy_m2) / 2.0, xy_m2)));
}

namespace {

/// 95 % of a normal variate of two dimensions lie within so many standard deviations, squared.
constexpr double kRegion = 5.991;

/// An ellipse that contains the given one wherever its middle is moved to between `offset` and its opposite: the outer
/// bound of a sum of ellipsoids with the least trace (Kurzhanski and Valyi, Ellipsoidal Calculus, 1997, section 2.2).
Covariance moved(const Covariance& covariance, Point offset) {
  const double length2 = dot(offset, offset);
  const double trace = kRegion * (covariance.xx_m2 + covariance.yy_m2);
  const Covariance line = Covariance{offset.x_m * offset.x_m, offset.x_m * offset.y_m, offset.y_m * offset.y_m};
  if (length2 == 0.0) return covariance;
  if (trace <= 0.0) return line * (1.0 / kRegion);
  const double share = std::sqrt(length2 / trace);
  return covariance * (1.0 + share) + line * ((1.0 + 1.0 / share) / kRegion);
}

}  // namespace

ShownPosition::Shown ShownPosition::follow(const building::PathPoint& place, const Covariance& covariance,
                                           TimePoint now) {
  const Point at = place.at;
  const double jump_m = std::max(kJump_m, kJumpSigmas * covariance.sigma_m());
  const auto share_left = [&] {
    return jumped_ ? std::clamp(1.0 - to_seconds(now - *jumped_) / to_seconds(kBlend), 0.0, 1.0) : 0.0;
  };
  double left = share_left();
  const bool jumps =
      last_ && (distance_m(last_->at, at + offset_ * left) > jump_m || std::abs(place.level - level_) > kJumpLevels);
  level_ = place.level;
  if (jumps) {
    offset_ = last_->at - at;
    before_ = last_->covariance;
    jumped_ = now;
    left = 1.0;
  }
  if (left == 0.0) jumped_.reset();
  const Point offset = offset_ * left;
  // From the place shown to the further one of the two that it covers.
  const Point reach = offset_ * std::max(left, 1.0 - left);
  last_ = Shown{at + offset, left > 0.0 ? moved(covariance + before_ * left, reach) : covariance, left > 0.0};
  return *last_;
}

}  // namespace fiona::guidance
