#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fiona/building/geometry.hpp"
#include "fiona/building/levels.hpp"

namespace fiona::building {

/// What an OSM id means depends on the kind of element: "way 12" and "node 12" are different things.
struct ElementId {
  char kind = 'n';  ///< 'n' node, 'w' way, 'r' relation
  std::int64_t number = 0;

  auto operator<=>(const ElementId&) const = default;
};

/// "node 12", "way -3"
std::string text(ElementId id);

/// Where the local frame is anchored.
struct Reference {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  double heading_rad = 0.0;  ///< bearing of the local y axis: from true north, clockwise
  bool from_file = false;    ///< false: the centroid of the outline
};

struct Level {
  double level = 0.0;    ///< OSM level: 0 is the ground floor
  double floor_m = 0.0;  ///< height of its floor above the floor of level 0
  std::string name{};    ///< of the element tagged indoor=level, else "Level N"
};

enum class RoomKind : std::uint8_t {
  Room,      ///< indoor=room: walls around it
  Corridor,  ///< indoor=corridor: walls only where its neighbours have them
  Area,      ///< indoor=area: no walls of its own
  Stairs,    ///< a room with stairs=yes, room=stairs or room=steps
  Lift,      ///< a room with room=elevator, elevator=yes or highway=elevator
};

/// One room on one level. An element on several levels gives one room on each, with the same id.
struct Room {
  ElementId id{};
  RoomKind kind = RoomKind::Room;
  double level = 0.0;
  std::string name{};
  std::string ref{};
  std::string use{};  ///< the value of `room` or `amenity`: office, toilets, ...
  Polygon polygon{};
  Point centre{};  ///< well inside the polygon
  int access = 0;  ///< authentication level from which one may be there, see access_level()
};

/// A straight piece of wall on one level. Doors are gaps between pieces.
struct Wall {
  Segment segment{};
  double level = 0.0;
  double attenuation_db = 0.0;  ///< of a radio signal at 2.4 GHz that passes through once
  bool exterior = false;
  bool drawn = false;  ///< indoor=wall: it may end within a room
};

struct Door {
  ElementId id{};
  Point at{};
  double level = 0.0;
  double width_m = 0.9;
  bool entrance = false;  ///< leads out of the building
  std::string name{};
  Point normal{};  ///< at right angles to its wall, length 1
  int access = 0;
};

enum class ConnectorKind : std::uint8_t { Stairs, Escalator, Ramp, Lift };

struct PathPoint {
  Point at{};
  double level = 0.0;
};

/// What joins levels.
struct Connector {
  ElementId id{};
  ConnectorKind kind = ConnectorKind::Stairs;
  std::string name{};
  std::vector<double> levels{};   ///< ascending, at least two
  std::vector<PathPoint> path{};  ///< as walked, or the stop of a lift on each of its levels
  bool one_way = false;           ///< only from the first point of the path to the last
  int access = 0;
  bool indoors = false;  ///< as of a Path
};

/// Corridors and areas are open to what is beside them.
inline bool has_walls(RoomKind kind) { return kind != RoomKind::Corridor && kind != RoomKind::Area; }

/// A walkable line on one level (highway=footway, corridor, ...). A street or a footway around the building has no
/// level tag: it lies on the level of the elements at its ends, else on the ground.
struct Path {
  ElementId id{};
  std::vector<PathPoint> points{};
  bool steps = false;
  bool conveys = false;  ///< steps: an escalator; else a moving walk
  bool one_way = false;  ///< along the points
  bool around = false;   ///< without a level tag: no part of the building
  bool indoors = false;  ///< by its tags; where they do not say, the outline and the rooms do
  int access = 0;
  int rise = 0;  ///< of steps and escalators: 1 up along the points, -1 down; 0: not told
};

/// A node with tags of the platform's own (`fiona:...`): transmitters, markers.
struct Landmark {
  ElementId id{};
  Point at{};
  double level = 0.0;
  double height_m = 0.0;  ///< above the floor of its level (tag `height`), 0 if not told
  std::map<std::string, std::string> tags{};
};

/// What a file says about a building, in its local frame.
struct Plan {
  std::string name{};
  Reference reference{};
  std::vector<Level> levels{};  ///< ascending
  Heights heights{};
  Polygon outline{};  ///< empty if the file has none
  std::vector<Room> rooms{};
  std::vector<Wall> walls{};  ///< ascending by level
  std::vector<Door> doors{};
  std::vector<Connector> connectors{};
  std::vector<Path> paths{};
  std::vector<Landmark> landmarks{};
  /// What could not be read and was left out: one sentence each, which names the element.
  std::vector<std::string> warnings{};
};

/// Access of what everyone may use, of what needs a right, and of what nobody may use.
inline constexpr int kOpen = 0;
inline constexpr int kByRight = 5;
inline constexpr int kClosed = 10;

/// Attenuation that is taken for a wall whose material the file does not tell.
inline constexpr double kInteriorWall_db = 5.0;
inline constexpr double kExteriorWall_db = 10.0;

/// The attenuation of a material named as in the OSM tag `material`, at 2.4 GHz; nothing for a name not
/// known. Source: rounded means of the tables in ITU-R P.2040 and of the COST 231 final report, chapter 4.7.
std::optional<double> material_attenuation_db(const std::string& material);

}  // namespace fiona::building
