#include "os/unix_socket.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <system_error>
#include <thread>

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

/// For what a process that was killed had just begun to start: until that is a program of its own it has the locks too.
constexpr std::chrono::seconds kLetsGoWithin{2};
constexpr std::chrono::milliseconds kNap{5};

struct Lock {
  Descriptor taken;    ///< none: another process has it
  std::string holder;  ///< the number of the one that has taken it last
};

std::string holder_in(const Descriptor& file) {
  char number[32] = {};
  const auto size = ::pread(file.get(), number, sizeof number - 1, 0);
  return {number, size > 0 ? static_cast<std::size_t>(size) : 0};
}

bool has_gone(const std::string& process) {
  const int id = std::atoi(process.c_str());
  return id > 0 && ::kill(id, 0) != 0 && errno == ESRCH;
}

/// In a file that says who has it.
Lock lock_in(const std::filesystem::path& path) {
  Descriptor file(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file) fail("the lock cannot be opened", path);
  const auto end = std::chrono::steady_clock::now() + kLetsGoWithin;
  while (::flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
    std::string holder = holder_in(file);
    if (!has_gone(holder) || std::chrono::steady_clock::now() >= end) return {{}, std::move(holder)};
    std::this_thread::sleep_for(kNap);
  }
  const std::string self = std::to_string(::getpid());
  if (::ftruncate(file.get(), 0) != 0 || ::pwrite(file.get(), self.data(), self.size(), 0) < 0)
    fail("the lock cannot be written", path);
  return {std::move(file), self};
}

Descriptor lock_beside(const std::filesystem::path& path) {
  Lock lock = lock_in(path.string() + ".lock");
  if (lock.taken) return std::move(lock.taken);
  throw Error(ErrorCode::NotAllowed, {.what = "another host already serves this name",
                                      .where = path.string(),
                                      .found = "process " + lock.holder,
                                      .next = "stop it, or start this one with --host NAME"});
}

}  // namespace

Descriptor try_lock(const std::filesystem::path& file) { return lock_in(file).taken; }

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
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
    throw Error(ErrorCode::Failed,
                {.what = "no socket pair can be made",
                 .found = std::strerror(errno),
                 .next = "fiona doctor; end what holds many descriptors, or raise the limit: ulimit -n"});
  }
  return {Descriptor(ends[0]), Descriptor(ends[1])};
}

}  // namespace fiona::os
