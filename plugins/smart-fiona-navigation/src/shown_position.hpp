#pragma once

#include <array>
#include <optional>

#include <fiona/building/plan.hpp>
#include <fiona/time.hpp>

namespace fiona::guidance {

/// Symmetric: of x and y, in square metres.
struct Covariance {
  double xx_m2 = 0.0;
  double xy_m2 = 0.0;
  double yy_m2 = 0.0;

  Covariance operator+(const Covariance& other) const {
    return {xx_m2 + other.xx_m2, xy_m2 + other.xy_m2, yy_m2 + other.yy_m2};
  }
  Covariance operator*(double scale) const { return {xx_m2 * scale, xy_m2 * scale, yy_m2 * scale}; }
  /// Standard deviation along the longer axis.
  double sigma_m() const;
};

/// Where a person is told to be. What localisation says is followed as it is; where that jumps, by more than 1.5 m and
/// more than two standard deviations, the place shown moves over within 3 s, and its ellipse covers both. Between two
/// levels there is no place to be shown: another one is shown at once, and counts as a jump.
class ShownPosition {
 public:
  static constexpr double kJump_m = 1.5;
  static constexpr double kJumpSigmas = 2.0;
  static constexpr double kJumpLevels = 0.3;  ///< at once: on stairs and in lifts it changes by and by
  static constexpr Duration kBlend = std::chrono::seconds(3);

  struct Shown {
    building::Point at{};
    Covariance covariance{};
    bool blending = false;
  };
  Shown follow(const building::PathPoint& place, const Covariance& covariance, TimePoint now);
  /// The next place is a first one.
  void forget() { last_.reset(); }

 private:
  std::optional<Shown> last_;
  double level_ = 0.0;
  building::Point offset_{};  ///< of what was shown from what is said, when the newest jump came
  Covariance before_{};       ///< of what was shown then
  std::optional<TimePoint> jumped_;
};

}  // namespace fiona::guidance
