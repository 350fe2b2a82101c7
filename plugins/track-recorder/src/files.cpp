#include "files.hpp"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <system_error>

#include "fiona/error.hpp"

namespace fiona::recorder {
namespace {

namespace fs = std::filesystem;

constexpr const char* kCheck = "check that the directory exists, may be written and has space, or name another file";

[[noreturn]] void refuse(const fs::path& path, const std::string& cause, const std::string& next = kCheck) {
  std::error_code ignored;
  throw Error(ErrorCode::Failed, {.what = "cannot write " + path.string() + ": " + cause,
                                  .where = fs::absolute(path, ignored).string(),
                                  .next = next});
}

std::string cause_of(int error) { return std::generic_category().message(error); }

/// The file that a link leads to, whether or not it is there: links stay where they are.
fs::path behind_links(fs::path path) {
  constexpr int kMostLinks = 40;  // as many as the system follows
  std::error_code error;
  for (int i = 0; i < kMostLinks && fs::is_symlink(path, error); ++i) {
    const fs::path to = fs::read_symlink(path, error);
    if (error) break;
    path = path.parent_path() / to;
  }
  return path;
}

bool holds(const fs::path& path, std::string_view text) {
  std::ifstream in(path, std::ios::binary);
  return std::equal(std::istreambuf_iterator<char>(in), {}, text.begin(), text.end());
}

/// What is to be renamed to `path`, which it names in an error.
fs::path written_beside(const fs::path& path, std::string_view text) {
  fs::path beside = path;
  beside += ".part-" + std::to_string(::getpid());
  try {
    LineFile file(beside);
    file.add(text);
  } catch (const Error& failure) {
    std::error_code ignored;
    fs::remove(beside, ignored);
    const std::string& what = failure.text().what;
    refuse(path, what.substr(what.rfind(": ") + 2));
  }
  return beside;
}

}  // namespace

LineFile::LineFile(fs::path path) : path_(std::move(path)), file_(std::fopen(path_.c_str(), "wbe")) {
  if (!file_) refuse(path_, cause_of(errno));
}

void LineFile::add(std::string_view line) {
  std::FILE* const file = file_.get();
  const bool written = std::fwrite(line.data(), 1, line.size(), file) == line.size() && std::fputc('\n', file) != EOF &&
                       std::fflush(file) == 0;
  if (!written) refuse(path_, cause_of(errno));
}

std::optional<fs::path> keep_aside(const fs::path& named, std::string_view nothing) {
  constexpr int kMostKept = 9999;
  std::error_code error;
  const fs::path path = behind_links(named);
  if (!fs::is_regular_file(path, error) || fs::file_size(path, error) == 0 || error) return std::nullopt;
  if (holds(path, nothing)) return std::nullopt;
  for (int number = 1; number <= kMostKept; ++number) {
    fs::path kept = path;
    kept += "." + std::to_string(number);
    if (fs::exists(fs::symlink_status(kept, error))) continue;
    fs::rename(path, kept, error);
    if (error) refuse(kept, error.message());
    return kept;
  }
  refuse(path, std::to_string(kMostKept) + " recordings of before lie beside it",
         "move them elsewhere, or name another file");
}

void check_replaceable(const fs::path& named) {
  const fs::path path = behind_links(named);
  std::error_code error;
  if (fs::is_directory(path, error)) refuse(path, cause_of(EISDIR));
  fs::remove(written_beside(path, ""), error);
}

void write_atomically(const fs::path& named, std::string_view text) {
  const fs::path path = behind_links(named);
  const fs::path beside = written_beside(path, text);
  std::error_code error;
  fs::rename(beside, path, error);
  if (!error) return;
  const std::string cause = error.message();
  fs::remove(beside, error);
  refuse(path, cause);
}

}  // namespace fiona::recorder
