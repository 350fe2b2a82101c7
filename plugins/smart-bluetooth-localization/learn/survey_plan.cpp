#include "survey_plan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <sstream>

#include <GeographicLib/LocalCartesian.hpp>

#include "fiona/building/geometry.hpp"

namespace fiona::beacons {
namespace {

using building::Point;

constexpr double kShortest_m = 0.3;  // of a leg, and of a wall that is kept
constexpr double kInside_m = 0.02;   // a wall so far within another leg's surroundings is none
constexpr double kRound_m = 0.1;     // legs between equal way-points are one

struct Leg {
  int level;
  building::Ring around;  ///< convex, counter-clockwise
};

struct Stairs {
  Point from, to;
  int from_level, to_level;
};

building::Ring around(Point a, Point b, double half_m) {
  const Point along = building::unit(b - a) * half_m, left = building::left_of(along);
  const double c = std::tan(M_PI / 8);  // an octagon's corner, so that ends are nearly round
  return {b + along * c - left, b + along - left * c, b + along + left * c, b + along * c + left,
          a - along * c + left, a - along + left * c, a - along - left * c, a - along * c - left};
}

/// The share [from, to] of a segment inside a convex ring, shrunk; from >= to: none.
std::array<double, 2> share_inside(Point a, Point b, const building::Ring& ring) {
  double from = 0.0, to = 1.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Point corner = ring[i], inwards = building::left_of(building::unit(ring[(i + 1) % ring.size()] - corner));
    const double at_a = building::dot(a - corner, inwards) - kInside_m,
                 at_b = building::dot(b - corner, inwards) - kInside_m;
    if (at_a < 0 && at_b < 0) return {1.0, 0.0};
    if (at_a < 0) from = std::max(from, at_a / (at_a - at_b));
    if (at_b < 0) to = std::min(to, at_a / (at_a - at_b));
  }
  return {from, to};
}

std::vector<building::Segment> walls_of(const std::vector<Leg>& legs, std::size_t number) {
  std::vector<building::Segment> walls;
  const building::Ring& ring = legs[number].around;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Point a = ring[i], b = ring[(i + 1) % ring.size()];
    std::vector<std::array<double, 2>> covered;
    for (std::size_t other = 0; other < legs.size(); ++other) {
      if (other == number || legs[other].level != legs[number].level) continue;
      const auto share = share_inside(a, b, legs[other].around);
      if (share[0] < share[1]) covered.push_back(share);
    }
    std::sort(covered.begin(), covered.end());
    covered.push_back({1.0, 1.0});
    double open = 0.0;
    for (const auto& [from, to] : covered) {
      if (from > open) walls.push_back({a + (b - a) * open, a + (b - a) * from});
      open = std::max(open, to);
    }
  }
  std::erase_if(walls, [](const auto& wall) { return building::distance_m(wall.from, wall.to) < 0.02; });
  return walls;
}

class Writer {
 public:
  Writer(std::ostream& out, const building::Wgs84& reference)
      : out_(out), frame_(reference.latitude_deg, reference.longitude_deg, 0.0) {
    out_.precision(12);
  }
  long node(Point p, const std::string& tags = {}) {
    double latitude = 0, longitude = 0, height = 0;
    frame_.Reverse(p.x_m, p.y_m, 0.0, latitude, longitude, height);
    out_ << "<node id='" << --id_ << "' lat='" << latitude << "' lon='" << longitude << "'>" << tags << "</node>\n";
    return id_;
  }
  void way(const std::vector<long>& nodes, const std::string& tags) {
    ways_ << "<way id='" << --id_ << "'>";
    for (const long node : nodes) ways_ << "<nd ref='" << node << "'/>";
    ways_ << tags << "</way>\n";
  }
  void finish() { out_ << ways_.str() << "</osm>\n"; }
  static std::string tag(const std::string& key, const std::string& value) {
    return "<tag k='" + key + "' v='" + value + "'/>";
  }

 private:
  std::ostream& out_;
  std::ostringstream ways_;  // OSM has all nodes first
  GeographicLib::LocalCartesian frame_;
  long id_ = 0;
};

void read(const std::vector<radio::Journey>& walks, double half_m, std::vector<Leg>& legs,
          std::vector<Stairs>& stairs) {
  const auto key = [](Point p) { return std::pair(std::lround(p.x_m / kRound_m), std::lround(p.y_m / kRound_m)); };
  std::set<std::array<std::pair<long, long>, 3>> known;
  for (const auto& walk : walks) {
    for (std::size_t i = 1; i < walk.way_points.size(); ++i) {
      const auto &from = walk.way_points[i - 1].second, &to = walk.way_points[i].second;
      const Point a{from.x_m, from.y_m}, b{to.x_m, to.y_m};
      const auto [low, high] = std::minmax({key(a), key(b)});
      if (!known.insert({low, high, {from.level, to.level}}).second) continue;
      if (from.level != to.level) {
        stairs.push_back({a, b, from.level, to.level});
      } else if (building::distance_m(a, b) > kShortest_m) {
        legs.push_back({from.level, around(a, b, half_m)});
      }
    }
  }
}

}  // namespace

std::string plan_of(const std::vector<radio::Journey>& walks, const PlanOptions& options) {
  std::vector<Leg> legs;
  std::vector<Stairs> stairs;
  read(walks, options.half_width_m, legs, stairs);
  std::ostringstream text;
  text << "<osm version='0.6' generator='fiona-beaconmap'>\n";
  Writer writer(text, options.reference);
  using W = Writer;
  writer.node({0, 0}, W::tag("fiona:reference", "yes") + W::tag("name", options.name));
  for (std::size_t i = 0; i < legs.size(); ++i) {
    const std::string level = W::tag("level", std::to_string(legs[i].level));
    std::vector<long> ring;
    for (const Point corner : legs[i].around) ring.push_back(writer.node(corner));
    ring.push_back(ring.front());
    writer.way(ring, W::tag("indoor", "area") + level);
    for (const auto& wall : walls_of(legs, i)) {
      const long from = writer.node(wall.from);
      writer.way({from, writer.node(wall.to)}, W::tag("indoor", "wall") + level);
    }
  }
  for (const Stairs& s : stairs) {
    const long from = writer.node(s.from, W::tag("level", std::to_string(s.from_level)));
    const long to = writer.node(s.to, W::tag("level", std::to_string(s.to_level)));
    writer.way({from, to}, W::tag("highway", "steps") +
                               W::tag("level", std::to_string(s.from_level) + ";" + std::to_string(s.to_level)));
  }
  writer.finish();
  return text.str();
}

}  // namespace fiona::beacons
