#include "archive_reader.hpp"

#include <array>

#include <archive.h>
#include <archive_entry.h>

#include <fiona/error.hpp>

namespace fiona::walk {
namespace {

constexpr std::size_t kReadBytes = 64 * 1024;

}  // namespace

ArchiveReader::ArchiveReader(const std::filesystem::path& file, const Limits& limits) : file_(file), limits_(limits) {
  std::error_code error;
  const auto size = std::filesystem::file_size(file, error);
  if (error) {
    throw Error(ErrorCode::NotFound, {.what = "cannot read the archive of walks: " + error.message(),
                                      .where = file.string(),
                                      .expected = "a readable .tar.xz",
                                      .next = "check the folder's name and that its files were copied"});
  }
  if (size > limits.archive_bytes)
    fail("the archive is larger than the reader accepts", std::to_string(size) + " bytes");
  archive_ = archive_read_new();
  archive_read_support_filter_xz(archive_);
  archive_read_support_format_tar(archive_);
  if (archive_read_open_filename(archive_, file.c_str(), kReadBytes) != ARCHIVE_OK) {
    const std::string reason = archive_error_string(archive_);
    archive_read_free(archive_);
    archive_ = nullptr;
    fail("the archive is truncated or garbled", reason);
  }
}

ArchiveReader::~ArchiveReader() { archive_read_free(archive_); }

std::string ArchiveReader::where() const { return file_.string() + (entry_.empty() ? "" : ":" + entry_); }

void ArchiveReader::fail(const std::string& what, const std::string& found) const {
  throw Error(ErrorCode::Failed, {.what = what,
                                  .where = where(),
                                  .expected = "a complete .tar.xz of .tsv walks",
                                  .found = found,
                                  .next = "get the archive again from its source"});
}

bool ArchiveReader::next() {
  archive_entry* entry = nullptr;
  for (;;) {
    const int status = archive_read_next_header(archive_, &entry);
    if (status == ARCHIVE_EOF) {
      entry_.clear();
      if (entries_ == 0 && passed_over_) fail("the archive holds no walk", "files, and none whose name ends in .tsv");
      return false;
    }
    if (status != ARCHIVE_OK) fail("the archive is truncated or garbled", archive_error_string(archive_));
    const char* name = archive_entry_pathname(entry);
    entry_ = name == nullptr ? "" : name;
    if (archive_entry_filetype(entry) != AE_IFREG) continue;
    if (entry_.ends_with(".tsv")) break;
    passed_over_ = true;
  }
  if (++entries_ > limits_.walks) fail("the archive holds more walks than the reader accepts", "more than the limit");
  return true;
}

void ArchiveReader::for_each_line(const std::function<void(std::string_view)>& line) {
  std::array<char, kReadBytes> buffer;
  std::string rest;
  std::uint64_t total = 0;
  for (;;) {
    const la_ssize_t got = archive_read_data(archive_, buffer.data(), buffer.size());
    if (got < 0) fail("the archive is truncated or garbled", archive_error_string(archive_));
    if (got == 0) break;
    total += static_cast<std::uint64_t>(got);
    if (total > limits_.walk_bytes) fail("a walk is longer than the reader accepts", std::to_string(total) + " bytes");
    std::string_view text(buffer.data(), static_cast<std::size_t>(got));
    for (auto end = text.find('\n'); end != std::string_view::npos; end = text.find('\n')) {
      if (rest.empty()) {
        line(text.substr(0, end));
      } else {
        line(rest.append(text.substr(0, end)));
        rest.clear();
      }
      text.remove_prefix(end + 1);
    }
    rest.append(text);
    if (rest.size() > limits_.line_bytes) fail("a line is longer than the reader accepts", rest.substr(0, 40));
  }
  if (!rest.empty()) line(rest);
}

}  // namespace fiona::walk
