#pragma once

#include <cstddef>
#include <string>

#include "fiona/building/svg.hpp"

namespace fiona::recorder {

/// A track of bounded length for drawing: when it is full every second point goes, and from then on half as
/// many are kept. The first point and the latest stay.
class ThinnedTrack {
 public:
  static constexpr std::size_t kMostPoints = 20'000;

  explicit ThinnedTrack(std::size_t most_points = kMostPoints) : most_points_(most_points) {}

  void add(const building::TrackPoint& point);
  bool empty() const { return kept_.empty(); }
  /// At most `most_points` + 1, ascending in the order of `add`.
  std::vector<building::TrackPoint> points() const;

 private:
  std::size_t most_points_;
  std::vector<building::TrackPoint> kept_{};
  building::TrackPoint latest_{};
  std::size_t stride_ = 1;   ///< one point of so many is kept
  std::size_t skipped_ = 0;  ///< since the last one kept
};

}  // namespace fiona::recorder
