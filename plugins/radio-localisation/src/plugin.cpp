#include "fiona/plugin.hpp"

#include "radio_localisation.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::radio_localisation::RadioLocalisation>("radio-localisation",
                                                           "positions from Wi-Fi, iBeacons and steps");
}
