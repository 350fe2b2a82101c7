#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "fiona/navigation.pb.h"

#include "beacon_field.hpp"

namespace fiona::beacons {

/// What a level map says about where a person can be and go: walls and rooms of whole levels, and what joins them.
/// Immutable.
class FloorPlan {
 public:
  /// Stairs or the like, or a lift, from one whole level to the next one.
  struct Way {
    struct Place {
      double x_m, y_m, level, on_m;  ///< the last one: from the beginning, in the plane
    };
    int from_level, to_level;
    std::vector<Place> path;  ///< two or more, over landings
    bool by_lift = false;
    bool conveys = false;  ///< an escalator is part of it: who stands there is carried on
    double length_m() const { return path.back().on_m; }
    /// Stairs that are drawn as a point lead nowhere in the plane: they are taken as a lift is.
    bool is_lift() const { return by_lift || length_m() < kShortestStairs_m; }
    Place at(double share) const;  ///< of the length; of a lift: of the levels
    static constexpr double kShortestStairs_m = 0.5;
  };

  /// Without a map: no walls, and everywhere may be gone.
  FloorPlan() = default;
  /// Throws fiona::Error for a map whose walls, rooms or stairs are more than a particle filter can look at in time.
  explicit FloorPlan(const navigation::CommLevelMap& map);

  bool has_walls() const { return !levels_.empty(); }

  /// Whether a wall of the level lies between two points at most a few metres apart.
  bool wall_between(int level, double x1_m, double y1_m, double x2_m, double y2_m) const;

  /// Whether the point is in a room that nobody may enter.
  bool is_closed(int level, double x_m, double y_m) const;

  /// Whether the point is in a room that somebody may enter, or the level has none.
  bool may_be_at(int level, double x_m, double y_m) const;

  /// From the floor of one level up to that of another; nothing if the map does not tell.
  std::optional<double> rise_m(int from_level, int to_level) const;

  /// Stairs, lifts and the like, each way that they may be taken.
  std::span<const Way> ways() const { return ways_; }

  /// What rooms and walls of each level span.
  std::vector<Extent> extents() const;

 private:
  struct Wall {
    double x1_m, y1_m, x2_m, y2_m;
  };
  /// What a square of the plan touches.
  struct Buckets {
    std::vector<std::uint32_t> first;  ///< of each bucket into `items`, one more at the end
    std::vector<std::uint32_t> items;
    std::span<const std::uint32_t> at(std::size_t bucket) const {
      return {items.data() + first[bucket], items.data() + first[bucket + 1]};
    }
  };
  struct Level {
    int level;
    double floor_m = 0.0;  ///< above that of level 0
    std::vector<Wall> walls;
    std::vector<navigation::MapRoom> rooms;
    std::vector<std::pair<Extent, std::size_t>> closed;  ///< around rooms that nobody may enter
    Extent extent;
    std::uint32_t columns = 0, rows = 0;
    Buckets walls_near, rooms_near;
  };
  Level& level_at(double level, double x_m, double y_m);
  const Level* find(int level) const;
  void read_graph(const navigation::CommLevelMap& map);
  void fill_buckets();

  std::vector<Level> levels_;  ///< ascending
  std::vector<Way> ways_;
};

}  // namespace fiona::beacons
