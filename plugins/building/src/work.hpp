#pragma once

#include <cstddef>
#include <string>

#include <fiona/error.hpp>

#include "fiona/building/plan.hpp"

namespace fiona::building {

/// What a service may say of a building (navigation.proto, CommLevelMap).
inline constexpr std::size_t kMostRooms = 65'536;
inline constexpr std::size_t kMostWalls = 262'144;
inline constexpr std::size_t kMostDoors = 65'536;
inline constexpr std::size_t kMostNodes = 262'144;
inline constexpr std::size_t kMostEdges = 1'048'576;
inline constexpr std::size_t kMostLevels = 256;
inline constexpr std::size_t kMostCorners = 20'000;  ///< of one room

/// Bounds what a file can cost: each step of a search spends a little, and too much is an error, not a wait.
class Work {
 public:
  explicit Work(std::string file) : file_(std::move(file)) {}

  /// About half a nanosecond each.
  void spend(std::size_t steps, ElementId at) {
    spent_ += steps;
    if (spent_ > kMost) refuse(at, "takes too long to make sense of", "a building that takes some seconds");
  }
  bool is_half_spent() const { return spent_ > kMost / 2; }
  /// Throws if there are `count` things where at most `most` are read.
  void limit(std::size_t count, std::size_t most, const char* things, ElementId at) const {
    if (count > most) refuse(at, "has too many " + std::string(things), "at most " + std::to_string(most));
  }

 private:
  static constexpr std::size_t kMost = 4'000'000'000;

  [[noreturn]] void refuse(ElementId at, const std::string& what, const std::string& expected) const {
    throw Error(ErrorCode::Failed, {.what = "the building file " + file_ + " " + what,
                                    .where = file_ + ", " + text(at),
                                    .expected = expected,
                                    .next = "correct that element, or cut the building out: osmium extract -b "
                                            "WEST,SOUTH,EAST,NORTH " +
                                            file_ + " -o building.osm"});
  }

  std::string file_;
  std::size_t spent_ = 0;
};

}  // namespace fiona::building
