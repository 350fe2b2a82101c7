#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "fiona/building/geometry.hpp"

namespace fiona::building {

/// The walls of a level, halved again and again by where they are: a line of sight is near few of them.
class WallTree {
 public:
  void add(const Segment& wall) { walls_.push_back(wall); }
  void build() { build(0, walls_.size()); }

  /// `steps` grows by what it costs.
  bool meets(const Segment& path, std::size_t& steps, std::size_t index = 0) const {
    const Node& node = nodes_[index];
    ++steps;
    if (misses(path, node.box)) return false;
    if (node.second != 0) return meets(path, steps, index + 1) || meets(path, steps, node.second);
    steps += node.end - node.begin;
    return std::any_of(walls_.begin() + node.begin, walls_.begin() + node.end,
                       [&](const Segment& wall) { return crossing(path, wall).has_value(); });
  }

 private:
  struct Node {
    Box box{};
    std::ptrdiff_t begin = 0, end = 0;
    std::size_t second = 0;  ///< the node of its second half; that of its first half follows it; 0: it is not halved
  };

  std::size_t build(std::size_t begin, std::size_t end) {
    constexpr double kSlack_m = 1e-6;
    constexpr std::size_t kFewest = 4;
    const std::size_t index = nodes_.size();
    Ring ends;
    for (std::size_t i = begin; i < end; ++i) ends.insert(ends.end(), {walls_[i].from, walls_[i].to});
    Box box = bounds(ends);
    const Point size = box.high - box.low;
    box = {box.low - Point{kSlack_m, kSlack_m}, box.high + Point{kSlack_m, kSlack_m}};
    nodes_.push_back({box, static_cast<std::ptrdiff_t>(begin), static_cast<std::ptrdiff_t>(end)});
    if (end - begin <= kFewest) return index;
    const std::size_t middle = (begin + end) / 2;
    const auto at = [&](std::size_t i) { return walls_.begin() + static_cast<std::ptrdiff_t>(i); };
    std::nth_element(at(begin), at(middle), at(end), [&](const Segment& a, const Segment& b) {
      const Point p = a.from + a.to, q = b.from + b.to;
      return size.x_m > size.y_m ? p.x_m < q.x_m : p.y_m < q.y_m;
    });
    build(begin, middle);
    const std::size_t second = build(middle, end);
    nodes_[index].second = second;
    return index;
  }

  /// Whether the box lies beside the path, or on one side of its line.
  static bool misses(const Segment& path, const Box& box) {
    if (apart(path, {box.low, box.high})) return true;
    const Point along = path.to - path.from, size = box.high - box.low;
    const double beside = cross(along, (box.low + box.high) * 0.5 - path.from);
    return 2 * std::abs(beside) > std::abs(along.x_m) * size.y_m + std::abs(along.y_m) * size.x_m;
  }

  std::vector<Segment> walls_{};
  std::vector<Node> nodes_{};
};

}  // namespace fiona::building
