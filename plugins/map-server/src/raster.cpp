#include "raster.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "fiona/error.hpp"
#include "png_image.hpp"

namespace fiona::map_server {
namespace {

using building::Point;
using building::Segment;

constexpr double kMargin_m = 1.0;
/// A corner of the map that was told is on the map, though it was rounded: to seven decimals of a degree in refusals.
constexpr double kBorder_m = 0.01;
constexpr double kHalfWall_m = 0.1;
constexpr double kHalfPath_m = 0.75;
constexpr double kHalfGap_m = 0.3;
constexpr double kHalfLift_m = 0.6;
/// Walls are drawn twice, up to half a metre apart: a door is open through both.
constexpr double kHalfDoorDepth_m = 0.3;

class Extent {
 public:
  void add(Point p) {
    low_ = {std::min(low_.x_m, p.x_m), std::min(low_.y_m, p.y_m)};
    high_ = {std::max(high_.x_m, p.x_m), std::max(high_.y_m, p.y_m)};
  }
  void add(const building::Ring& ring) {
    for (Point p : ring) add(p);
  }
  bool empty() const { return high_.x_m < low_.x_m; }
  Point low() const { return low_; }
  Point high() const { return high_; }

 private:
  static constexpr double kFar = std::numeric_limits<double>::max();
  Point low_{kFar, kFar};
  Point high_{-kFar, -kFar};
};

Extent extent_of(const building::Plan& plan) {
  Extent extent;
  extent.add(plan.outline.outer);
  for (const auto& room : plan.rooms) extent.add(room.polygon.outer);
  for (const auto& wall : plan.walls) extent.add({wall.segment.from, wall.segment.to});
  for (const auto& connector : plan.connectors) {
    for (const auto& p : connector.path) extent.add(p.at);
  }
  for (const auto& path : plan.paths) {
    if (path.around) continue;  // the streets of the town around the building are not its map
    for (const auto& p : path.points) extent.add(p.at);
  }
  return extent;
}

class Painter {
 public:
  Painter(const PixelFrame& frame, const Window& window, std::vector<Cell>& cells)
      : frame_(frame), window_(window), cells_(cells) {}

  /// Even-odd over all rings, row by row through the cells' centres: a border that crosses itself is no error.
  void fill(const building::Polygon& polygon, Cell cell) {
    const std::vector<Segment> sides = building::edges(polygon);
    const Rows rows = rows_of(building::bounds(polygon.outer), 0.0);
    std::vector<double> cuts;
    for (int row = rows.first; row < rows.last; ++row) {
      const double y_m = centre_y(row);
      cuts.clear();
      for (const auto& [a, b] : sides) {
        if ((a.y_m > y_m) == (b.y_m > y_m)) continue;
        cuts.push_back(a.x_m + (b.x_m - a.x_m) * (y_m - a.y_m) / (b.y_m - a.y_m));
      }
      std::sort(cuts.begin(), cuts.end());
      for (std::size_t i = 1; i < cuts.size(); i += 2) paint(row, cuts[i - 1], cuts[i], cell);
    }
  }

  /// All cells whose centre is within `reach_m` of the line.
  void line(const Segment& line, double reach_m, Cell cell, bool only_walls = false) {
    const Rows rows = rows_of(box_of(line), reach_m);
    for (int row = rows.first; row < rows.last; ++row) {
      const auto [from, to] = near_row(line, centre_y(row), reach_m);
      const int last = column(to);
      for (int x = column(from); x < last; ++x) {
        if (building::distance_m({centre_x(x), centre_y(row)}, line) > reach_m) continue;
        if (!only_walls || at(x, row) == Cell::Wall) at(x, row) = cell;
      }
    }
  }

  void open_wall(const Segment& way, double reach_m) { line(way, reach_m, Cell::Path, true); }

  double wall_reach_m() const { return std::max(kHalfWall_m, frame_.pixel_m * std::sqrt(0.5)); }

 private:
  struct Rows {
    int first = 0;
    int last = 0;
  };

  static building::Box box_of(const Segment& line) {
    return {{std::min(line.from.x_m, line.to.x_m), std::min(line.from.y_m, line.to.y_m)},
            {std::max(line.from.x_m, line.to.x_m), std::max(line.from.y_m, line.to.y_m)}};
  }

