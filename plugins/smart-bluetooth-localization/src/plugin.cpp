#include "fiona/plugin.hpp"

#include "smart_bluetooth_localization.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::smart_bluetooth_localization::SmartBluetoothLocalization>(
      "smart-bluetooth-localization", "positions from iBeacons and steps within walls");
}
