#include "to_json.hpp"

#include <cmath>
#include <nlohmann/json.hpp>

namespace fiona::smart_web_interface {
namespace {

using nlohmann::json;

/// Chi-square with 2 degrees of freedom: a point lies within it with a probability of 95 %.
constexpr double k95Percent = 5.991464547107979;

double centimetres(double value_m) { return std::round(value_m * 100) / 100; }

json ellipse_of(const localisation::CommPosition& position) {
  if (position.confidence_size() != 9) return nullptr;
  const double xx = position.confidence(0);
  const double xy = (position.confidence(1) + position.confidence(3)) / 2;
  const double yy = position.confidence(4);
  const double mean = (xx + yy) / 2;
  const double spread = std::hypot((xx - yy) / 2, xy);
  // Not positive semi-definite, or not finite: no covariance.
  if (!(mean - spread >= -1e-9 * mean) || !std::isfinite(mean + spread)) return nullptr;
  return {{"major", std::sqrt((mean + spread) * k95Percent)},
          {"minor", std::sqrt(std::max(0.0, mean - spread) * k95Percent)},
          {"angle", std::atan2(2 * xy, xx - yy) / 2}};
}

json ring_of(const navigation::MapRing& ring) {
  json points = json::array();
  for (int i = 0; i < std::min(ring.x_size(), ring.y_size()); ++i) {
    points.push_back({centimetres(ring.x(i)), centimetres(ring.y(i))});
  }
  return points;
}

json room_of(const navigation::MapRoom& room) {
  json holes = json::array();
  for (const navigation::MapRing& hole : room.holes()) holes.push_back(ring_of(hole));
  return {{"id", room.id()},
          {"kind", navigation::MapRoom::Kind_Name(room.kind())},
          {"level", room.level()},
          {"name", room.name()},
          {"ref", room.ref()},
          {"use", room.use()},
          {"access", room.access()},
          {"x", centimetres(room.x())},
          {"y", centimetres(room.y())},
          {"outline", ring_of(room.outline())},
          {"holes", holes}};
}

}  // namespace

std::string text_of(const json& value) { return value.dump(-1, ' ', false, json::error_handler_t::replace); }

std::string location_json(const localisation::CommLocation& location, TimePoint measured) {
  const localisation::CommPosition& position = location.position();
  const bool finite = std::isfinite(position.x()) && std::isfinite(position.y()) && std::isfinite(position.z());
  json value{{"x", finite ? position.x() : 0.0},
             {"y", finite ? position.y() : 0.0},
             {"measured", to_milliseconds(measured)},
             {"valid", finite && location.is_valid() && position.is_valid()}};
  if (position.has_z() && finite) value["level"] = position.z();
  if (json ellipse = ellipse_of(position); !ellipse.is_null()) value["ellipse"] = std::move(ellipse);
  return text_of(value);
}

std::string path_json(const navigation::CommPath& path) {
  json points = json::array();
  for (const localisation::CommPosition& point : path.waypoints()) {
    json one{centimetres(point.x()), centimetres(point.y())};
    if (point.has_z()) one.push_back(point.z());
    points.push_back(std::move(one));
  }
  json legs = json::array();
  for (const int leg : path.legs()) {
    legs.push_back(navigation::MapEdge::Kind_Name(static_cast<navigation::MapEdge::Kind>(leg)));
  }
  return text_of({{"valid", path.is_valid()}, {"points", points}, {"legs", legs}});
}

std::string instruction_json(const hmi::Instruction& instruction) {
  json value{{"number", instruction.number()},
             {"kind", hmi::Instruction::Kind_Name(instruction.kind())},
             {"text", instruction.text()},
             {"language", instruction.language()},
             {"uncertain", instruction.uncertain()}};
  if (instruction.has_distance()) value["distance"] = instruction.distance();
  if (instruction.hour() != 0) value["hour"] = static_cast<int>(instruction.hour());
  return text_of(value);
}

std::string map_json(const navigation::CommLevelMap& map) {
  json levels = json::array();
  for (const navigation::MapLevel& level : map.levels())
    levels.push_back({{"level", level.level()}, {"name", level.name()}});
  json rooms = json::array();
  for (const navigation::MapRoom& room : map.rooms()) rooms.push_back(room_of(room));
  json walls = json::array();
  for (const navigation::MapWall& wall : map.walls()) {
    walls.push_back({centimetres(wall.x1()), centimetres(wall.y1()), centimetres(wall.x2()), centimetres(wall.y2()),
                     wall.level(), wall.exterior() ? 1 : 0});
  }
  json entrances = json::array();
  for (const navigation::MapDoor& door : map.doors()) {
    if (!door.entrance()) continue;
    entrances.push_back({{"x", centimetres(door.x())}, {"y", centimetres(door.y())}, {"level", door.level()}});
  }
  return text_of({{"title", map.title().empty() ? map.name() : map.title()},
                  {"levels", levels},
                  {"rooms", rooms},
                  {"walls", walls},
                  {"entrances", entrances}});
}

}  // namespace fiona::smart_web_interface
