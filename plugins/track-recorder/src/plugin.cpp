#include "fiona/plugin.hpp"

#include "track_recorder.hpp"

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::recorder::TrackRecorder>("track-recorder",
                                             "writes a track as CSV and SVG, and its errors against a truth");
}
