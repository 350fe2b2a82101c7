#include "tar_writer.hpp"

#include <archive.h>
#include <archive_entry.h>

#include <fiona/error.hpp>
#include <memory>
#include <utility>

namespace fiona::marketplace {

TarWriter::TarWriter(std::function<void(std::string_view)> out) : out_(std::move(out)), archive_(archive_write_new()) {
  check(archive_write_set_format_ustar(archive_));
  check(archive_write_add_filter_none(archive_));
  check(archive_write_set_bytes_per_block(archive_, 0));  // unbuffered: bytes come when they are written
  check(archive_write_open(archive_, this, nullptr, &TarWriter::receive, nullptr));
}

TarWriter::~TarWriter() {
  // Freeing an open archive writes its end, which is for nobody; an archive marked as failed would leak its
  // buffer.
  out_ = nullptr;
  archive_write_free(archive_);
}

// Reports success to the archive library in any case: check() tells the failure as soon as the library
// returns.
long TarWriter::receive(archive*, void* self, const void* bytes, std::size_t size) {
  auto& writer = *static_cast<TarWriter*>(self);
  try {
    if (writer.out_ && !writer.failure_) writer.out_({static_cast<const char*>(bytes), size});
  } catch (...) {
    writer.failure_ = std::current_exception();
  }
  return static_cast<long>(size);
}

void TarWriter::check(long result) {
  if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
  if (result >= ARCHIVE_OK) return;
  const char* reason = archive_error_string(archive_);
  throw Error(ErrorCode::Failed,
              {.what = std::string("could not write an archive: ") + (reason ? reason : "no reason given"),
               .next = "make room on the disk: df -h"});
}

void TarWriter::begin(const std::string& path, std::uint64_t size, bool executable) {
  const std::unique_ptr<archive_entry, void (*)(archive_entry*)> entry{archive_entry_new(), archive_entry_free};
  archive_entry_set_pathname(entry.get(), path.c_str());
  archive_entry_set_filetype(entry.get(), AE_IFREG);
  archive_entry_set_perm(entry.get(), executable ? 0755 : 0644);
  archive_entry_set_size(entry.get(), static_cast<std::int64_t>(size));
  archive_entry_set_mtime(entry.get(), 0, 0);
  check(archive_write_header(archive_, entry.get()));
}

void TarWriter::write(std::string_view bytes) {
  while (!bytes.empty()) {
    const auto count = archive_write_data(archive_, bytes.data(), bytes.size());
    check(count);
    if (count == 0)
      throw Error(ErrorCode::Failed, {.what = "a file is larger than was said when it was begun",
                                      .next = "pack again when nothing writes to it any more"});
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
}

void TarWriter::end() { check(archive_write_finish_entry(archive_)); }

void TarWriter::close() { check(archive_write_close(archive_)); }

}  // namespace fiona::marketplace
