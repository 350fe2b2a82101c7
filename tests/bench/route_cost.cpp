#include "route_cost.hpp"

#include <cstdlib>
#include <random>
#include <stdexcept>
#include <string>

#include "bare_limits.hpp"
#include "fiona/building/building.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

using building::Building;
using building::PathPoint;
using building::RouteOptions;

Building read_station(const std::filesystem::path& packed) {
  if (packed.extension() != ".xz") return Building::read(packed);
  const conformance::TemporaryDirectory directory;
  const std::filesystem::path plain = directory.path / "station.osm";
  const std::string command = "xz -dc '" + packed.string() + "' > '" + plain.string() + "'";
  if (std::system(command.c_str()) != 0) throw std::runtime_error("cannot unpack " + packed.string());
  return Building::read(plain);
}

}  // namespace

std::optional<std::filesystem::path> station_maps() {
  const char* data = std::getenv("FIONA_DATA");
  const std::filesystem::path folder = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "osm_indoor";
  return std::filesystem::exists(folder) ? std::optional(folder) : std::nullopt;
}

double route_ms(const std::filesystem::path& packed) {
  const Building station = read_station(packed);
  std::vector<PathPoint> places;
  for (const auto& connector : station.connectors()) {
    places.insert(places.end(), {connector.path.front(), connector.path.back()});
  }
  const RouteOptions profiles[] = {{}, {.stairs = false}, {.lift = false}, {.outdoors = false}};
  std::mt19937 random(1);
  std::vector<std::int64_t> times;
  for (std::size_t i = 0; i < 2000; ++i) {
    const PathPoint& from = places[random() % places.size()];
    const PathPoint& to = places[random() % places.size()];
    const std::int64_t begun_ns = steady_ns();
    const auto route = station.route(from, to, profiles[i % 4]);
    times.push_back(steady_ns() - begun_ns);
    if (route && route->points.empty()) throw std::runtime_error("a route without points");
  }
  return summarise(std::move(times)).p99_ns / 1e6;
}

}  // namespace fiona::bench
