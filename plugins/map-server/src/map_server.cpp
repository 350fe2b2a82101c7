#include "map_server.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <set>
#include <system_error>

#include "fiona/hull.hpp"
#include "fiona/objects/session_user.hpp"
#include "level_map.hpp"
#include "map_name.hpp"

namespace fiona::map_server {
namespace {

using building::Building;
using building::Point;
using building::Wgs84;
using navigation::CommCoordConvRequest;

constexpr std::size_t kMostWarnings = 5;

/// FNV-1a of all that the map says. Source: RFC draft-eastlake-fnv. Not against forgery: whoever may write the file may
/// write any map. Of 63 bits, as whole numbers are shown, and not 0.
std::uint64_t version_of(const Building& building, const std::string& name) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : level_map_of(building, name, {}).SerializeAsString()) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  }
  return std::max<std::uint64_t>(1, hash & 0x7fffffffffffffffu);
}

/// Without what says that it is a map: `museum` of `museum.osm.pbf`.
std::string name_of(const std::filesystem::path& file) {
  const std::filesystem::path stem = file.stem();
  return (file.extension() == ".pbf" && stem.extension() == ".osm" ? stem.stem() : stem).string();
}

std::string degrees(double value) { return building::level_text(std::round(value * 1e7) / 1e7); }

/// What a client may ask for.
std::string extent(const Building& building, const PixelFrame& frame) {
  const auto columns = static_cast<double>(frame.columns), rows = static_cast<double>(frame.rows);
  std::array<double, 4> latitudes_deg{}, longitudes_deg{};
  const std::array<Point, 4> corners = {{{0.0, 0.0}, {columns, 0.0}, {0.0, rows}, {columns, rows}}};
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Wgs84 place = building.to_wgs84(frame.to_local(corners[i]));
    latitudes_deg[i] = place.latitude_deg;
    longitudes_deg[i] = place.longitude_deg;
  }
  const auto [south, north] = std::minmax_element(latitudes_deg.begin(), latitudes_deg.end());
  const auto [west, east] = std::minmax_element(longitudes_deg.begin(), longitudes_deg.end());
  return "latitude " + degrees(*south) + " to " + degrees(*north) + ", longitude " + degrees(*west) + " to " +
         degrees(*east);
}

/// The whole map where no corner is set, or all four are 0. Throws Error Usage for a window without pixels.
template <class Request>
Window window_of(const Building& building, const PixelFrame& frame, const Request& request) {
  const Window whole{0, 0, frame.columns, frame.rows};
  const std::array<bool, 4> set = {request.has_map_crop_ul_lon(), request.has_map_crop_ul_lat(),
                                   request.has_map_crop_lr_lon(), request.has_map_crop_lr_lat()};
  if (request.map_crop_ul_lon() == 0 && request.map_crop_ul_lat() == 0 && request.map_crop_lr_lon() == 0 &&
      request.map_crop_lr_lat() == 0) {
    return whole;
  }
  if (std::count(set.begin(), set.end(), true) != 4) {
    throw Error(ErrorCode::Usage, {.what = "a part of a map needs both corners",
                                   .expected = "map_crop_ul_lon, _ul_lat, _lr_lon and _lr_lat, or none of them"});
  }
  const auto pixel = [&](double latitude_deg, double longitude_deg) {
    return frame.to_pixel(building.to_local({latitude_deg, longitude_deg}));
  };
  // A corner that came out of CoordinateConversion is on its pixel's border but for rounding.
  constexpr double kRounding_px = 1e-6;
  const Point upper_left = pixel(request.map_crop_ul_lat(), request.map_crop_ul_lon());
  const Point lower_right = pixel(request.map_crop_lr_lat(), request.map_crop_lr_lon());
  const auto clamped = [](double value, int most) { return std::clamp(value, 0.0, static_cast<double>(most)); };
  const int left = static_cast<int>(std::floor(clamped(upper_left.x_m + kRounding_px, frame.columns)));
  const int top = static_cast<int>(std::floor(clamped(upper_left.y_m + kRounding_px, frame.rows)));
  const int right = static_cast<int>(std::ceil(clamped(lower_right.x_m - kRounding_px, frame.columns)));
  const int bottom = static_cast<int>(std::ceil(clamped(lower_right.y_m - kRounding_px, frame.rows)));
  if (right <= left || bottom <= top) {
    throw Error(ErrorCode::Usage, {.what = "the part asked for has no pixel of the map",
                                   .expected = "an upper left corner above and left of the lower right one, within " +
                                               extent(building, frame)});
  }
  return {left, top, right - left, bottom - top};
}

}  // namespace

MapServer::Map::Map(Building building_, std::string name_, double pixel_m)
    : building(std::move(building_)),
      name(std::move(name_)),
      frame(frame_of(building.plan(), pixel_m)),
      version(version_of(building, name)) {}