  /// The part of a row near a line: that of the band around it, so that a long oblique wall costs its length only.
  static std::pair<double, double> near_row(const Segment& line, double y_m, double reach_m) {
    const building::Box box = box_of(line);
    const double rise_m = line.to.y_m - line.from.y_m;
    if (std::abs(rise_m) < 1e-9) return {box.low.x_m - reach_m, box.high.x_m + reach_m};
    const double slope = (line.to.x_m - line.from.x_m) / rise_m;
    const double x_m = line.from.x_m + slope * (y_m - line.from.y_m);
    const double wide_m = reach_m * std::sqrt(1.0 + slope * slope);
    return {std::max(box.low.x_m - reach_m, x_m - wide_m), std::min(box.high.x_m + reach_m, x_m + wide_m)};
  }

  double centre_x(int column) const { return frame_.origin.x_m + (window_.left + column + 0.5) * frame_.pixel_m; }
  double centre_y(int row) const { return frame_.origin.y_m - (window_.top + row + 0.5) * frame_.pixel_m; }

  /// The first column whose centre is at x_m or right of it, within the window.
  int column(double x_m) const {
    const double found = std::ceil((x_m - frame_.origin.x_m) / frame_.pixel_m - 0.5) - window_.left;
    return static_cast<int>(std::clamp(found, 0.0, static_cast<double>(window_.columns)));
  }

  Rows rows_of(const building::Box& box, double reach_m) const {
    const auto row = [&](double y_m) {
      const double found = std::ceil((frame_.origin.y_m - y_m) / frame_.pixel_m - 0.5) - window_.top;
      return static_cast<int>(std::clamp(found, 0.0, static_cast<double>(window_.rows)));
    };
    return {row(box.high.y_m + reach_m), std::min(window_.rows, row(box.low.y_m - reach_m) + 1)};
  }

  Cell& at(int column, int row) {
    return cells_[static_cast<std::size_t>(row) * static_cast<std::size_t>(window_.columns) +
                  static_cast<std::size_t>(column)];
  }

  void paint(int row, double from_m, double to_m, Cell cell) {
    const int last = column(to_m);
    for (int x = column(from_m); x < last; ++x) at(x, row) = cell;
  }

