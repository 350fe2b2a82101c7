// Beside the adapter under the name fiona-group. The harness counts what happens in the processes that it forks itself,
// so one of those is the group: it is handed the socket and the arguments, and this process lives as long as it does.
#include <sys/un.h>

#include <cstdio>
#include <cstdlib>

#include "hand_over.hpp"

int main(int argc, char** argv) {
  // None of the harness' processes can be a copy: the host starts this one for each group then.
  if (argc > 1 && std::strcmp(argv[1], "--template") == 0) return 0;
  std::string name;
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::strcmp(argv[i], "--name") == 0) name = argv[i + 1];
  }
  const char* directory = std::getenv("FIONA_PEER_RUN");
  if (!directory || name.empty()) return std::fprintf(stderr, "fiona-group: this one is the peers' harness' own\n"), 2;
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::snprintf(address.sun_path, sizeof address.sun_path, "%s/%s.sock", directory, name.c_str());
  const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (::connect(socket, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0)
    return std::perror(address.sun_path), 1;
  if (!fiona::peer::hand_over(socket, argc, argv)) return std::perror("handing over"), 1;
  ::close(fiona::peer::kFirstGroupDescriptor);
  char none = 0;
  static_cast<void>(::read(socket, &none, 1));  // until the group's process has ended
  return 0;
}
