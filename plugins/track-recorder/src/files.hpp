#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

namespace fiona::recorder {

/// A text file that grows line by line. Each line is with the operating system before `add` returns, so
/// whatever ends the process leaves whole lines behind.
class LineFile {
 public:
  /// Creates the file, or empties one that exists (`keep_aside` keeps it). Throws Error Failed with the system's
  /// reason.
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

/// Renames a file that has something in it to the first free one of path.1, path.2 and so on, for what starts anew must
/// not lose what was recorded before: a group that is started again does so too. `nothing`: what a recording without a
/// location leaves, which is not kept. Where `path` is a link its file is renamed, and the link stays. Gives the new
/// name; nothing where there is no such file, or where it is no regular one. Throws Error Failed with the system's
/// reason, and where 9999 are taken.
std::optional<std::filesystem::path> keep_aside(const std::filesystem::path& path, std::string_view nothing);

/// Throws Error Failed with the system's reason where `write_atomically` would, as far as that can be known before.
void check_replaceable(const std::filesystem::path& path);

/// Replaces the file by `text` and a line feed in one step: readers see the old content or the new, never a part. A
/// link stays, and its file is replaced. Throws Error Failed with the system's reason; the old file is untouched then,
/// and nothing is left beside it.
void write_atomically(const std::filesystem::path& path, std::string_view text);

}  // namespace fiona::recorder
