#include "fiona/plugin.hpp"

#include "web_interface.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::smart_web_interface::WebInterface>(
      "smart-web-interface", "a page for phone and desk: floor plan, position, way, directions, destinations, profile");
}
