#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/building/plan.hpp"
#include "local_frame.hpp"
#include "osm_file.hpp"
#include "work.hpp"

namespace fiona::building {

/// Closed areas of an element: of a closed way, or of the rings of a multipolygon relation.
struct Area {
  ElementId id{};
  const Tags* tags = nullptr;
  std::vector<std::vector<std::int64_t>> outers{};  ///< node ids, first not repeated
  std::vector<std::vector<std::int64_t>> inners{};
  std::vector<std::int64_t> ways{};
  bool is_whole = true;  ///< all its members are in the file, and close to rings
};

/// A plan while it is made, step by step, from the elements of a file.
struct Draft {
  Draft(const OsmFile& file_, const Reference& reference) : file(file_), frame(reference), work(file_.name) {
    plan.reference = reference;
  }

  /// A building is not larger than this around its reference.
  static constexpr double kFarthest_m = 5000.0;

  const OsmFile& file;
  LocalFrame frame;
  Work work;
  Plan plan{};
  const Area* outline = nullptr;
  std::set<double> absent_levels{};  ///< non_existent_levels
  std::map<std::int64_t, std::vector<std::int64_t>> ways_of_node{};
  std::map<std::int64_t, std::set<double>> levels_of_way{};  ///< of rooms and walls that the way bounds
  std::map<ElementId, double> attenuation_of_room{};
  std::size_t untold = 0;  ///< warnings that were counted only

  Point at(const OsmNode& node) const { return frame.to_local({node.latitude_deg, node.longitude_deg}); }
  /// Beyond the first thousand they are counted only.
  void warn(ElementId id, const std::string& sentence);

  /// The levels of an element by `level` and `repeat_on`; empty, and a warning if the tag is there but
  /// unreadable.
  std::vector<double> levels_of(ElementId id, const Tags& tags);
  /// The place of a node that `user` names; nothing, and a warning, if it is not in the file or nowhere near.
  std::optional<Point> place_of(ElementId user, std::int64_t node);
  /// The corners of a way as points; nothing, and a warning, if one has no place.
  std::optional<std::vector<Point>> points_of(std::int64_t way);
  /// `fiona:attenuation`, `wall:material` or `material`.
  std::optional<double> attenuation_db(ElementId id, const Tags& tags);
};

/// Every closed way with tags and every relation of type multipolygon.
std::vector<Area> areas_of(const OsmFile& file);

/// The steps, in this order: each uses what the ones before have put into the plan.
Reference find_reference(const OsmFile& file, const Area* outline);
/// The one in which most of what lies on a level is. Throws Error Failed where that takes too long to tell.
const Area* find_outline(const OsmFile& file, const std::vector<Area>& areas);
void add_rooms(Draft& draft, const std::vector<Area>& areas);
void add_connectors(Draft& draft);
void add_levels(Draft& draft);
void add_landmarks(Draft& draft);
void add_walls(Draft& draft);
void add_doors(Draft& draft);
void cut_doors(Draft& draft);

bool is_indoor_area(const Tags& tags);

/// The authentication level from which one may use an element: `fiona:access` (0 to 10) as it stands, else by `foot`
/// and `access`: kClosed for no, kByRight for private, staff, employees and the like, else kOpen.
int access_level(Draft& draft, ElementId id, const Tags& tags);

}  // namespace fiona::building
