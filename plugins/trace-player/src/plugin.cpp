#include "fiona/plugin.hpp"

#include "trace_player.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::trace_player::TracePlayer>("trace-player", "plays a recorded walk: IMU, Wi-Fi, iBeacons");
}
