#include "fiona/building/floor_folders.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <memory>
#include <string>
#include <system_error>
#include <vector>

#include <zlib.h>
#include <nlohmann/json.hpp>

#include <fiona/error.hpp>

namespace fiona::building {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kInfo = "floor_info.json";
constexpr const char* kMap = "geojson_map.json";
constexpr std::size_t kMaxFileBytes = 16u << 20;  // unpacked; a mall's floor has 0.3 MiB
constexpr std::size_t kReadBytes = 64 * 1024;
constexpr double kLargestFloor_m = 10'000.0;
constexpr double kHighestFloor = 1000.0;
constexpr double kSmallestOutline_deg = 1e-7;  // a centimetre

[[noreturn]] void refuse(const std::string& name, const std::string& cause) {
  throw Error(ErrorCode::Failed,
              {.what = "cannot read the floor plan " + name + ": " + cause,
               .where = name,
               .expected = "a floor of the Indoor Location Competition 2.0: GeoJSON whose first feature is the outline",
               .next = "get the file again from its source"});
}

/// The text of a file, whether it is packed or not.
std::string unpacked(const fs::path& path) {
  const auto close = [](gzFile file) { gzclose(file); };
  errno = 0;
  std::unique_ptr<gzFile_s, decltype(close)> file(gzopen(path.c_str(), "rb"), close);
  if (!file) refuse(path.string(), std::generic_category().message(errno));
  std::string text;
  for (;;) {
    const std::size_t had = text.size();
    if (had > kMaxFileBytes) refuse(path.string(), "it is larger than 16 MiB");
    text.resize(had + kReadBytes);
    const int got = gzread(file.get(), text.data() + had, kReadBytes);
    text.resize(had + static_cast<std::size_t>(std::max(got, 0)));
    int status = Z_OK;
    const std::string cause = gzerror(file.get(), &status);
    // A packed file that was cut gives what it has, and Z_BUF_ERROR.
    if (got < 0 || status == Z_BUF_ERROR) refuse(path.string(), "it is truncated or garbled: " + cause);
    if (got == 0) return text;
  }
}

/// What the JSON library says, without its own numbering.
std::string cause_of(const json::exception& error) {
  const std::string text = error.what();
  const auto end = text.find("] ");
  return end == std::string::npos ? text : text.substr(end + 2);
}

Ring ring_of(const json& positions) {
  Ring ring;
  for (const json& position : positions) {
    ring.push_back({position.at(0).get<double>(), position.at(1).get<double>()});
  }
  if (ring.size() > 1 && ring.front() == ring.back()) ring.pop_back();
  return ring;
}

Polygon polygon_of(const json& rings) {
  Polygon polygon{ring_of(rings.at(0)), {}};
  for (std::size_t i = 1; i < rings.size(); ++i) polygon.holes.push_back(ring_of(rings[i]));
  return polygon;
}

/// In degrees, longitude first.
std::vector<Polygon> polygons_of(const json& feature) {
  const json& geometry = feature.at("geometry");
  const auto type = geometry.at("type").get<std::string>();
  std::vector<Polygon> polygons;
  if (type == "Polygon") polygons.push_back(polygon_of(geometry.at("coordinates")));
  if (type != "MultiPolygon") return polygons;
  for (const json& rings : geometry.at("coordinates")) polygons.push_back(polygon_of(rings));
  return polygons;
}

/// Degrees to the metres of one floor.
class Fit {
 public:
  Fit(const std::vector<Polygon>& outline, const json& floor_info, const std::string& name) : name_(name) {
    box_ = {{1e9, 1e9}, {-1e9, -1e9}};
    for (const Polygon& polygon : outline) {
      const Box part = bounds(polygon.outer);
      box_.low = {std::min(box_.low.x_m, part.low.x_m), std::min(box_.low.y_m, part.low.y_m)};
      box_.high = {std::max(box_.high.x_m, part.high.x_m), std::max(box_.high.y_m, part.high.y_m)};
    }
    const Point size = box_.high - box_.low;
    if (outline.empty() || !(size.x_m > kSmallestOutline_deg && size.y_m > kSmallestOutline_deg))
      refuse(name, "its first feature is no outline");
    scale_ = {metres(floor_info, "width") / size.x_m, metres(floor_info, "height") / size.y_m};
  }

