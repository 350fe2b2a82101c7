#include "fiona/building/svg.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>

#include <fiona/error.hpp>

#include "svg_plan.hpp"

namespace fiona::building {
namespace {

/// Okabe and Ito, "Color Universal Design" (2008), without the yellow that fades on white.
constexpr std::array<const char*, 8> kColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                 "#7a5195", "#56b4e9", "#8a6d00", "#444444"};
constexpr std::array<const char*, 8> kDashes = {"none", "8 4", "2 3", "12 4 2 4", "5 2 1 2 1 2", "14 5", "4 2", "1 5"};
constexpr double kMargin_px = 28.0;
constexpr double kHeading_px = 30.0;
constexpr double kWidth_px = 1100.0;

bool is_colour(const std::string& text) {
  return text.size() == 7 && text[0] == '#' && text.find_first_not_of("0123456789abcdefABCDEF", 1) == std::string::npos;
}

bool is_dash(const std::string& text) {
  return text == "none" || (!text.empty() && text.find_first_not_of("0123456789. ,") == std::string::npos);
}

/// The tracks with every colour and dash filled in.
std::vector<Track> dressed(std::span<const Track> tracks) {
  std::vector<Track> all(tracks.begin(), tracks.end());
  for (std::size_t i = 0; i < all.size(); ++i) {
    Track& track = all[i];
    if (track.colour.empty()) track.colour = kColours[i % kColours.size()];
    if (track.dash.empty()) track.dash = kDashes[i % kDashes.size()];
    if (is_colour(track.colour) && is_dash(track.dash)) continue;
    throw Error(ErrorCode::Usage, {.what = "the track " + track.name + " cannot be drawn",
                                   .expected = "a colour such as #0072b2 and a dash pattern such as 8 4 or none",
                                   .found = "colour " + track.colour + ", dash pattern " + track.dash,
                                   .next = "leave both empty to have them chosen"});
  }
  return all;
}

void grow(Box& box, Point p) {
  box.low = {std::min(box.low.x_m, p.x_m), std::min(box.low.y_m, p.y_m)};
  box.high = {std::max(box.high.x_m, p.x_m), std::max(box.high.y_m, p.y_m)};
}

constexpr Box kNothing{{1e300, 1e300}, {-1e300, -1e300}};

/// Of the tracks and of the plan's `levels`.
Box extent(const Plan* plan, std::span<const Track> tracks, std::span<const Level> levels) {
  Box box = kNothing;
  if (plan != nullptr) {
    for (const Point& p : plan->outline.outer) grow(box, p);
    for (const Room& room : plan->rooms) {
      const bool shown =
          std::any_of(levels.begin(), levels.end(), [&](const Level& level) { return level.level == room.level; });
      if (!shown) continue;
      for (const Point& p : room.polygon.outer) grow(box, p);
    }
    for (const Connector& connector : plan->connectors) {
      for (const PathPoint& p : connector.path) grow(box, p.at);
    }
    for (const Path& path : plan->paths) {
      for (const PathPoint& p : path.points) grow(box, p.at);
    }
  }
  for (const Track& track : tracks) {
    for (const TrackPoint& p : track.points) {
      if (std::isfinite(p.x_m) && std::isfinite(p.y_m)) grow(box, {p.x_m, p.y_m});
    }
  }
  if (box.low.x_m > box.high.x_m) box = {{0.0, 0.0}, {10.0, 10.0}};
  const double border = std::max(1.0, 0.02 * (box.high.x_m - box.low.x_m));
  return {box.low - Point{border, border}, box.high + Point{border, border}};
}

/// Levels that deserve a drawing: whole ones and those with rooms. Landings (-0.3 between flights) do not.
std::vector<Level> drawn_levels(const Plan& plan) {
  std::vector<Level> drawn = plan.levels;
  std::erase_if(drawn, [&](const Level& level) {
    const bool has_rooms =
        std::any_of(plan.rooms.begin(), plan.rooms.end(), [&](const Room& room) { return room.level == level.level; });
    return !has_rooms && level.level != std::floor(level.level);
  });
  return drawn.empty() ? plan.levels : drawn;
}

double nearest_level(const std::vector<Level>& levels, double level) {
  double best = levels.front().level;
  for (const Level& known : levels) {
    if (std::abs(known.level - level) < std::abs(best - level)) best = known.level;
  }
  return best;
}

/// Whether a track goes there, or there is none.
bool visited(std::span<const Track> tracks, const std::vector<Level>& levels, double level) {
  bool empty = true;
  for (const Track& track : tracks) {
    for (const TrackPoint& p : track.points) {
      empty = false;
      if (nearest_level(levels, p.level) == level) return true;
    }
  }
  return empty;
}

std::string marker(const View& view, const Track& track, const TrackPoint& p, bool start) {
  const double x = view.x(p.x_m), y = view.y(p.y_m);
  const std::string paint = " fill=\"" + std::string(start ? "#ffffff" : track.colour) + "\" stroke=\"" + track.colour +
                            "\" stroke-width=\"2\"><title>" + escape_xml(track.name) + (start ? ": start" : ": end") +
                            "</title>";
  if (start) return "<circle" + attribute("cx", x) + attribute("cy", y) + " r=\"4.5\"" + paint + "</circle>\n";
  return "<rect" + attribute("x", x - 4.5) + attribute("y", y - 4.5) + " width=\"9\" height=\"9\"" + paint +
         "</rect>\n";
}

/// The pieces of a track that lie on one level; `levels` empty: all of it.
std::string draw_track(const View& view, const Track& track, const std::vector<Level>& levels, double level) {
  const auto here = [&](const TrackPoint& p) {
    return std::isfinite(p.x_m) && std::isfinite(p.y_m) && (levels.empty() || nearest_level(levels, p.level) == level);
  };
  std::string svg, points;
  const auto flush = [&] {
    if (!points.empty()) {
      const std::string line = "<polyline class=\"track\" points=\"" + points + "\" stroke=";
      svg += line + "\"#ffffff\" stroke-opacity=\"0.8\" stroke-width=\"4.5\"/>\n" + line + "\"" + track.colour +
             "\" stroke-width=\"2\" stroke-dasharray=\"" + track.dash + "\"/>\n";
    }
    points.clear();
  };
  for (const TrackPoint& p : track.points) {
    if (here(p))
      points += view.at({p.x_m, p.y_m}) + " ";
    else
      flush();
  }
  flush();
  if (!track.points.empty() && here(track.points.front())) svg += marker(view, track, track.points.front(), true);
  if (track.points.size() > 1 && here(track.points.back())) svg += marker(view, track, track.points.back(), false);
  return svg;
}

/// 1, 2 or 5 times a power of ten, at most `most`.
double round_length_m(double most) {
  const double power = std::pow(10.0, std::floor(std::log10(most)));
  for (double step : {5.0, 2.0}) {
    if (step * power <= most) return step * power;
  }
  return power;
}

std::string metres(double length_m) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g m", length_m);
  return text;
}

