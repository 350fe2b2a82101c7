#include "files.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fiona/error.hpp>

namespace fiona::marketplace {
namespace {

std::string next_step(int error, const std::filesystem::path& where) {
  switch (error) {
    case ENOSPC:
    case EDQUOT: return "free some space where " + where.string() + " is and try again";
    case EROFS:
    case EACCES:
    case EPERM: return "choose a place that you may write to, or ask its owner";
    case EMFILE:
    case ENFILE: return "raise the limit of open files (ulimit -n) and try again";
    case ENOSYS: return "use a kernel with openat2 (Linux 5.6 or newer)";
    case EIO: return "check the disk (dmesg), then try again";
    default: return "look at " + where.string() + " and try again";
  }
}

}  // namespace

FileDescriptor::~FileDescriptor() {
  if (number_ >= 0) ::close(number_);
}

void throw_os_error(const std::string& action, const std::filesystem::path& where, int error) {
  throw Error(ErrorCode::Failed, ErrorText{.what = "could not " + action + ": " + std::strerror(error),
                                           .where = where.string(),
                                           .next = next_step(error, where)});
}

FileDescriptor open_regular(int directory, const std::filesystem::path& path, const std::filesystem::path& shown) {
  // O_NONBLOCK: a FIFO of that name must not make us wait for its other end.
  FileDescriptor file{::openat(directory, path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC)};
  if (!file) {
    if (errno == ENOENT || errno == ENOTDIR) return file;
    throw_os_error("open it for reading", shown, errno);
  }
  struct stat status {};
  if (::fstat(file.number(), &status) != 0) throw_os_error("look at it", shown, errno);
  if (!S_ISREG(status.st_mode)) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "this is not a regular file",
                                             .where = shown.string(),
                                             .next = "put the file itself there, not a link, directory or pipe"});
  }
  return file;
}

std::uint64_t size_of(const FileDescriptor& file) {
  struct stat status {};
  return ::fstat(file.number(), &status) == 0 ? static_cast<std::uint64_t>(status.st_size) : 0;
}

std::size_t read_some(int file, char* buffer, std::size_t size, const std::filesystem::path& shown) {
  for (;;) {
    const ssize_t count = ::read(file, buffer, size);
    if (count >= 0) return static_cast<std::size_t>(count);
    if (errno != EINTR) throw_os_error("read it", shown, errno);
  }
}

std::string read_all(const FileDescriptor& file, std::uint64_t most, const std::filesystem::path& shown) {
  std::string bytes;
  std::size_t used = 0;
  for (;;) {
    // One byte more than is expected, so that the end is seen without growing once again.
    bytes.resize(std::max<std::size_t>(used + 4096, std::min(size_of(file), most) + 1));
    const std::size_t count = read_some(file.number(), bytes.data() + used, bytes.size() - used, shown);
    if (count == 0) break;
    used += count;
    if (used > most) {
      throw Error(ErrorCode::Failed, ErrorText{.what = "this file is larger than such a file may be",
                                               .where = shown.string(),
                                               .expected = "at most " + std::to_string(most) + " bytes",
                                               .next = "see whether it is the file that was meant"});
    }
  }
  bytes.resize(used);
  return bytes;
}

FileDescriptor open_directory(int parent, const std::filesystem::path& path, const std::filesystem::path& shown) {
  FileDescriptor directory{
      ::openat(parent, path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC)};
  if (!directory && errno != ENOENT) throw_os_error("open this directory", shown, errno);
  return directory;
}

}  // namespace fiona::marketplace
