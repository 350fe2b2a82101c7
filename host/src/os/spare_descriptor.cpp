#include "os/spare_descriptor.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <mutex>
#include <thread>

#include "os/descriptor.hpp"

namespace fiona::os {
namespace {

/// Between looks at a listener that nobody can be accepted from, so that they cost little.
constexpr std::chrono::milliseconds kPause{10};

class Spare {
 public:
  void keep() {
    const std::lock_guard lock(mutex_);
    kept_ = true;
    renew();
  }
  /// Takes one who waits there, and lets go of them.
  void turn_away(int listener) {
    const std::lock_guard lock(mutex_);
    pollfd waiting{listener, POLLIN, 0};
    if (!kept_ || ::poll(&waiting, 1, 0) <= 0) return;
    spare_.reset();
    Descriptor accepted(static_cast<int>(::syscall(SYS_accept4, listener, nullptr, nullptr, SOCK_CLOEXEC)));
    const bool taken = static_cast<bool>(accepted);
    accepted.reset();
    renew();
    if (!taken) std::this_thread::sleep_for(kPause);
  }

 private:
  void renew() {
    if (!spare_) spare_ = Descriptor(::eventfd(0, EFD_CLOEXEC));
  }

  std::mutex mutex_;
  bool kept_ = false;
  Descriptor spare_;
};

/// Not destroyed: threads that listen may outlive the end of `main`.
Spare& spare() {
  static Spare& one = *new Spare;
  return one;
}

}  // namespace

void keep_spare_descriptor() { spare().keep(); }

}  // namespace fiona::os

extern "C" int accept4(int listener, sockaddr* address, socklen_t* length, int flags) {
  const auto accepted = static_cast<int>(::syscall(SYS_accept4, listener, address, length, flags));
  if (accepted >= 0 || (errno != EMFILE && errno != ENFILE)) return accepted;
  fiona::os::spare().turn_away(listener);
  errno = ECONNABORTED;
  return -1;
}