std::string scale_bar(const View& view, double top_px) {
  const double length_m = round_length_m(view.width_px() / view.scale / 5);
  const double x = view.left_px, width = length_m * view.scale;
  return "<g class=\"scale\"><title>scale bar: " + metres(length_m) + "</title><path d=\"M" + number(x) + "," +
         number(top_px - 5) + "v10m0,-5h" + number(width) + "m0,-5v10\"/><text" + attribute("x", x + width + 8) +
         attribute("y", top_px + 4) + ">" + metres(length_m) + "</text></g>\n";
}

/// The arrow points to true north: by the heading of the reference to the left of the drawing's upward
/// direction.
std::string north_arrow(double x, double y, double heading_rad) {
  return "<g class=\"scale\" transform=\"translate(" + number(x) + "," + number(y) + ") rotate(" +
         number(-heading_rad * 180.0 / 3.14159265358979) +
         ")\"><title>north</title><path d=\"M0,9V-9m-4,6l4,-6l4,6\"/><text x=\"0\" y=\"-13\" "
         "text-anchor=\"middle\">N</text></g>\n";
}

std::string legend(std::span<const Track> tracks, double left_px, double right_px, double& top_px) {
  std::string svg;
  double x = left_px;
  for (const Track& track : tracks) {
    const double width = 52 + 7.0 * static_cast<double>(std::max<std::size_t>(track.name.size(), 1)) + 16;
    if (x > left_px && x + width > right_px) x = left_px, top_px += 22;
    svg += "<path class=\"track\" stroke=\"" + track.colour + "\" stroke-width=\"2.5\" stroke-dasharray=\"" +
           track.dash + "\" d=\"M" + number(x) + "," + number(top_px) + "h44\"/><text" + attribute("x", x + 52) +
           attribute("y", top_px + 4) + ">" + escape_xml(track.name) + "</text>\n";
    x += width;
  }
  if (!tracks.empty()) {
    top_px += 22;
    svg += "<text class=\"note\"" + attribute("x", left_px) + attribute("y", top_px + 4) +
           ">circle: start, square: end</text>\n";
  }
  return svg;
}

