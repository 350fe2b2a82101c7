#include "os/unix_socket.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#include "fiona/error.hpp"

namespace fiona::os {
namespace {

[[noreturn]] void fail(std::string what, const std::filesystem::path& path) {
  const int code = errno;
  throw Error(ErrorCode::Failed,
              {.what = std::move(what),
               .where = path.string(),
               .found = std::strerror(code),
               .next = "see who owns the folder and what is in it: ls -la " + path.parent_path().string()});
}

sockaddr_un address_of(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string text = path.string();
  if (text.size() >= sizeof address.sun_path) {
    throw Error(ErrorCode::Usage, {.what = "the socket's path is too long",
                                   .where = text,
                                   .expected = "at most " + std::to_string(sizeof address.sun_path - 1) + " bytes",
                                   .next = "set XDG_RUNTIME_DIR to a shorter directory"});
  }
  std::memcpy(address.sun_path, text.c_str(), text.size() + 1);
  return address;
}

Descriptor lock_beside(const std::filesystem::path& path) {
  const std::filesystem::path lock_path = path.string() + ".lock";
  Descriptor lock(::open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!lock) fail("the lock beside the socket cannot be opened", lock_path);
  if (::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    char holder[32] = {};
    const auto size = ::pread(lock.get(), holder, sizeof holder - 1, 0);
    throw Error(ErrorCode::NotAllowed,
                {.what = "another host already serves this name",
                 .where = path.string(),
                 .found = "process " + std::string(holder, size > 0 ? static_cast<std::size_t>(size) : 0),
                 .next = "stop it, or start this one with --host NAME"});
  }
  const std::string self = std::to_string(::getpid());
  if (::ftruncate(lock.get(), 0) != 0 || ::pwrite(lock.get(), self.data(), self.size(), 0) < 0) {
    fail("the lock beside the socket cannot be written", lock_path);
  }
  return lock;
}

}  // namespace

Descriptor try_lock(const std::filesystem::path& file) {
  Descriptor lock(::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!lock) fail("the lock cannot be opened", file);
  return ::flock(lock.get(), LOCK_EX | LOCK_NB) == 0 ? std::move(lock) : Descriptor();
}

void require_private_directory(const std::filesystem::path& directory) {
  std::error_code ignored;
  std::filesystem::create_directories(directory.parent_path(), ignored);
  if (::mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) fail("the directory cannot be made", directory);
  struct stat status {};
  if (::lstat(directory.c_str(), &status) != 0) fail("the directory cannot be read", directory);
  const bool ours = S_ISDIR(status.st_mode) && status.st_uid == ::geteuid() && (status.st_mode & 077) == 0;
  if (ours) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the directory for sockets is not private to this user",
                                      .where = directory.string(),
                                      .expected = "owner " + std::to_string(::geteuid()) + ", mode 0700",
                                      .next = "remove it, or set XDG_RUNTIME_DIR to a directory of your own"});
}

UnixListener::UnixListener(const std::filesystem::path& path) : path_(path) {
  require_private_directory(path.parent_path());
  const sockaddr_un address = address_of(path);
  lock_ = lock_beside(path);
  ::unlink(path.c_str());
  socket_ = Descriptor(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket_) fail("no socket can be made", path);
  if (::bind(socket_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      ::listen(socket_.get(), 16) != 0) {
    fail("the socket cannot listen", path);
  }
}

UnixListener::~UnixListener() {
  ::unlink(path_.c_str());
  // The lock file stays: removing it would let two processes hold locks on two files of one name.
}

Descriptor UnixListener::accept() const {
  return Descriptor(::accept4(socket_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
}

std::pair<Descriptor, Descriptor> socket_pair() {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) fail("no socket pair can be made", "");
  return {Descriptor(ends[0]), Descriptor(ends[1])};
}

}  // namespace fiona::os
