// What a static constructor does where nobody has shut it in: it looks at what is not its own, and ends the process.
#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>

#include "animal.hpp"

namespace {

const char* found_outside() {
  if (::open("/etc/passwd", O_RDONLY | O_CLOEXEC) >= 0) return "the list of users";
  if (std::getenv("HOME") != nullptr) return "a home";
  if (::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0) >= 0) return "the network";
  const pid_t child = ::fork();
  if (child == 0) ::_exit(0);
  return child > 0 ? "another process" : nullptr;
}

int look_around() {
  const char* found = found_outside();
  if (found == nullptr) return 0;
  std::fprintf(stderr, "it has found %s\n", found);
  ::_exit(42);
}
[[maybe_unused]] const int looked = look_around();

}  // namespace
