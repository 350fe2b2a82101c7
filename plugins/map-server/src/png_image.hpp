#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace fiona::map_server {

struct Colour {
  std::uint8_t red = 0;
  std::uint8_t green = 0;
  std::uint8_t blue = 0;
};

/// A PNG image of `columns` x `rows` pixels, each an index into `palette` (at most 256), rows from the top. Throws
/// Error Failed with libpng's reason. Source: ISO/IEC 15948.
std::string png_image(int columns, int rows, std::span<const std::uint8_t> pixels, std::span<const Colour> palette);

}  // namespace fiona::map_server
