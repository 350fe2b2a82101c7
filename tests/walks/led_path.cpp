#include "led_path.hpp"

namespace fiona::walks {

LedPath::LedPath(const building::Building& building, const WordCheck& check, const navigation::CommPath& path)
    : check_(check), path_(building, path), announcements_(path_.marks()) {}

void LedPath::walk(const Believed& walker, const building::PathPoint& truly) {
  constexpr double kBack_m = 4.0, kOn_m = 10.0;  // a path may pass the same place twice
  const auto further = [&](double from_m, const building::PathPoint& place) {
    return path_.nearest_m(place, from_m - kBack_m, from_m + kOn_m);
  };
  believed_m_ = further(believed_m_, walker.place);
  truly_m_ = further(truly_m_, truly);
  announcements_.walk(truly_m_);
}

std::string LedPath::fault_of(const hmi::Instruction& said, const Believed& walker) const {
  return check_.fault_of(said, walker, path_, believed_m_);
}

}  // namespace fiona::walks
