#pragma once

#include <cstdint>
#include <optional>

#include <fiona/walk/walk.hpp>

namespace fiona::walk {

/// Accelerometer, gyroscope and magnetometer at one time, in the units of the document's GetIMU.
struct MergedImu {
  std::int64_t t_ms;
  double acceleration_g[3];
  double rate_dps[3];
  double field_gauss[3];
};

/// Joins the separate rows of a recording into whole samples: one per accelerometer row, with the mean angular rate
/// since the last one (gyroscopes often run faster) and the newest magnetic field.
class ImuMerger {
 public:
  /// Feeds one row; a whole sample comes back once all three sensors have been seen.
  std::optional<MergedImu> feed(const Event& event);

 private:
  double rate_sum_[3] = {};
  int rate_count_ = 0;
  double last_rate_[3] = {};
  bool rate_seen_ = false;
  std::optional<Magnetometer> field_;
};

}  // namespace fiona::walk