std::filesystem::path MapServer::file() const {
  return params_->building().empty() ? resource("building.osm")
                                     : building::named_file(params_->building(), hull().share());
}

void MapServer::check(const Parameters& draft) const {
  if (!draft.map_name().empty() && !is_map_name(draft.map_name())) {
    throw Error(ErrorCode::Usage, {.what = "parameter 'map_name' does not take this value",
                                   .expected = "a name without '@', '/', '..' and control characters",
                                   .found = draft.map_name()});
  }
  if (!map_) return;
  if (draft.building() != params_->building() || draft.map_name() != params_->map_name()) {
    throw Error(ErrorCode::NotAllowed, {.what = "the map is being served: only pixel_size can still be changed",
                                        .where = name(),
                                        .next = "unload " + name() + ", then load it with the new parameters"});
  }
  frame_of(map_->building.plan(), draft.pixel_size());
}

void MapServer::changed() {
  if (map_) use(read());
}

void MapServer::on_start() {
  read_ = stamp();
  use(read());
  const auto& warnings = map_->building.warnings();
  for (std::size_t i = 0; i < std::min(warnings.size(), kMostWarnings); ++i) log(LogLevel::Warning, warnings[i]);
  if (warnings.size() > kMostWarnings) {
    log(LogLevel::Warning, std::to_string(warnings.size() - kMostWarnings) + " more like this in " + file().string());
  }
}

std::shared_ptr<const MapServer::Map> MapServer::read() const {
  const std::filesystem::path path = file();
  std::string map_name = params_->map_name().empty() ? name_of(path) : params_->map_name();
  if (!is_map_name(map_name)) {
    throw Error(ErrorCode::Usage,
                {.what = "the file's name cannot be the name of its maps",
                 .where = path.string(),
                 .expected = "a name without '@', '..' and control characters",
                 .found = map_name,
                 .next = "load map-server as " + name() + " building=" + params_->building() + " map_name=NAME"});
  }
  // Shared with requests that wait for a session to be checked while the file changes.
  return std::make_shared<const Map>(Building::read(path), std::move(map_name), params_->pixel_size());
}

void MapServer::use(std::shared_ptr<const Map> map) {
  const bool other = !map_ || map_->version != map->version;
  map_ = std::move(map);
  version_.set(map_->version);
  if (!other) return;
  log(LogLevel::Info, map_->name + ": " + std::to_string(map_->building.levels().size()) + " levels, " +
                          std::to_string(map_->building.rooms().size()) + " rooms, " +
                          std::to_string(map_->building.graph().edges.size()) + " edges");
}

MapServer::Stamp MapServer::stamp() const {
  std::error_code gone;
  const std::filesystem::path path = file();
  const Stamp stamp{std::filesystem::last_write_time(path, gone), std::filesystem::file_size(path, gone)};
  return gone ? Stamp{} : stamp;
}

/// A file is read once it has stood still for a period: one that is being copied is half a map. One that is gone is
/// told once, as one that cannot be read.
void MapServer::look() {
  const Stamp now = stamp();
  if (now != read_ && now == seen_) {
    read_ = now;
    try {
      use(read());
    } catch (const Error& error) {
      failed_reads_.set(++failures_);
      log(LogLevel::Warning, std::string("the map of before is served on: ") + error.what());
    }
  }
  seen_ = now;
  navigation::LevelMapVersion version;
  version.set_version(map_->version);
  change_.put(version);
}

std::optional<navigation::LevelMapVersion> MapServer::differs(navigation::LevelMapVersion& known,
                                                              const navigation::LevelMapVersion& now) {
  if (known.version() == now.version()) return std::nullopt;
  known = now;
  return now;
}

double MapServer::level_of(const Map& map, const std::string& map_name) const {
  const auto asked = MapName::parse(map_name);
  if (asked && asked->name == map.name) {
    for (const building::Level& level : map.building.levels()) {
      if (level.level == asked->level) return level.level;
    }
  }
  std::vector<std::string> names;
  for (const building::Level& level : map.building.levels()) names.push_back(MapName{map.name, level.level}.text());
  std::string all = names.front();
  for (std::size_t i = 1; i < names.size() && i < 20; ++i) all += ", " + names[i];
  throw Error(ErrorCode::NotFound, {.what = "there is no map '" + map_name + "'",
                                    .where = name(),
                                    .expected = all,
                                    .next = "name a map as NAME@LEVEL",
                                    .near = nearest_names(map_name, names)});
}

Async<int> MapServer::access_of(std::string user_name, std::string session) {
  const auto user = co_await security::session_user(sessions_, std::move(user_name), std::move(session));
  if (!user) throw security::session_ended(name());
  co_return user->level;
}

