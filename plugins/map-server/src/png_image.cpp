#include "png_image.hpp"

#include <png.h>

#include <memory>
#include <vector>

#include "fiona/error.hpp"

namespace fiona::map_server {
namespace {

/// Large areas of one colour: more effort makes the image hardly smaller.
constexpr int kCompression = 3;

[[noreturn]] void fail(png_structp, png_const_charp reason) {
  throw Error(ErrorCode::Failed, {.what = std::string("cannot make the image of the map: ") + reason,
                                  .next = "a larger pixel_size makes a smaller image"});
}

void append(png_structp png, png_bytep bytes, std::size_t size) {
  static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<const char*>(bytes), size);
}

struct Writer {
  Writer() : png(png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, fail, nullptr)) {
    if (png != nullptr) info = png_create_info_struct(png);
    if (info == nullptr) fail(png, "out of memory");
  }
  ~Writer() { png_destroy_write_struct(&png, &info); }
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  png_structp png;
  png_infop info = nullptr;
};

}  // namespace

std::string png_image(int columns, int rows, std::span<const std::uint8_t> pixels, std::span<const Colour> palette) {
  Writer writer;
  std::string image;
  png_set_write_fn(writer.png, &image, append, nullptr);
  png_set_compression_level(writer.png, kCompression);
  png_set_IHDR(writer.png, writer.info, static_cast<png_uint_32>(columns), static_cast<png_uint_32>(rows), 8,
               PNG_COLOR_TYPE_PALETTE, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  std::vector<png_color> colours;
  for (const Colour& colour : palette) colours.push_back({colour.red, colour.green, colour.blue});
  png_set_PLTE(writer.png, writer.info, colours.data(), static_cast<int>(colours.size()));
  png_write_info(writer.png, writer.info);
  for (int row = 0; row < rows; ++row) {
    png_write_row(writer.png, pixels.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(columns));
  }
  png_write_end(writer.png, nullptr);
  return image;
}

}  // namespace fiona::map_server
