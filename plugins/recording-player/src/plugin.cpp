#include "fiona/plugin.hpp"

#include "recording_player.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::recording_player::RecordingPlayer>("recording-player", "plays a recording of any ports");
}
