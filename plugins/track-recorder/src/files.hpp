#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

namespace fiona::recorder {

/// A text file that grows line by line. Each line is with the operating system before `add` returns, so
/// whatever ends the process leaves whole lines behind.
class LineFile {
 public:
  /// Creates the file, or empties one that exists. Throws Error Failed with the system's reason.
  explicit LineFile(std::filesystem::path path);

  /// Adds `line` and a line feed. Throws Error Failed with the system's reason.
  void add(std::string_view line);

  const std::filesystem::path& path() const { return path_; }

 private:
  struct Closer {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  std::filesystem::path path_;
  std::unique_ptr<std::FILE, Closer> file_;
};

/// Replaces the file by `text` in one step: readers see the old content or the new, never a part. Throws
/// Error Failed with the system's reason; the old file is untouched then, and nothing is left beside it.
void write_atomically(const std::filesystem::path& path, std::string_view text);

}  // namespace fiona::recorder