Async<navigation::CommRasterMap> MapServer::on_map(const navigation::CommRasterMapRequest& asked) {
  const navigation::CommRasterMapRequest request = asked;  // the request may be gone when the session has been checked
  const auto map = map_;
  const double level = level_of(*map, request.map_name());
  const Window window = window_of(map->building, map->frame, request);
  const int access = co_await access_of(request.user_name(), request.session());
  const std::vector<Cell> cells = draw(map->building.plan(), map->frame, window, level, access);
  navigation::CommRasterMap answer;
  answer.set_user_name(request.user_name());
  answer.set_map_name(MapName{map->name, level}.text());
  answer.set_map_raster_image(image_of(cells, window));
  answer.set_map_version(map->version);
  navigation::CommGridMap& grid = *answer.mutable_map_grid_data();
  grid.set_columns(static_cast<std::uint32_t>(window.columns));
  grid.set_rows(static_cast<std::uint32_t>(window.rows));
  grid.set_cell_size(map->frame.pixel_m);
  const Point corner =
      map->frame.to_local({static_cast<double>(window.left), static_cast<double>(window.top + window.rows)});
  *grid.mutable_origin() = position_of(map->building.reference(), corner, level);
  grid.set_cells(grid_of(cells, window));
  co_return answer;
}

navigation::CommRasterMapInfo MapServer::on_info(const navigation::CommRasterMapInfoRequest& request) {
  const double level = level_of(*map_, request.map_name());
  const PixelFrame& frame = map_->frame;
  const Wgs84 upper_left = map_->building.to_wgs84(frame.to_local({0.0, 0.0}));
  const Wgs84 lower_right =
      map_->building.to_wgs84(frame.to_local({static_cast<double>(frame.columns), static_cast<double>(frame.rows)}));
  navigation::CommRasterMapInfo info;
  info.set_map_name(MapName{map_->name, level}.text());
  info.set_map_crop_ul_lon(upper_left.longitude_deg);
  info.set_map_crop_ul_lat(upper_left.latitude_deg);
  info.set_map_crop_lr_lon(lower_right.longitude_deg);
  info.set_map_crop_lr_lat(lower_right.latitude_deg);
  info.set_grid_x_size(frame.columns);
  info.set_grid_y_size(frame.rows);
  info.set_raster_x_size(frame.columns);
  info.set_raster_y_size(frame.rows);
  info.set_pixel_size(frame.pixel_m);
  *info.mutable_origin() = position_of(map_->building.reference(), frame.origin, level);
  info.set_map_version(map_->version);
  return info;
}

navigation::CommCoordConv MapServer::on_coordinates(const navigation::CommCoordConvRequest& request) {
  const double level = level_of(*map_, request.map_name());
  const bool to_world = request.coord_type() == CommCoordConvRequest::E_GEOGRAPHIC;
  if (!to_world && request.coord_type() != CommCoordConvRequest::E_SYNTHETIC) {
    throw Error(ErrorCode::Usage,
                {.what = "the direction of the conversion is not told",
                 .expected = "coord_type E_GEOGRAPHIC (pixels to degrees) or E_SYNTHETIC (degrees to pixels)"});
  }
  const PixelFrame& frame = map_->frame;
  const Point asked{request.coord_x(), request.coord_y()};
  const bool on_earth = to_world || (std::abs(asked.x_m) <= 180.0 && std::abs(asked.y_m) <= 90.0);
  const Point place = to_world || !on_earth ? asked : frame.to_pixel(map_->building.to_local({asked.y_m, asked.x_m}));
  const auto pixel = on_earth ? frame.on_map(place) : std::nullopt;
  if (!pixel) {
    const std::string size = "x 0 to " + std::to_string(frame.columns) + ", y 0 to " + std::to_string(frame.rows);
    throw Error(ErrorCode::NotFound, {.what = "the place is not on the map " + request.map_name(),
                                      .where = name(),
                                      .expected = to_world ? "pixels " + size : extent(map_->building, frame)});
  }
  const Wgs84 world = to_world ? map_->building.to_wgs84(frame.to_local(*pixel)) : Wgs84{};
  navigation::CommCoordConv answer;
  answer.set_map_name(MapName{map_->name, level}.text());
  answer.set_coord_conv_x(to_world ? world.longitude_deg : pixel->x_m);
  answer.set_coord_conv_y(to_world ? world.latitude_deg : pixel->y_m);
  return answer;
}

Async<navigation::CommLevelMap> MapServer::on_levels(const navigation::CommLevelMapRequest& asked) {
  const navigation::CommLevelMapRequest request = asked;
  const auto map = map_;
  // Nothing is left out for anyone; but who claims to be somebody has to be.
  co_await access_of(request.user_name(), request.session());
  const std::set<double> wanted(request.level().begin(), request.level().end());
  for (const double level : wanted) level_of(*map, MapName{map->name, level}.text());
  navigation::CommLevelMap answer = level_map_of(map->building, map->name, wanted);
  answer.set_version(map->version);
  co_return answer;
}

}  // namespace fiona::map_server
