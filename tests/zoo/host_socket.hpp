// The socket that a group shares with its host, in the hands of a component that has taken its process over.
#pragma once

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <google/protobuf/message_lite.h>

#include <string>

namespace zoo {

/// What FIONA itself says in this process goes nowhere from then on.
inline int take_host_socket() {
  constexpr int kGroupSocket = 3;
  const int taken = ::dup(kGroupSocket);
  int nowhere[2];
  ::socketpair(AF_UNIX, SOCK_STREAM, 0, nowhere);
  ::dup2(nowhere[0], kGroupSocket);
  return taken;
}

/// All of it, however slowly it is read.
inline void say(int socket, const std::string& bytes) {
  for (std::size_t said = 0; said < bytes.size();) {
    const ssize_t now = ::send(socket, bytes.data() + said, bytes.size() - said, MSG_NOSIGNAL);
    pollfd room{socket, POLLOUT, 0};
    now > 0 ? said += static_cast<std::size_t>(now) : ::poll(&room, 1, 100);
  }
}

inline void tell(int socket, const google::protobuf::MessageLite& message) {
  const std::string text = message.SerializeAsString();
  std::string framed;
  for (int shift = 0; shift < 32; shift += 8) framed += static_cast<char>(text.size() >> shift & 0xff);
  say(socket, framed + text);
}

/// Where this process listens for others: known by the socket.
inline std::string link_folder() {
  for (int descriptor = 3; descriptor < 64; ++descriptor) {
    sockaddr_un address{};
    socklen_t length = sizeof address;
    if (::getsockname(descriptor, reinterpret_cast<sockaddr*>(&address), &length) != 0) continue;
    const std::string path = address.sun_path;
    if (address.sun_family == AF_UNIX && path.ends_with("/link")) return path.substr(0, path.rfind('/'));
  }
  return "/";
}

}  // namespace zoo
