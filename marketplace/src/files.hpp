#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

namespace fiona::marketplace {

/// An open file that is closed with its owner.
class FileDescriptor {
 public:
  explicit FileDescriptor(int number = -1) : number_(number) {}
  FileDescriptor(FileDescriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept {
    std::swap(number_, other.number_);
    return *this;
  }
  ~FileDescriptor();

  int number() const noexcept { return number_; }
  int release() noexcept { return std::exchange(number_, -1); }
  explicit operator bool() const noexcept { return number_ >= 0; }

 private:
  int number_;
};

/// Throws fiona::Error (Failed): "could not ACTION: MESSAGE OF errno", with a next step that fits the errno.
[[noreturn]] void throw_os_error(const std::string& action, const std::filesystem::path& where, int error);

/// Opens `path` below `directory` (AT_FDCWD: as it is) for reading if it is a regular file and not a symbolic
/// link. An empty descriptor if there is nothing of that name; throws fiona::Error (Failed) otherwise.
FileDescriptor open_regular(int directory, const std::filesystem::path& path, const std::filesystem::path& shown);

/// The whole of an open file; throws fiona::Error (Failed) if it is larger than `most` bytes.
std::string read_all(const FileDescriptor& file, std::uint64_t most, const std::filesystem::path& shown);

/// Opens a directory, not through a symbolic link in its last element; an empty descriptor if there is none.
FileDescriptor open_directory(int parent, const std::filesystem::path& path, const std::filesystem::path& shown);

/// read(2), again after a signal; throws fiona::Error (Failed).
std::size_t read_some(int file, char* buffer, std::size_t size, const std::filesystem::path& shown);

std::uint64_t size_of(const FileDescriptor& file);

}  // namespace fiona::marketplace
