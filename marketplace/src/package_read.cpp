#include <archive.h>
#include <archive_entry.h>
#include <fcntl.h>

#include <algorithm>
#include <exception>
#include <fiona/error.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/package.hpp>
#include <memory>
#include <utility>

#include "decompressor.hpp"
#include "files.hpp"
#include "tar_writer.hpp"
#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

using EntryPointer = archive_entry*;

constexpr const char* kNextStep = "do not use this package; tell its publisher";

// More than the archive library reads ahead for one plain header: extended headers are refused before they
// fill memory.
constexpr std::size_t kMostReadAhead = std::size_t{256} << 10;

std::string shown(const char* path) {
  if (!path || !text_fault(path, false).empty()) return "a file whose name is not plain text";
  const std::string name = path;
  return name.size() <= 120 ? name : name.substr(0, 117) + "...";
}

class PackageReader {
 public:
  PackageReader(const ByteSource& source, std::string where, PackageSink& sink, const PackageLimits& limits)
      : where_(std::move(where)),
        sink_(sink),
        limits_(limits),
        decompressor_(source, limits.total_bytes + limits.manifest_bytes + (std::uint64_t{8} << 20), where_),
        canonical_([this](std::string_view bytes) { compare(bytes); }),
        archive_(archive_read_new(), archive_read_free) {
    archive_read_support_format_tar(archive_.get());
    archive_read_set_read_callback(archive_.get(), &PackageReader::feed);
    archive_read_set_callback_data(archive_.get(), this);
    check(archive_read_open1(archive_.get()));
  }

  PackageContents read() {
    read_manifest();
    for (const auto& file : contents_.manifest.files()) read_listed(file);
    if (EntryPointer extra = next_entry()) refuse_extra(extra);
    canonical_.close();
    for (std::string_view bytes; unread_.empty() && !(bytes = decompressor_.next()).empty();) {
      unread_ += bytes;
      compare({});
    }
    if (!expected_.empty()) refuse("the package's archive ends too early");
    if (!unread_.empty()) refuse("the package has bytes after its last file");
    contents_.size = decompressor_.size();
    contents_.blake2b = decompressor_.blake2b();
    return std::move(contents_);
  }

  [[noreturn]] void refuse(std::string what, std::string expected = {}, std::string found = {}) const {
    throw Error(ErrorCode::Failed, ErrorText{.what = std::move(what),
                                             .where = where_,
                                             .expected = std::move(expected),
                                             .found = std::move(found),
                                             .next = kNextStep});
  }

  static la_ssize_t feed(archive*, void* self, const void** buffer) {
    auto& reader = *static_cast<PackageReader*>(self);
    try {
      const std::string_view bytes = reader.decompressor_.next();
      if (reader.unread_.size() + bytes.size() > kMostReadAhead) {
        reader.refuse("the package has an archive header that no package has");
      }
      reader.unread_ += bytes;
      reader.compare({});
      *buffer = bytes.data();
      return static_cast<la_ssize_t>(bytes.size());
    } catch (...) {
      reader.failure_ = std::current_exception();
      return ARCHIVE_FATAL;
    }
  }

  // What was read must be what packing writes. libarchive understands many tar dialects, and other readers
  // understand them otherwise; comparing leaves one. Either side may be ahead of the other by a header or a
  // filling.
  void compare(std::string_view written) {
    expected_ += written;
    const std::size_t both = std::min(unread_.size(), expected_.size());
    if (unread_.compare(0, both, expected_, 0, both) != 0) {
      refuse("the package's archive is not in the one form that packages have", "tar as fiona-pack writes it",
             "another header or filling at " + (current_.empty() ? "its end" : current_));
    }
    unread_.erase(0, both);
    expected_.erase(0, both);
  }

  void check(int result) {
    if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
    if (result == ARCHIVE_OK || result == ARCHIVE_EOF) return;
    const char* reason = archive_error_string(archive_.get());
    const bool plain = reason && text_fault(reason, false).empty();
    refuse("the package's archive is damaged: " + (plain ? std::string(reason) : "no reason given"));
  }

  EntryPointer next_entry() {
    EntryPointer entry = nullptr;
    const int result = archive_read_next_header(archive_.get(), &entry);
    check(result);
    current_ = result == ARCHIVE_EOF ? "" : shown(archive_entry_pathname(entry));
    return result == ARCHIVE_EOF ? nullptr : entry;
  }

  void check_kind(EntryPointer entry) const {
    if (archive_entry_hardlink(entry)) refuse(current_ + " is a hard link", "a regular file");
    if (archive_entry_symlink(entry) || archive_entry_filetype(entry) == AE_IFLNK) {
      refuse(current_ + " is a symbolic link", "a regular file");
    }
    if (archive_entry_filetype(entry) == AE_IFDIR) refuse(current_ + " is a directory", "regular files only");
    if (archive_entry_filetype(entry) != AE_IFREG) refuse(current_ + " is a device or pipe", "a regular file");
    if (archive_entry_sparse_count(entry) > 0) refuse(current_ + " is a sparse file", "a plain file");
    if (archive_entry_xattr_count(entry) > 0) refuse(current_ + " has extended attributes", "none");
    if (!archive_entry_size_is_set(entry) || archive_entry_size(entry) < 0) refuse(current_ + " has no size");
  }

  bool lists(std::string_view path) const {
    return std::ranges::any_of(contents_.manifest.files(), [&](const auto& file) { return file.path() == path; });
  }

  [[noreturn]] void refuse_path(EntryPointer entry, const std::string& expected) const {
    const char* path = archive_entry_pathname(entry);
    const std::string fault = path ? path_fault(path) : "is not text";
    if (path && path == kManifestFile) refuse("the package has a second manifest", expected);
    if (path && lists(path)) refuse(current_ + " is in the package twice or out of order", expected, current_);
    if (!fault.empty()) refuse("a file's path " + fault, expected, current_);
    refuse(current_ + " is not listed in the manifest", expected, current_);
  }

