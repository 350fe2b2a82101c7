#pragma once

#include <cstdint>
#include <exception>
#include <functional>
#include <string>
#include <string_view>

struct archive;

namespace fiona::marketplace {

/// The one tar form that a package has (POSIX ustar; time, owner and group 0; mode 0644 or 0755), given piece
/// by piece to `out`. Packing writes with it, and reading writes with it again to compare.
class TarWriter {
 public:
  explicit TarWriter(std::function<void(std::string_view)> out);
  ~TarWriter();
  TarWriter(const TarWriter&) = delete;
  TarWriter& operator=(const TarWriter&) = delete;

  void begin(const std::string& path, std::uint64_t size, bool executable);
  void write(std::string_view bytes);
  void end();

  /// The archive's end.
  void close();

 private:
  void check(long result);
  static long receive(archive*, void* self, const void* bytes, std::size_t size);

  std::function<void(std::string_view)> out_;
  std::exception_ptr failure_;  // of out_: exceptions must not pass through the archive library's frames
  archive* archive_;
};

}  // namespace fiona::marketplace
