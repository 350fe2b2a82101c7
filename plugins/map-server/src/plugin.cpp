#include "fiona/plugin.hpp"

#include "map_server.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::map_server::MapServer>(
      "map-server", "raster maps, coordinates, rooms and the walking graph of a building, from its OSM file");
}
