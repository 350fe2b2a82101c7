#include "fiona/building/geometry.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace fiona::building {

double length_m(Point vector) { return std::sqrt(dot(vector, vector)); }

double distance_m(Point a, Point b) { return length_m(b - a); }

double distance_m(Point p, const Segment& segment) {
  const Point along = segment.to - segment.from;
  const double square = dot(along, along);
  const double share = square > 0.0 ? std::clamp(dot(p - segment.from, along) / square, 0.0, 1.0) : 0.0;
  return distance_m(p, segment.from + along * share);
}

Point unit(Point vector) {
  const double length = length_m(vector);
  return length > 0.0 ? vector * (1.0 / length) : Point{};
}

std::optional<double> crossing(const Segment& path, const Segment& other) {
  const Point along = path.to - path.from;
  const Point across = other.to - other.from;
  const double determinant = cross(along, across);
  if (determinant == 0.0) return std::nullopt;
  const Point gap = other.from - path.from;
  const double on_path = cross(gap, across) / determinant;
  const double on_other = cross(gap, along) / determinant;
  if (on_path < 0.0 || on_path > 1.0 || on_other < 0.0 || on_other > 1.0) return std::nullopt;
  return on_path;
}

bool apart(const Segment& a, const Segment& b) {
  const auto split = [](double a1, double a2, double b1, double b2) {
    return std::max(a1, a2) < std::min(b1, b2) || std::max(b1, b2) < std::min(a1, a2);
  };
  return split(a.from.x_m, a.to.x_m, b.from.x_m, b.to.x_m) || split(a.from.y_m, a.to.y_m, b.from.y_m, b.to.y_m);
}

double signed_area_m2(const Ring& ring) {
  double twice = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) twice += cross(ring[i], ring[(i + 1) % ring.size()]);
  return twice / 2.0;
}

double area_m2(const Polygon& polygon) {
  double area = std::abs(signed_area_m2(polygon.outer));
  for (const Ring& hole : polygon.holes) area -= std::abs(signed_area_m2(hole));
  return area;
}

Point centroid(const Ring& ring) {
  Point sum{};
  double twice = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    // Relative to the first corner: far from the origin the products would cancel.
    const Point a = ring[i] - ring[0];
    const Point b = ring[(i + 1) % ring.size()] - ring[0];
    const double weight = cross(a, b);
    sum = sum + (a + b) * weight;
    twice += weight;
  }
  if (std::abs(twice) < 1e-9) return ring.empty() ? Point{} : ring[0];
  return ring[0] + sum * (1.0 / (3.0 * twice));
}

bool contains(const Ring& ring, Point p) {
  bool inside = false;
  for (std::size_t i = 0, j = ring.size() - 1; i < ring.size(); j = i++) {
    const Point a = ring[i];
    const Point b = ring[j];
    if ((a.y_m > p.y_m) == (b.y_m > p.y_m)) continue;
    if (p.x_m < (b.x_m - a.x_m) * (p.y_m - a.y_m) / (b.y_m - a.y_m) + a.x_m) inside = !inside;
  }
  return inside;
}

bool contains(const Polygon& polygon, Point p) {
  if (!contains(polygon.outer, p)) return false;
  return std::none_of(polygon.holes.begin(), polygon.holes.end(), [&](const Ring& hole) { return contains(hole, p); });
}

std::vector<Segment> edges(const Polygon& polygon) {
  std::vector<Segment> all;
  const auto add = [&all](const Ring& ring) {
    for (std::size_t i = 0; i < ring.size(); ++i) all.push_back({ring[i], ring[(i + 1) % ring.size()]});
  };
  add(polygon.outer);
  for (const Ring& hole : polygon.holes) add(hole);
  return all;
}

Point inner_point(const Polygon& polygon) {
  constexpr int kCells = 24;
  const Box box = bounds(polygon.outer);
  const Point middle = centroid(polygon.outer);
  const std::vector<Segment> sides = edges(polygon);
  const auto clearance_m = [&](Point p) {
    double nearest = std::numeric_limits<double>::max();
    for (const Segment& side : sides) nearest = std::min(nearest, distance_m(p, side));
    return nearest;
  };
  Point best = polygon.outer.front();
  double best_score = -std::numeric_limits<double>::max();
  const auto consider = [&](Point p) {
    if (!contains(polygon, p)) return;
    const double score = clearance_m(p) - 0.1 * distance_m(p, middle);
    if (score > best_score) best = p, best_score = score;
  };
  consider(middle);
  for (int column = 1; column < kCells; ++column) {
    for (int row = 1; row < kCells; ++row) {
      consider({box.low.x_m + (box.high.x_m - box.low.x_m) * column / kCells,
                box.low.y_m + (box.high.y_m - box.low.y_m) * row / kCells});
    }
  }
  return best;
}

void normalise(Polygon& polygon) {
  const auto tidy = [](Ring& ring, bool counter_clockwise) {
    ring.erase(std::unique(ring.begin(), ring.end()), ring.end());
    while (ring.size() > 1 && ring.front() == ring.back()) ring.pop_back();
    if ((signed_area_m2(ring) > 0.0) != counter_clockwise) std::reverse(ring.begin(), ring.end());
  };
  tidy(polygon.outer, true);
  for (Ring& hole : polygon.holes) tidy(hole, false);
}

Box bounds(const Ring& ring) {
  if (ring.empty()) return {};
  Box box{ring.front(), ring.front()};
  for (const Point& p : ring) {
    box.low = {std::min(box.low.x_m, p.x_m), std::min(box.low.y_m, p.y_m)};
    box.high = {std::max(box.high.x_m, p.x_m), std::max(box.high.y_m, p.y_m)};
  }
  return box;
}

}  // namespace fiona::building
