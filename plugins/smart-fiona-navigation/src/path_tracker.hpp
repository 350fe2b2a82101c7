#pragma once

#include <optional>

#include <fiona/time.hpp>

#include "situation.hpp"

namespace fiona::guidance {

/// Where on a path a walker is, and how they get on.
class PathTracker {
 public:
  explicit PathTracker(TimePoint now) : moved_{.at = now} {}
  /// The maneuvers before the next one are behind the walker.
  void locate(Situation& here);

 private:
  Path::Match match(const Situation& here) const;
  double least_m(const Situation& here) const;
  static bool is_hidden(const Situation& here, building::Point on_path, double sigmas);
  double steadied(double at_m, const Situation& here) const;
  void note_motion(Situation& here);
  void note_progress(Situation& here);
  void note_whether_off(Situation& here, const Path::Match& match);

  double at_m_ = 0.0;
  std::optional<TimePoint> located_{};
  std::optional<TimePoint> off_since_{};
  struct Moved {
    building::Point to{};
    TimePoint at{};
  } moved_;
  struct GotTo {
    double at_m = 0.0;
    TimePoint since{};
  } got_to_{};  ///< a place of the path that they have been about since then
};

}  // namespace fiona::guidance