  [[noreturn]] void refuse_extra(EntryPointer entry) {
    check_kind(entry);
    refuse_path(entry, "no file after the last that the manifest lists");
  }

  void read_manifest() {
    EntryPointer entry = next_entry();
    if (!entry) refuse("the package is empty", std::string(kManifestFile) + " first");
    if (const char* path = archive_entry_pathname(entry); !path || path != kManifestFile) {
      refuse("the manifest is not the package's first file", std::string(kManifestFile), current_);
    }
    check_kind(entry);
    PackageFile file;
    file.set_path(std::string(kManifestFile));
    file.set_size(static_cast<std::uint64_t>(archive_entry_size(entry)));
    if (file.size() > limits_.manifest_bytes) {
      refuse("the manifest is too large", "at most " + std::to_string(limits_.manifest_bytes) + " bytes",
             std::to_string(file.size()) + " bytes");
    }
    std::string text;
    read_content(file, [&](std::string_view bytes) { text += bytes; });
    const std::string place = where_ + "/" + file.path();
    contents_.manifest = parse_manifest(text, place);
    check_packed_manifest(contents_.manifest, place, limits_);
    sink_.begin(file);
    sink_.write(text);
    sink_.end();
  }

  void read_listed(const PackageFile& file) {
    EntryPointer entry = next_entry();
    if (!entry) refuse("the package lacks " + file.path(), "every file that its manifest lists");
    if (const char* path = archive_entry_pathname(entry); !path || path != file.path()) {
      check_kind(entry);
      refuse_path(entry, file.path());
    }
    check_kind(entry);
    if (const auto size = static_cast<std::uint64_t>(archive_entry_size(entry)); size != file.size()) {
      refuse(file.path() + " has another size than the manifest says", std::to_string(file.size()) + " bytes",
             std::to_string(size) + " bytes");
    }
    std::string interface;
    Blake2b hash;
    sink_.begin(file);
    read_content(file, [&](std::string_view bytes) {
      hash.update(bytes);
      if (file.path() == kInterfaceFile) interface += bytes;
      sink_.write(bytes);
    });
    sink_.end();
    check_hash(file, hash.finish());
    if (file.path() == kInterfaceFile) take_interface(interface);
  }

  void check_hash(const PackageFile& file, const std::string& found) const {
    if (found == file.blake2b()) return;
    throw Error(ErrorCode::BadSignature, ErrorText{.what = file.path() + " is not what the manifest says",
                                                   .where = where_,
                                                   .expected = file.blake2b(),
                                                   .found = found,
                                                   .next = kNextStep});
  }

  void take_interface(const std::string& text) {
    contents_.interface = parse_interface(text, where_ + "/" + std::string(kInterfaceFile));
    if (contents_.interface.abi() != contents_.manifest.abi()) {
      refuse("the manifest and the interface speak of different ABIs", contents_.manifest.abi(),
             contents_.interface.abi());
    }
    Manifest derived = contents_.manifest;
    list_protos(contents_.interface, derived);
    if (derived.SerializeAsString() != contents_.manifest.SerializeAsString())
      refuse("the manifest and the interface speak of different proto files");
  }

  // Passes a file's content on, and through the canonical writer.
  template <typename Receive>
  void read_content(const PackageFile& file, Receive&& receive) {
    canonical_.begin(file.path(), file.size(), file.executable());
    std::uint64_t used = 0;
    for (;;) {
      const void* bytes = nullptr;
      std::size_t size = 0;
      la_int64_t offset = 0;
      const int result = archive_read_data_block(archive_.get(), &bytes, &size, &offset);
      check(result);
      if (result == ARCHIVE_EOF) break;
      if (static_cast<std::uint64_t>(offset) != used || size > file.size() - used) {
        refuse(file.path() + " has more content or holes than its size says");
      }
      used += size;
      const std::string_view block{static_cast<const char*>(bytes), size};
      canonical_.write(block);
      receive(block);
    }
    if (used != file.size()) refuse(file.path() + " has less content than its size says");
    canonical_.end();
  }

  std::string where_;
  PackageSink& sink_;
  const PackageLimits& limits_;
  Decompressor decompressor_;
  std::string unread_;          // decompressed and not yet compared
  std::string expected_;        // written by canonical_ and not yet compared
  std::string current_;         // the entry's name as errors may show it
  std::exception_ptr failure_;  // of feed(): exceptions must not pass through the archive library's frames
  PackageContents contents_;
  TarWriter canonical_;
  std::unique_ptr<archive, int (*)(archive*)> archive_;
};

class NoSink final : public PackageSink {
 public:
  void begin(const PackageFile&) override {}
  void write(std::string_view) override {}
  void end() override {}
};

}  // namespace

PackageContents read_package(const ByteSource& source, const std::string& where, PackageSink& sink,
                             const PackageLimits& limits) {
  try {
    return PackageReader(source, where, sink, limits).read();
  } catch (const Error& error) {
    if (!error.text().next.empty()) throw;
    ErrorText text = error.text();
    text.next = kNextStep;
    throw Error(error.code(), text);
  }
}

PackageContents inspect_package(const std::filesystem::path& path, const PackageLimits& limits) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) {
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no such package file",
                                               .where = path.string(),
                                               .next = "look at the path, or pack the package first"});
  }
  NoSink sink;
  const auto source = [&](char* buffer, std::size_t size) { return read_some(file.number(), buffer, size, path); };
  return read_package(source, path.filename().string(), sink, limits);
}

}  // namespace fiona::marketplace
