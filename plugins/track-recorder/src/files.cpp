#include "files.hpp"

#include <unistd.h>

#include <cerrno>
#include <system_error>

#include "fiona/error.hpp"

namespace fiona::recorder {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void refuse(const fs::path& path, const std::string& cause) {
  std::error_code ignored;
  throw Error(ErrorCode::Failed,
              {.what = "cannot write " + path.string() + ": " + cause,
               .where = fs::absolute(path, ignored).string(),
               .next = "check that the directory exists, may be written and has space, or name another file"});
}

std::string cause_of(int error) { return std::generic_category().message(error); }

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

std::optional<fs::path> keep_aside(const fs::path& path) {
  constexpr int kMostKept = 9999;
  std::error_code error;
  if (!fs::is_regular_file(path, error) || fs::file_size(path, error) == 0 || error) return std::nullopt;
  for (int number = 1; number <= kMostKept; ++number) {
    fs::path kept = path;
    kept += "." + std::to_string(number);
    if (fs::exists(fs::symlink_status(kept, error))) continue;
    fs::rename(path, kept, error);
    if (error) refuse(kept, error.message());
    return kept;
  }
  refuse(path, std::to_string(kMostKept) + " recordings of before lie beside it");
}

void write_atomically(const fs::path& path, std::string_view text) {
  fs::path beside = path;
  beside += ".part-" + std::to_string(::getpid());
  std::error_code error;
  try {
    LineFile file(beside);
    file.add(text);
  } catch (const Error& failure) {
    fs::remove(beside, error);
    const std::string& what = failure.text().what;
    refuse(path, what.substr(what.rfind(": ") + 2));
  }
  fs::rename(beside, path, error);
  if (!error) return;
  const std::string cause = error.message();
  fs::remove(beside, error);
  refuse(path, cause);
}

}  // namespace fiona::recorder
