#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "level_plan.hpp"

namespace fiona::guidance {

/// A place of which a user wants to be told when passing.
struct Landmark {
  building::PathPoint place{};
  std::string name{};
};

/// "12.5,-3,1 lift B": x, y in metres, level, and after one blank a name (hmi.proto, CommUserProfileReply). Nothing if
/// it is not such a text.
std::optional<Landmark> parse_landmark(std::string_view text);

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
