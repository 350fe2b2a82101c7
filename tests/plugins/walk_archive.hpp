// Archives of recorded walks, as datasets have them.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <archive.h>
#include <archive_entry.h>
#include <gtest/gtest.h>

namespace fiona::tests {

using Files = std::vector<std::pair<std::string, std::string>>;

/// A .tar.xz of these files: name and text of each.
inline void write_archive(const std::filesystem::path& file, const Files& files) {
  std::filesystem::create_directories(file.parent_path());
  archive* out = archive_write_new();
  archive_write_add_filter_xz(out);
  archive_write_set_format_pax_restricted(out);
  ASSERT_EQ(archive_write_open_filename(out, file.c_str()), ARCHIVE_OK);
  for (const auto& [name, text] : files) {
    archive_entry* entry = archive_entry_new();
    archive_entry_set_pathname(entry, name.c_str());
    archive_entry_set_size(entry, static_cast<la_int64_t>(text.size()));
    archive_entry_set_filetype(entry, AE_IFREG);
    archive_entry_set_perm(entry, 0644);
    archive_write_header(out, entry);
    archive_write_data(out, text.data(), text.size());
    archive_entry_free(entry);
  }
  archive_write_close(out);
  archive_write_free(out);
}

}  // namespace fiona::tests