  Polygon operator()(const Polygon& degrees) const {
    Polygon polygon{fitted(degrees.outer), {}};
    for (const Ring& hole : degrees.holes) polygon.holes.push_back(fitted(hole));
    normalise(polygon);
    return polygon;
  }

 private:
  double metres(const json& floor_info, const char* key) const {
    const double value = floor_info.at("map_info").at(key).get<double>();
    if (value > 0.0 && value <= kLargestFloor_m) return value;
    refuse(name_, std::string(kInfo) + " gives it a " + key + " of " + std::to_string(value) + " m");
  }

  Ring fitted(const Ring& degrees) const {
    const Point size = box_.high - box_.low;
    Ring ring;
    for (const Point& p : degrees) {
      const Point from_corner = p - box_.low;
      const bool near = from_corner.x_m >= -size.x_m && from_corner.x_m <= 2.0 * size.x_m &&
                        from_corner.y_m >= -size.y_m && from_corner.y_m <= 2.0 * size.y_m;
      if (!near) refuse(name_, "a shape lies far outside of the outline");
      ring.push_back({from_corner.x_m * scale_.x_m, from_corner.y_m * scale_.y_m});
    }
    return ring;
  }

  std::string name_;
  Box box_{};
  Point scale_{};  ///< m per degree
};

double level_of(const json& properties, const std::string& name) {
  const double floor = properties.at("floor_num").get<double>();
  if (floor == 0.0 || floor != std::round(floor) || std::abs(floor) > kHighestFloor) {
    refuse(name, "floor_num is " + properties.at("floor_num").dump() + "; floors count ..., -1, 1, 2, ...");
  }
  return floor > 0.0 ? floor - 1.0 : floor;
}

std::string name_of(const json& feature) {
  const json& properties = feature.at("properties");
  const auto name = properties.find("name");
  return name != properties.end() && name->is_string() ? name->get<std::string>() : std::string();
}

void add_features(Plan& plan, const json& features, const json& floor_info, const std::string& name) {
  const json& outline = features.at(0);
  const Level level{level_of(outline.at("properties"), name), 0.0, name_of(outline)};
  const bool known = std::any_of(plan.levels.begin(), plan.levels.end(),
                                 [&](const Level& other) { return other.level == level.level; });
  if (known) refuse(name, "another folder holds the same floor, " + level.name);
  const Fit fit(polygons_of(outline), floor_info, name);
  for (const json& feature : features) {
    for (const Polygon& degrees : polygons_of(feature)) {
      Polygon polygon = fit(degrees);
      if (polygon.outer.size() < 3) continue;
      Room room;
      room.id = {'w', static_cast<std::int64_t>(plan.rooms.size())};
      room.kind = &feature == &outline ? RoomKind::Area : RoomKind::Room;
      room.level = level.level;
      room.name = name_of(feature);
      room.centre = inner_point(polygon);
      room.polygon = std::move(polygon);
      plan.rooms.push_back(std::move(room));
    }
  }
  const auto above = std::find_if(plan.levels.begin(), plan.levels.end(),
                                  [&](const Level& other) { return other.level > level.level; });
  plan.levels.insert(above, level);
}

}  // namespace

void add_floor(Plan& plan, std::string_view floor_info, std::string_view geojson, const std::string& name) {
  try {
    add_features(plan, json::parse(geojson).at("features"), json::parse(floor_info), name);
  } catch (const json::exception& error) {
    refuse(name, cause_of(error));
  }
}

Plan read_floor_folders(const fs::path& folder) {
  Plan plan;
  const fs::path clean = fs::absolute(folder).lexically_normal();
  plan.name = (clean.has_filename() ? clean : clean.parent_path()).filename().string();
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, error)) {
    const fs::path packed = entry.path() / (std::string(kMap) + ".gz");
    const fs::path map = fs::exists(packed, error) ? packed : entry.path() / kMap;
    if (!fs::exists(map, error)) continue;
    add_floor(plan, unpacked(entry.path() / kInfo), unpacked(map), map.string());
  }
  if (!plan.levels.empty()) return plan;
  throw Error(ErrorCode::NotFound, {.what = "this folder holds no floor plan",
                                    .where = folder.string(),
                                    .expected = std::string("a folder for each floor, with ") + kInfo + " and " + kMap +
                                                " or " + kMap + ".gz",
                                    .found = error ? error.message() : "none of them",
                                    .next = "name the folder that holds the floors, or an OSM file"});
}

}  // namespace fiona::building
