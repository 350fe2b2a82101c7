#include "thinned_track.hpp"

namespace fiona::recorder {

void ThinnedTrack::add(const building::TrackPoint& point) {
  latest_ = point;
  if (!kept_.empty() && ++skipped_ < stride_) return;
  skipped_ = 0;
  kept_.push_back(point);
  if (kept_.size() < most_points_) return;
  std::size_t halved = 0;
  for (std::size_t i = 0; i < kept_.size(); i += 2) kept_[halved++] = kept_[i];
  // The last one kept may have gone: what has come since then counts towards the next.
  skipped_ = kept_.size() % 2 == 0 ? stride_ : 0;
  kept_.resize(halved);
  stride_ *= 2;
}

std::vector<building::TrackPoint> ThinnedTrack::points() const {
  std::vector<building::TrackPoint> all = kept_;
  if (skipped_ > 0) all.push_back(latest_);
  return all;
}

}  // namespace fiona::recorder
