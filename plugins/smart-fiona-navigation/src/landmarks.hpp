#pragma once

#include <string>
#include <vector>

#include "level_plan.hpp"

namespace fiona::guidance {

/// A place of which a user wants to be told when passing.
struct Landmark {
  building::PathPoint place{};
  std::string name{};
};

/// Tells of each point once in passing: near it, on its level, with no wall between; again after the user was away.
class Passing {
 public:
  /// Those that were near stay told.
  void watch(std::vector<Landmark> landmarks);
  /// The points that are passed now and were not before.
  std::vector<Landmark> follow(const LevelPlan& plan, const building::PathPoint& place, double near_m);

 private:
  struct Watched {
    Landmark landmark;
    bool told = false;
  };
  std::vector<Watched> watched_;
};

}  // namespace fiona::guidance
