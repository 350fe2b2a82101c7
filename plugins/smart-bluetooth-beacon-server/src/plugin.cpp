#include "fiona/plugin.hpp"

#include "smart_bluetooth_beacon_server.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::smart_bluetooth_beacon_server::SmartBluetoothBeaconServer>(
      "smart-bluetooth-beacon-server", "iBeacons, Eddystones and other Bluetooth devices that a radio hears");
}
