#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdio>
#include <fiona/marketplace/os_calls.hpp>

namespace fiona::marketplace {
namespace {

int create_beneath(int directory, const char* path, mode_t mode) {
  open_how how{};
  how.flags = O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC;
  how.mode = mode;
  how.resolve = RESOLVE_BENEATH | RESOLVE_NO_SYMLINKS | RESOLVE_NO_MAGICLINKS;
  return static_cast<int>(::syscall(SYS_openat2, directory, path, &how, sizeof how));
}

}  // namespace

OsCalls system_calls() {
  return {.create = create_beneath,
          .write = ::write,
          .fsync = ::fsync,
          .mkdir = ::mkdirat,
          .rename = ::renameat,
          .unlink = ::unlinkat,
          .flock = ::flock};
}

}  // namespace fiona::marketplace
