#pragma once

#include <sys/types.h>

#include <cstddef>
#include <functional>

namespace fiona::marketplace {

/// Every call by which this library changes the file system, so that a test can fail or end the process at
/// each one. They behave as the system calls of their names: -1 and errno on failure.
struct OsCalls {
  /// openat2 with O_WRONLY|O_CREAT|O_EXCL|O_NOFOLLOW|O_CLOEXEC, beneath `directory`, through no symbolic
  /// link.
  std::function<int(int directory, const char* path, mode_t mode)> create;
  std::function<ssize_t(int file, const void* bytes, std::size_t size)> write;
  std::function<int(int file)> fsync;
  std::function<int(int directory, const char* name, mode_t mode)> mkdir;
  std::function<int(int from_directory, const char* from, int to_directory, const char* to)> rename;
  std::function<int(int directory, const char* name, int flags)> unlink;
  std::function<int(int file, int operation)> flock;
};

/// The operating system's own.
OsCalls system_calls();

}  // namespace fiona::marketplace