  const PixelFrame& frame_;
  const Window& window_;
  std::vector<Cell>& cells_;
};

Cell cell_of(building::RoomKind kind) {
  if (kind == building::RoomKind::Stairs) return Cell::Stairs;
  return kind == building::RoomKind::Lift ? Cell::Lift : Cell::Free;
}

/// A smaller room lies in a larger one: an area in a hall, a shaft in a corridor.
void draw_rooms(Painter& painter, const building::Plan& plan, double level, int access) {
  std::vector<std::pair<double, const building::Room*>> rooms;
  for (const auto& room : plan.rooms) {
    if (room.level == level) rooms.emplace_back(building::area_m2(room.polygon), &room);
  }
  std::stable_sort(rooms.begin(), rooms.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  for (const auto& [area, room] : rooms) {
    painter.fill(room->polygon, room->access > access ? Cell::Closed : cell_of(room->kind));
  }
}

bool reaches(const building::Connector& connector, double level) {
  return std::find(connector.levels.begin(), connector.levels.end(), level) != connector.levels.end();
}

void draw_ways(Painter& painter, const building::Plan& plan, double level, int access) {
  const auto open = [&](int needed, Cell cell) { return needed > access ? Cell::Closed : cell; };
  for (const auto& path : plan.paths) {
    if (path.points.front().level != level) continue;
    const Cell cell = open(path.access, path.steps ? Cell::Stairs : Cell::Path);
    for (std::size_t i = 1; i < path.points.size(); ++i) {
      painter.line({path.points[i - 1].at, path.points[i].at}, kHalfPath_m, cell);
    }
  }
  for (const auto& connector : plan.connectors) {
    if (!reaches(connector, level)) continue;
    if (connector.kind == building::ConnectorKind::Lift) {
      const Point at = connector.path.front().at;
      painter.line({at, at}, kHalfLift_m, open(connector.access, Cell::Lift));
      continue;
    }
    const bool ramp = connector.kind == building::ConnectorKind::Ramp;
    for (std::size_t i = 1; i < connector.path.size(); ++i) {
      painter.line({connector.path[i - 1].at, connector.path[i].at}, kHalfPath_m,
                   open(connector.access, ramp ? Cell::Path : Cell::Stairs));
    }
  }
}

}  // namespace

std::optional<Point> PixelFrame::on_map(Point pixel) const {
  const double border = kBorder_m / pixel_m;
  const Point nearest{std::clamp(pixel.x_m, 0.0, static_cast<double>(columns)),
                      std::clamp(pixel.y_m, 0.0, static_cast<double>(rows))};
  const bool near = std::abs(pixel.x_m - nearest.x_m) <= border && std::abs(pixel.y_m - nearest.y_m) <= border;
  return near ? std::optional(nearest) : std::nullopt;
}

PixelFrame frame_of(const building::Plan& plan, double pixel_m) {
  const Extent extent = extent_of(plan);
  if (extent.empty()) return {{}, pixel_m, 1, 1};
  const double left = std::floor((extent.low().x_m - kMargin_m) / pixel_m);
  const double right = std::ceil((extent.high().x_m + kMargin_m) / pixel_m);
  const double bottom = std::floor((extent.low().y_m - kMargin_m) / pixel_m);
  const double top = std::ceil((extent.high().y_m + kMargin_m) / pixel_m);
  const double pixels = (right - left) * (top - bottom);
  if (pixels > static_cast<double>(kMostPixels)) {
    const double enough_m = std::ceil(100.0 * pixel_m * std::sqrt(pixels / static_cast<double>(kMostPixels))) / 100.0;
    throw Error(ErrorCode::Usage,
                {.what = "the maps of " + plan.name + " would have too many pixels",
                 .where = plan.name,
                 .expected = std::to_string(kMostPixels) + " pixels or fewer",
                 .found = std::to_string(static_cast<std::int64_t>(right - left)) + " x " +
                          std::to_string(static_cast<std::int64_t>(top - bottom)),
                 .next = "load map-server, or set it, with pixel_size=" + building::level_text(enough_m) + " or more"});
  }
  return {{left * pixel_m, top * pixel_m}, pixel_m, static_cast<int>(right - left), static_cast<int>(top - bottom)};
}

std::vector<Cell> draw(const building::Plan& plan, const PixelFrame& frame, const Window& window, double level,
                       int access) {
  std::vector<Cell> cells(static_cast<std::size_t>(window.columns) * static_cast<std::size_t>(window.rows),
                          Cell::Outside);
  Painter painter(frame, window, cells);
  draw_rooms(painter, plan, level, access);
  draw_ways(painter, plan, level, access);
  for (const auto& wall : plan.walls) {
    if (wall.level == level) painter.line(wall.segment, painter.wall_reach_m(), Cell::Wall);
  }
  // A way that is drawn through a wall is walked along all the same: mappers leave out the door.
  for (const auto& path : plan.paths) {
    if (path.points.front().level != level || path.access > access) continue;
    for (std::size_t i = 1; i < path.points.size(); ++i) {
      painter.open_wall({path.points[i - 1].at, path.points[i].at}, kHalfGap_m);
    }
  }
  for (const auto& door : plan.doors) {
    if (door.level != level) continue;
    const Point along = building::left_of(door.normal) * std::max(0.0, door.width_m / 2 - kHalfDoorDepth_m);
    painter.line({door.at - along, door.at + along}, kHalfDoorDepth_m,
                 door.access > access ? Cell::Closed : Cell::Door);
  }
  return cells;
}

std::string image_of(const std::vector<Cell>& cells, const Window& window) {
  // By Okabe and Ito's palette where a colour tells something: safe for colour-blind readers.
  static constexpr std::array<Colour, kCells> kColours = {{{225, 225, 225},
                                                           {255, 255, 255},
                                                           {245, 240, 220},
                                                           {86, 180, 233},
                                                           {0, 158, 115},
                                                           {240, 228, 66},
                                                           {150, 150, 150},
                                                           {0, 0, 0}}};
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(cells.data());
  return png_image(window.columns, window.rows, {bytes, cells.size()}, kColours);
}

std::string grid_of(const std::vector<Cell>& cells, const Window& window) {
  static constexpr std::array<unsigned char, kCells> kOccupied = {255, 0, 0, 0, 0, 0, 100, 100};
  std::string grid(cells.size(), '\0');
  const auto columns = static_cast<std::size_t>(window.columns);
  const auto rows = static_cast<std::size_t>(window.rows);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      const Cell cell = cells[(rows - 1 - row) * columns + column];
      grid[row * columns + column] = static_cast<char>(kOccupied[static_cast<std::size_t>(cell)]);
    }
  }
  return grid;
}

}  // namespace fiona::map_server
