#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <string>

#include "animal.hpp"
#include "host_socket.hpp"

// A socket is a file: as many as it can where it listens.
void zoo::act() {
  const std::string folder = link_folder();
  for (int i = 0; i < 100; ++i) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    (folder + "/" + std::to_string(i)).copy(address.sun_path, sizeof address.sun_path - 1);
    const int one = ::socket(AF_UNIX, SOCK_STREAM, 0);
    ::bind(one, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    ::close(one);
  }
}
