// The paths that a guide leads along in the tests, and who walks on them.
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include "guide.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance::world {

inline constexpr double kDegree = std::numbers::pi / 180.0;

inline building::Route corner() {
  building::Route route;
  for (const building::Point point : {building::Point{0, 0}, {0, 20}, {20, 20}}) route.points.push_back({point, 0.0});
  route.length_m = 40;
  return route;
}

/// North for 10 m to a door, through it, and on for 10 m.
inline building::Route through_a_door() {
  using building::Passage;
  building::Route route;
  for (const auto& [y_m, passage] : {std::pair{0.0, Passage::Walk}, std::pair{9.5, Passage::Walk},
                                     std::pair{10.5, Passage::Door}, std::pair{20.0, Passage::Walk}}) {
    route.points.push_back({.at = {0, y_m}, .level = 0, .passage = passage});
  }
  route.length_m = 20;
  return route;
}

/// North through a door, and east `behind_m` behind it.
inline building::Route around_a_corner(double behind_m) {
  building::Route route = through_a_door();
  route.points.back().at.y_m = 10.5 + behind_m;
  route.points.push_back({.at = {20, 10.5 + behind_m}, .level = 0});
  return route;
}

/// East for 10 m along a corridor, and north through a door in its wall.
inline building::Route aside_through_a_door() {
  using building::Passage;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {10, 0}, .level = 0},
                  {.at = {10, 1}, .level = 0, .passage = Passage::Door},
                  {.at = {10, 8}, .level = 0}};
  route.length_m = 18;
  return route;
}

/// North for 10 m to the door of a lift, a metre to where it is taken, and on level 1 on to the north.
inline building::Route by_a_lift() {
  using building::Passage;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {0, 9.5}, .level = 0},
                  {.at = {0, 10.5}, .level = 0, .passage = Passage::Door},
                  {.at = {0, 11}, .level = 0},
                  {.at = {0, 11}, .level = 1, .passage = Passage::Lift},
                  {.at = {0, 20}, .level = 1}};
  route.length_m = 24;
  return route;
}

/// East to stairs that lead north, east and back south to level 1, and on to the south.
inline building::Route up_round_stairs() {
  using building::Passage;
  building::Route route;
  route.points = {{.at = {0, 0}, .level = 0},
                  {.at = {5, 0}, .level = 0},
                  {.at = {5, 4}, .level = 0.5, .passage = Passage::Stairs},
                  {.at = {8, 4}, .level = 0.5, .passage = Passage::Stairs},
                  {.at = {8, 0}, .level = 1, .passage = Passage::Stairs},
                  {.at = {8, -12}, .level = 1}};
  route.length_m = 28;
  return route;
}

struct Heard {
  std::vector<Guide::Advice> all;
  std::vector<hmi::Instruction> numbered;
};

/// Walks along the path at 1.3 m/s, told five times a second; `heading_off` from the path's direction.
inline Heard walk(Guide& guide, double heading_off_rad = 0.0) {
  Heard heard;
  double along_m = 0.0;
  for (double t = 0.0; along_m < guide.path().end_m(); t += 0.2, along_m += 0.26) {
    const auto direction = guide.path().direction(along_m);
    const Walker walker{guide.path().place(along_m), std::atan2(direction.x_m, direction.y_m) + heading_off_rad, 0.0};
    heard.all.push_back(guide.follow(walker, at(t)));
    if (heard.all.back().is_new) heard.numbered.push_back(heard.all.back().instruction);
    if (heard.all.back().arrived) break;
  }
  return heard;
}

}  // namespace fiona::guidance::world
