#include <fiona/plugin.hpp>

#include "centroid_localisation.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<acme::centroid_localisation::CentroidLocalisation>(
      "centroid-localisation",
      "a location from beacons alone: the weighted mean of the places of those that are heard");
}
