#pragma once

#include <vector>

#include <fiona/navigation.pb.h>
#include <fiona/building/building.hpp>

namespace fiona::walks {

/// What whoever walks along a path has to be told of in time.
struct Mark {
  enum class Kind { Turn, Door, Climb };  ///< Climb: stairs, or a lift
  Kind kind = Kind::Turn;
  double at_m = 0.0;
  double leg_m = 0.0;  ///< of path up to here on which nothing is to be told, nor bends
};

/// A published path, measured. Its marks are found from its places and the drawing, and not asked of guidance.
class MeasuredPath {
 public:
  MeasuredPath(const building::Building& building, const navigation::CommPath& path);

  double end_m() const { return at_m_.back(); }
  building::PathPoint place(double at_m) const;
  /// Of length 1; where the path stands still in the plane, as in a lift, (0, 0).
  building::Point direction(double at_m) const;
  /// The nearest place of the path between two.
  double nearest_m(const building::PathPoint& to, double from_m, double until_m) const;
  const std::vector<Mark>& marks() const { return marks_; }

 private:
  std::size_t segment(double at_m) const;
  void find_marks(const building::Building& building);
  double bend_rad(std::size_t point) const;

  std::vector<building::PathPoint> points_{};
  std::vector<double> at_m_{};
  std::vector<Mark> marks_{};
};

}  // namespace fiona::walks