std::string opening(double width, double height, const std::string& title, const std::string& description) {
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" aria-labelledby=\"title desc\" width=\"" +
         number(width) + "\" height=\"" + number(height) + "\" viewBox=\"0 0 " + number(width) + " " + number(height) +
         "\">\n<title id=\"title\">" + escape_xml(title) + "</title>\n<desc id=\"desc\">" + escape_xml(description) +
         "</desc>\n"
         "<style>text{font-family:system-ui,'DejaVu Sans',sans-serif;font-size:12px;fill:#1f2933}"
         ".head{font-size:15px;font-weight:600}.label{text-anchor:middle;fill:#44505c;stroke:#ffffff;stroke-"
         "width:3;stroke-opacity:0.75;stroke-linejoin:round;paint-order:stroke}.note{fill:#5a6672}"
         ".wall{stroke:#3b4754;stroke-width:1.6;stroke-linecap:round}.outer{stroke:#1f2933;stroke-width:3.2;"
         "stroke-linecap:round}.door{stroke:#b3bcc6;stroke-width:1.2}.path,.stairs,.track,.lift,.scale "
         "path{fill:none}"
         ".path{stroke:#c3ccd5;stroke-width:1}.stairs{stroke:#7b8794;stroke-width:1.4}.lift{stroke:#5a6672}"
         ".scale path{stroke:#1f2933;stroke-width:1.4}.track{stroke-linejoin:round;stroke-linecap:butt}"
         ".grid{stroke:#e3e8ed}.axis{fill:#5a6672;font-size:10px}</style>\n"
         "<defs><pattern id=\"steps\" width=\"6\" height=\"6\" patternUnits=\"userSpaceOnUse\"><rect "
         "width=\"6\" "
         "height=\"6\" fill=\"#f3f5f7\"/><path d=\"M0,3h6\" stroke=\"#c3ccd5\"/></pattern></defs>\n"
         "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n";
}

std::string panel(const View& view, const Plan& plan, const std::vector<Level>& levels, const Level& level,
                  std::span<const Track> tracks) {
  std::string svg = "<g role=\"group\" aria-label=\"" + escape_xml(level.name) + "\">\n<text class=\"head\"" +
                    attribute("x", view.left_px) + attribute("y", view.top_px - 8) + ">" + escape_xml(level.name) +
                    "</text>\n" + draw_plan(view, plan, level.level);
  for (const Track& track : tracks) svg += draw_track(view, track, levels, level.level);
  return svg + draw_names(view, plan, level.level) + "</g>\n";
}

std::string grid(const View& view) {
  const double step_m = round_length_m((view.box.high.x_m - view.box.low.x_m) / 6);
  std::string svg;
  char text[32];
  for (double x = std::ceil(view.box.low.x_m / step_m) * step_m; x <= view.box.high.x_m; x += step_m) {
    std::snprintf(text, sizeof(text), "%g", x);
    svg += draw_line(view, "grid", {{x, view.box.low.y_m}, {x, view.box.high.y_m}}) + "<text class=\"axis\"" +
           attribute("x", view.x(x) + 3) + attribute("y", view.top_px + view.height_px() - 4) + ">" + text +
           "</text>\n";
  }
  for (double y = std::ceil(view.box.low.y_m / step_m) * step_m; y <= view.box.high.y_m; y += step_m) {
    std::snprintf(text, sizeof(text), "%g", y);
    svg += draw_line(view, "grid", {{view.box.low.x_m, y}, {view.box.high.x_m, y}}) + "<text class=\"axis\"" +
           attribute("x", view.left_px + 3) + attribute("y", view.y(y) - 3) + ">" + text + "</text>\n";
  }
  return svg;
}

std::string names_of(std::span<const Track> tracks) {
  std::string names;
  for (const Track& track : tracks) names += (names.empty() ? "" : ", ") + track.name;
  return names.empty() ? "No tracks." : "Tracks: " + names + ".";
}

