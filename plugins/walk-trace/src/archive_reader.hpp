#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

#include <fiona/walk/dataset.hpp>

struct archive;

namespace fiona::walk {

/// Streams the text files of one .tar.xz, line by line, through libarchive. Throws fiona::Error naming the archive.
class ArchiveReader {
 public:
  ArchiveReader(const std::filesystem::path& file, const Limits& limits);
  ~ArchiveReader();
  ArchiveReader(const ArchiveReader&) = delete;
  ArchiveReader& operator=(const ArchiveReader&) = delete;

  /// Moves to the next regular `.tsv` file; false at the end of the archive.
  bool next();

  /// Archive and entry, as errors name them.
  std::string where() const;

  /// Gives every line of the current file to `line`.
  void for_each_line(const std::function<void(std::string_view)>& line);

 private:
  [[noreturn]] void fail(const std::string& what, const std::string& found) const;

  std::filesystem::path file_;
  Limits limits_;
  ::archive* archive_ = nullptr;
  std::string entry_;
  std::size_t entries_ = 0;
  bool passed_over_ = false;  ///< files of other names
};

}  // namespace fiona::walk
