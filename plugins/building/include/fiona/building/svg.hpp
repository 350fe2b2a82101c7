#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "fiona/building/building.hpp"

namespace fiona::building {

struct TrackPoint {
  std::int64_t t_ms = 0;
  double x_m = 0.0;
  double y_m = 0.0;
  double level = 0.0;  ///< a fraction is drawn on the nearest level of the building
};

/// A line over the plan. Colour and dash pattern tell tracks apart together, so that neither is needed alone.
struct Track {
  std::string name{};
  std::vector<TrackPoint> points{};  ///< ascending in time
  std::string colour{};              ///< "#rrggbb"; empty: the next of eight colours safe for colour-blind readers
  std::string dash{};                ///< SVG stroke-dasharray, "none" for solid; empty: the next of eight patterns
};

struct SvgOptions {
  std::string title{};        ///< empty: the name of the building
  double pixels_per_m = 0.0;  ///< 0: so that the drawing is about 1100 px wide
  bool visited_only = false;  ///< leave out levels where no track goes; without any track, all are drawn
};

/// Floor plans, one panel for each level, with the tracks over them, a legend, a scale bar and a north arrow.
/// Every name is escaped; title, desc and the names of the rooms are there for screen readers. Colours or
/// dash patterns that are not of the form above throw fiona::Error (Usage): text from outside must not become
/// markup.
std::string floor_plan_svg(const Plan& plan, std::span<const Track> tracks, const SvgOptions& options = {});
std::string floor_plan_svg(const Building& building, std::span<const Track> tracks, const SvgOptions& options = {});

/// Tracks without a building, over a grid in metres.
std::string track_svg(std::span<const Track> tracks, const SvgOptions& options = {});

/// The same into a file. Throws fiona::Error if the file cannot be written.
void write_floor_plan_svg(const std::filesystem::path& file, const Building& building, std::span<const Track> tracks,
                          const SvgOptions& options = {});
void write_track_svg(const std::filesystem::path& file, std::span<const Track> tracks, const SvgOptions& options = {});

/// Text as it may stand in an XML attribute or element; control characters that XML forbids become U+FFFD.
std::string escape_xml(const std::string& text);

}  // namespace fiona::building
