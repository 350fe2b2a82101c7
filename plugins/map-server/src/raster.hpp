#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fiona/building/building.hpp"

namespace fiona::map_server {

/// Where the pixels of a building's maps lie in its local frame: the same for all levels, so that one place has one
/// pixel on each. (0, 0) is the outer corner of the top-left pixel, x to the right, y down.
struct PixelFrame {
  building::Point origin{};  ///< outer corner of the top-left pixel
  double pixel_m = 0.1;
  int columns = 0;
  int rows = 0;

  building::Point to_local(building::Point pixel) const {
    return {origin.x_m + pixel.x_m * pixel_m, origin.y_m - pixel.y_m * pixel_m};
  }
  /// In pixels, with their fraction; members are named x_m, y_m all the same.
  building::Point to_pixel(building::Point local) const {
    return {(local.x_m - origin.x_m) / pixel_m, (origin.y_m - local.y_m) / pixel_m};
  }
  /// The pixel itself, or the nearest on the border that it is not more than a centimetre beyond; else nothing.
  std::optional<building::Point> on_map(building::Point pixel) const;
};

/// A part of a map, in whole pixels.
struct Window {
  int left = 0;
  int top = 0;
  int columns = 0;
  int rows = 0;
};

enum class Cell : std::uint8_t {
  Outside,  ///< nothing is known of it
  Free,
  Path,  ///< a way that is drawn as a line, with 0.75 m to each side
  Stairs,
  Lift,
  Door,
  Closed,  ///< the user may not be there
  Wall,
};
inline constexpr std::size_t kCells = 8;

inline constexpr std::int64_t kMostPixels = 4096 * 4096;

/// Around all rooms, walls, stairs and the outline, with a margin of 1 m. Throws Error Usage, with the pixel size that
/// would do, for more than `kMostPixels`.
PixelFrame frame_of(const building::Plan& plan, double pixel_m);

/// The cells of a window of one level, rows from the top, as a user of this access sees them. A cell is a wall if a
/// wall passes within 0.1 m of its centre, or through it; else it is what lies at its centre. Cost: the cells, and for
/// each room its edges times its rows.
std::vector<Cell> draw(const building::Plan& plan, const PixelFrame& frame, const Window& window, double level,
                       int access);

/// PNG of the cells, in colours.
std::string image_of(const std::vector<Cell>& cells, const Window& window);

/// The cells as CommGridMap has them: rows from south to north, 0 free, 100 occupied, 255 not known.
std::string grid_of(const std::vector<Cell>& cells, const Window& window);

}  // namespace fiona::map_server