View fitted(const Box& box, const SvgOptions& options) {
  View view{box, options.pixels_per_m, kMargin_px, 0.0};
  if (view.scale <= 0.0) view.scale = (kWidth_px - 2 * kMargin_px) / std::max(1e-3, box.high.x_m - box.low.x_m);
  return view;
}

void write(const std::filesystem::path& file, const std::string& svg) {
  std::ofstream stream(file, std::ios::binary);
  stream << svg;
  stream.close();
  if (!stream) {
    throw Error(ErrorCode::Failed, {.what = "cannot write the drawing " + file.string(),
                                    .where = file.string(),
                                    .next = "check that the directory exists, may be written, and has space"});
  }
}

}  // namespace

std::string escape_xml(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '&')
      escaped += "&amp;";
    else if (c == '<')
      escaped += "&lt;";
    else if (c == '>')
      escaped += "&gt;";
    else if (c == '"')
      escaped += "&quot;";
    else if (byte < 0x20 && c != '\t' && c != '\n')
      escaped += "\xef\xbf\xbd";
    else
      escaped += c;
  }
  return escaped;
}

std::string floor_plan_svg(const Building& building, std::span<const Track> tracks, const SvgOptions& options) {
  return floor_plan_svg(building.plan(), tracks, options);
}

std::string floor_plan_svg(const Plan& plan, std::span<const Track> tracks, const SvgOptions& options) {
  const std::vector<Track> lines = dressed(tracks);
  const std::vector<Level> levels = drawn_levels(plan);
  std::vector<Level> shown = levels;
  if (options.visited_only) {
    std::erase_if(shown, [&](const Level& level) { return !visited(lines, levels, level.level); });
  }
  View view = fitted(extent(&plan, lines, shown), options);
  const double width = view.width_px() + 2 * kMargin_px;
  const std::string title = options.title.empty() ? plan.name : options.title;
  std::string body = "<text class=\"head\" style=\"font-size:19px\"" + attribute("x", kMargin_px) + attribute("y", 34) +
                     ">" + escape_xml(title) + "</text>\n" +
                     north_arrow(width - kMargin_px - 10, 36, plan.reference.heading_rad);
  view.top_px = 50 + kHeading_px;
  // The upper floor stands above the lower one, as in the house.
  for (auto level = shown.rbegin(); level != shown.rend(); ++level) {
    body += panel(view, plan, levels, *level, lines);
    view.top_px += view.height_px() + kHeading_px + 8;
  }
  double top = view.top_px - kHeading_px + 14;
  body += scale_bar(view, top);
  top += 28;
  body += legend(lines, kMargin_px, width - kMargin_px, top);
  const std::string description = "Floor plans of " + plan.name + ", " + std::to_string(shown.size()) +
                                  (shown.size() == 1 ? " level. " : " levels. ") + names_of(lines);
  return opening(width, top + 24, title, description) + body + "</svg>\n";
}

std::string track_svg(std::span<const Track> tracks, const SvgOptions& options) {
  const std::vector<Track> lines = dressed(tracks);
  View view = fitted(extent(nullptr, lines, {}), options);
  const double width = view.width_px() + 2 * kMargin_px;
  const std::string title = options.title.empty() ? "Tracks" : options.title;
  view.top_px = 50;
  std::string body = "<text class=\"head\" style=\"font-size:19px\"" + attribute("x", kMargin_px) + attribute("y", 34) +
                     ">" + escape_xml(title) + "</text>\n" + grid(view);
  for (const Track& track : lines) body += draw_track(view, track, {}, 0.0);
  double top = view.top_px + view.height_px() + 18;
  body += scale_bar(view, top);
  top += 28;
  body += legend(lines, kMargin_px, width - kMargin_px, top);
  return opening(width, top + 24, title, "Plan view, grid in metres. " + names_of(lines)) + body + "</svg>\n";
}

void write_floor_plan_svg(const std::filesystem::path& file, const Building& building, std::span<const Track> tracks,
                          const SvgOptions& options) {
  write(file, floor_plan_svg(building, tracks, options));
}

void write_track_svg(const std::filesystem::path& file, std::span<const Track> tracks, const SvgOptions& options) {
  write(file, track_svg(tracks, options));
}

}  // namespace fiona::building
