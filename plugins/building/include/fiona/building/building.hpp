#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/building/plan.hpp"
#include "fiona/building/routes.hpp"

namespace fiona::building {

struct Crossings {
  int walls = 0;
  double attenuation_db = 0.0;
};

struct Wgs84 {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
};

/// One building, read from one OSM file, XML or PBF, with Simple Indoor Tagging. Immutable; may be read from any
/// thread.
///
/// The file: `indoor=room|corridor|area|wall|level`, `level`, `repeat_on`, `non_existent_levels`, doors
/// (`door=*`, `entrance=*` on nodes), `highway=steps|elevator|footway|...` with levels, `building=*` as
/// outline. `repeat_on` of steps, escalators and ramps names where else their lowest level is found.
/// Platform tags: `fiona:reference=yes` on one node anchors the local frame (optional
/// `fiona:heading`, degrees, true north, clockwise: where the y axis points; default 0); without it the
/// centroid of the outline does, and without an outline that of all rooms. `fiona:attenuation` (dB) on a wall
/// or room overrides its `material`. Heights: `height` on `indoor=level` is that storey's height; else
/// `height` / `building:levels` of the outline; else 3.0 m.
class Building {
 public:
  /// Files above this size are refused: cut the building out of the extract first.
  static constexpr std::uintmax_t kMaxFileBytes = 256u << 20;

  /// Throws fiona::Error if the file cannot be read, is neither OSM XML 0.6 nor PBF, or holds no element with a level.
  static Building read(const std::filesystem::path& file);
  /// The same from text in memory; `name` stands for the file in errors.
  static Building parse(std::string_view bytes, const std::string& name);

  explicit Building(Plan plan);
  Building(Building&&) noexcept;
  Building& operator=(Building&&) noexcept;
  ~Building();

  const Plan& plan() const { return plan_; }
  const std::string& name() const { return plan_.name; }
  const std::vector<Level>& levels() const { return plan_.levels; }
  const std::vector<Room>& rooms() const { return plan_.rooms; }
  const std::vector<Wall>& walls() const { return plan_.walls; }
  const std::vector<Door>& doors() const { return plan_.doors; }
  const std::vector<Connector>& connectors() const { return plan_.connectors; }
  const std::vector<Landmark>& landmarks() const { return plan_.landmarks; }
  const std::vector<std::string>& warnings() const { return plan_.warnings; }
  const Reference& reference() const { return plan_.reference; }

  /// Height of a floor above that of level 0; levels may have a fraction (stairs).
  double height_m(double level) const { return plan_.heights.floor_m(level); }

  /// The walls between two points of one level. Faces of one wall (drawn once for each room beside it) that
  /// are less than 0.35 m apart count once, with the stronger attenuation.
  Crossings walls_crossed(Point a, Point b, double level) const;

  /// The walls between two points at heights above the floor of level 0: each piece of the way is checked
  /// against the walls of the level that it passes through. Floors are not counted here.
  Crossings walls_crossed(Point a, double a_height_m, Point b, double b_height_m) const;

  /// The smallest room around a point; null outside of all rooms.
  const Room* room_at(Point p, double level) const;

  /// By name or ref, exactly; the first on `level`, or on the lowest level that has one. Throws fiona::Error
  /// (NotFound, with the nearest names) if there is none.
  const Room& room(std::string_view name_or_ref, std::optional<double> level = {}) const;

  const Graph& graph() const { return graph_; }

  /// The quickest way on foot; nothing if there is none with these options.
  std::optional<Route> route(const PathPoint& from, const PathPoint& to, const RouteOptions& options = {}) const;
  std::optional<Route> route(const Room& from, const Room& to, const RouteOptions& options = {}) const;

  Point to_local(const Wgs84& place) const;
  Wgs84 to_wgs84(Point p) const;

 private:
  struct Projection;

  const Level* level_below(double height_m) const;

  Plan plan_;
  Graph graph_;
  std::unique_ptr<Projection> projection_;
};

/// The building file that a component's parameter names: a bare name that is not in the working directory is one of the
/// package's (its `share` folder), where that has it.
std::filesystem::path named_file(const std::string& named, const std::filesystem::path& share);

}  // namespace fiona::building
