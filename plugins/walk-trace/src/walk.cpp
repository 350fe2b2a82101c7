#include <fiona/walk/walk.hpp>

#include <algorithm>

namespace fiona::walk {

bool Walk::has_inertial_rows() const {
  return std::any_of(events.begin(), events.end(),
                     [](const Event& event) { return std::holds_alternative<Accelerometer>(event.data); });
}

std::vector<std::pair<std::int64_t, WayPoint>> way_points_of(const Walk& walk) {
  std::vector<std::pair<std::int64_t, WayPoint>> points;
  for (const Event& event : walk.events) {
    const auto* point = std::get_if<WayPoint>(&event.data);
    if (point != nullptr && (points.empty() || points.back().first < event.t_ms)) {
      points.emplace_back(event.t_ms, *point);
    }
  }
  return points;
}

std::optional<WayPoint> position_at(const std::vector<std::pair<std::int64_t, WayPoint>>& way_points,
                                    std::int64_t t_ms) {
  if (way_points.empty()) return std::nullopt;
  if (t_ms <= way_points.front().first) return way_points.front().second;
  if (t_ms >= way_points.back().first) return way_points.back().second;
  const auto next = std::upper_bound(way_points.begin(), way_points.end(), t_ms,
                                     [](std::int64_t t, const auto& point) { return t < point.first; });
  const auto& [t0, from] = *(next - 1);
  const auto& [t1, to] = *next;
  if (from.level != to.level) return std::nullopt;
  const double part = double(t_ms - t0) / double(t1 - t0);
  return WayPoint{from.x_m + part * (to.x_m - from.x_m), from.y_m + part * (to.y_m - from.y_m), from.level};
}

}  // namespace fiona::walk
