#pragma once

#include <optional>
#include <vector>

namespace fiona::building {

/// A place in the plane of a building: metres in its local frame (x east, y north while the reference heading
/// is 0).
struct Point {
  double x_m = 0.0;
  double y_m = 0.0;

  bool operator==(const Point&) const = default;
};

constexpr Point operator+(Point a, Point b) { return {a.x_m + b.x_m, a.y_m + b.y_m}; }
constexpr Point operator-(Point a, Point b) { return {a.x_m - b.x_m, a.y_m - b.y_m}; }
constexpr Point operator*(Point a, double scale) { return {a.x_m * scale, a.y_m * scale}; }
constexpr double dot(Point a, Point b) { return a.x_m * b.x_m + a.y_m * b.y_m; }
constexpr double cross(Point a, Point b) { return a.x_m * b.y_m - a.y_m * b.x_m; }

struct Segment {
  Point from{};
  Point to{};

  bool operator==(const Segment&) const = default;
};

/// Corners in order; the last one is joined to the first, which is not repeated.
using Ring = std::vector<Point>;

/// `outer` turns counter-clockwise and `holes` clockwise, so the inside is always on the left of an edge.
struct Polygon {
  Ring outer{};
  std::vector<Ring> holes{};
};

struct Box {
  Point low{};
  Point high{};
};

double length_m(Point vector);
double distance_m(Point a, Point b);
double distance_m(Point p, const Segment& segment);

/// The vector at length 1; (0, 0) stays (0, 0).
Point unit(Point vector);

/// The vector turned by 90 degrees to the left.
constexpr Point left_of(Point vector) { return {-vector.y_m, vector.x_m}; }

/// Where `path` meets `other`, as a share of `path` in [0, 1]; nothing if they do not meet or are parallel.
std::optional<double> crossing(const Segment& path, const Segment& other);

/// Whether the boxes around them are: cheap, and true of nearly all that do not meet.
bool apart(const Segment& a, const Segment& b);

/// Signed: positive when the ring turns counter-clockwise.
double signed_area_m2(const Ring& ring);
double area_m2(const Polygon& polygon);
Point centroid(const Ring& ring);
bool contains(const Ring& ring, Point p);
bool contains(const Polygon& polygon, Point p);

/// All edges of the outer ring and the holes.
std::vector<Segment> edges(const Polygon& polygon);

/// A point well inside: the best of a grid by distance to the nearest edge, with a preference for the middle.
Point inner_point(const Polygon& polygon);

/// Makes the outer ring counter-clockwise and the holes clockwise, and drops repeated corners.
void normalise(Polygon& polygon);

Box bounds(const Ring& ring);

}  // namespace fiona::building
