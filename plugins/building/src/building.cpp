#include "fiona/building/building.hpp"

#include <algorithm>
#include <cmath>
#include <system_error>

#include <fiona/error.hpp>

#include "draft.hpp"
#include "local_frame.hpp"
#include "osm_file.hpp"

namespace fiona::building {
namespace {

/// Two faces of one wall are not further apart than this.
constexpr double kThickestWall_m = 0.35;

Plan make_plan(const OsmFile& file) {
  const std::vector<Area> areas = areas_of(file);
  const Area* outline = find_outline(file, areas);
  Draft draft{file, find_reference(file, outline)};
  draft.outline = outline;
  if (outline != nullptr) {
    const auto absent = parse_levels(tag(*outline->tags, "non_existent_levels"));
    for (double level : absent.value_or(std::vector<double>{})) {
      if (level == std::floor(level)) draft.absent_levels.insert(level);  // what lies between two levels is no storey
    }
  }
  for (const auto& [id, way] : file.ways) {
    for (std::int64_t node : way.nodes) draft.ways_of_node[node].push_back(id);
  }
  add_rooms(draft, areas);
  add_connectors(draft);
  add_levels(draft);
  if (draft.plan.levels.empty()) {
    throw Error(ErrorCode::Failed,
                {.what = "the building file " + file.name + " has no room, stairs or way with a level that can be read",
                 .where = file.name,
                 .expected = "indoor=room, indoor=corridor or indoor=area with level=0, -1;0 or 1-3",
                 .found = draft.plan.warnings.empty() ? "none of them" : draft.plan.warnings.front(),
                 .next = "tag them: https://wiki.openstreetmap.org/wiki/Simple_Indoor_Tagging"});
  }
  add_walls(draft);
  add_doors(draft);
  cut_doors(draft);
  draft.work.limit(draft.plan.walls.size(), kMostWalls, "walls", {});
  draft.work.limit(draft.plan.levels.size(), kMostLevels, "levels", {});
  add_landmarks(draft);
  if (draft.plan.name.empty()) draft.plan.name = std::filesystem::path(file.name).stem().string();
  if (draft.untold > 0) draft.plan.warnings.push_back("and " + std::to_string(draft.untold) + " more like these");
  return std::move(draft.plan);
}

/// The cosine-free distance of two crossings of one path, measured at right angles to the wall.
double thickness_m(Point path, double from_share, double to_share, const Segment& wall) {
  return std::abs(cross(path * (to_share - from_share), unit(wall.to - wall.from)));
}

}  // namespace

struct Building::Projection {
  LocalFrame frame;
};

Building::Building(Plan plan)
    : plan_(std::move(plan)),
      graph_(build_graph(plan_)),
      projection_(std::make_unique<Projection>(Projection{LocalFrame{plan_.reference}})) {}

Building::Building(Building&&) noexcept = default;
Building& Building::operator=(Building&&) noexcept = default;
Building::~Building() = default;

std::filesystem::path named_file(const std::string& named, const std::filesystem::path& share) {
  std::error_code unknown;
  const std::filesystem::path file(named);
  if (file.has_parent_path() || std::filesystem::exists(file, unknown)) return file;
  return std::filesystem::exists(share / file, unknown) ? share / file : file;
}

Building Building::read(const std::filesystem::path& file) { return Building(make_plan(read_osm_file(file.string()))); }

Building Building::parse(std::string_view bytes, const std::string& name) {
  return Building(make_plan(parse_osm(bytes, name)));
}

Crossings Building::walls_crossed(Point a, Point b, double level) const {
  struct Hit {
    double share;
    const Wall* wall;
  };
  std::vector<Hit> hits;
  const Segment path{a, b};
  const auto below = [](const Wall& wall, double bound) { return wall.level < bound; };
  auto wall = std::lower_bound(plan_.walls.begin(), plan_.walls.end(), level, below);
  for (; wall != plan_.walls.end() && wall->level == level; ++wall) {
    if (apart(path, wall->segment)) continue;
    if (const auto share = crossing(path, wall->segment)) hits.push_back({*share, &*wall});
  }
  std::sort(hits.begin(), hits.end(), [](const Hit& x, const Hit& y) { return x.share < y.share; });
  Crossings total;
  for (std::size_t i = 0; i < hits.size();) {
    double loss = 0.0;
    std::size_t j = i;
    for (;
         j < hits.size() && thickness_m(b - a, hits[i].share, hits[j].share, hits[i].wall->segment) <= kThickestWall_m;
         ++j) {
      loss = std::max(loss, hits[j].wall->attenuation_db);
    }
    ++total.walls;
    total.attenuation_db += loss;
    i = j;
  }
  return total;
}

const Level* Building::level_below(double height_m) const {
  const Level* below = nullptr;
  for (const Level& level : plan_.levels) {
    if (level.floor_m <= height_m + 1e-9) below = &level;
  }
  return below;
}

Crossings Building::walls_crossed(Point a, double a_height_m, Point b, double b_height_m) const {
  if (a_height_m > b_height_m) return walls_crossed(b, b_height_m, a, a_height_m);
  std::vector<double> cuts{0.0};
  for (const Level& level : plan_.levels) {
    if (level.floor_m > a_height_m && level.floor_m < b_height_m) {
      cuts.push_back((level.floor_m - a_height_m) / (b_height_m - a_height_m));
    }
  }
  cuts.push_back(1.0);
  Crossings total;
  for (std::size_t i = 1; i < cuts.size(); ++i) {
    const double middle_m = a_height_m + (b_height_m - a_height_m) * (cuts[i - 1] + cuts[i]) / 2;
    const Level* level = level_below(middle_m);
    if (level == nullptr) continue;
    const Crossings part = walls_crossed(a + (b - a) * cuts[i - 1], a + (b - a) * cuts[i], level->level);
    total.walls += part.walls;
    total.attenuation_db += part.attenuation_db;
  }
  return total;
}

const Room* Building::room_at(Point p, double level) const {
  const auto index = room_index_at(plan_, p, level);
  return index ? &plan_.rooms[*index] : nullptr;
}

const Room& Building::room(std::string_view name_or_ref, std::optional<double> level) const {
  const Room* best = nullptr;
  std::vector<std::string> names;
  for (const Room& room : plan_.rooms) {
    for (const std::string& name : {room.name, room.ref}) {
      if (!name.empty()) names.push_back(name);
    }
    if ((room.name != name_or_ref && room.ref != name_or_ref) || name_or_ref.empty()) continue;
    if (level ? room.level == *level && best == nullptr : best == nullptr || room.level < best->level) best = &room;
  }
  if (best != nullptr) return *best;
  throw Error(ErrorCode::NotFound, {.what = "there is no room " + std::string(name_or_ref) + " in " + plan_.name +
                                            (level ? " on level " + level_text(*level) : ""),
                                    .where = plan_.name,
                                    .expected = "the name or ref of a room",
                                    .next = "choose one of the rooms of the building",
                                    .near = nearest_names(name_or_ref, names)});
}

std::optional<Route> Building::route(const PathPoint& from, const PathPoint& to, const RouteOptions& options) const {
  return find_route(plan_, graph_, from, to, options);
}

std::optional<Route> Building::route(const Room& from, const Room& to, const RouteOptions& options) const {
  return route(PathPoint{from.centre, from.level}, PathPoint{to.centre, to.level}, options);
}

Point Building::to_local(const Wgs84& place) const { return projection_->frame.to_local(place); }

Wgs84 Building::to_wgs84(Point p) const { return projection_->frame.to_wgs84(p); }

}  // namespace fiona::building
