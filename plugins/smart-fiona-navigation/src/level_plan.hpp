#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <fiona/navigation.pb.h>
#include <fiona/building/routes.hpp>

namespace fiona::guidance {

/// A building as the service LevelMap tells it: rooms and walls to see by, and the graph to walk by.
struct LevelPlan {
  std::string name{};
  std::uint64_t version = 0;
  double heading_rad = 0.0;  ///< where the y axis points: clockwise from true north
  /// Of the frame of its places, where the map tells it.
  std::optional<building::Reference> reference{};
  building::Plan plan{};
  building::Graph graph{};

  /// The map's level at a height between levels, if it is within `reach` levels of it.
  std::optional<double> level_near(double level, double reach) const;
  /// Whether a wall of the level stands between two places.
  bool walled(building::Point a, building::Point b, double level) const;
  /// Whether one comes from the one place to the other through a door.
  bool behind_door(building::Point a, building::Point b, double level) const;
  /// What people call the room at a place: its name, else its number; nothing outside of all rooms.
  std::optional<std::string> room_name(const building::PathPoint& place) const;
};

/// Of the frame that a place is told in, if it says so.
std::optional<building::Reference> reference_of(const localisation::CommPosition& place);

/// How a point of a route is reached, as the map's contract has it.
navigation::MapEdge::Kind kind_of(const building::RoutePoint& point);

/// Throws fiona::Error that names the map and the first element of it that makes no sense: a map without levels, an
/// edge to a node that is not there, an outline with more x than y. Edges of unknown kind are left out.
LevelPlan read_level_plan(const navigation::CommLevelMap& map);

}  // namespace fiona::guidance
