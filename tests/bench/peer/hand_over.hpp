// What the `fiona-group` that the host starts passes to the process that shall be the group: its arguments, and the
// descriptors that it was given.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>
#include <string>
#include <vector>

namespace fiona::peer {

constexpr int kGroupSocket = 3;
constexpr int kLastGroupDescriptor = 4;  ///< the clock's, where it is virtual: here it never is

inline bool hand_over(int to, int argc, char** argv) {
  std::string words;
  for (int i = 0; i < argc; ++i) words.append(argv[i]).push_back('\0');
  iovec data{words.data(), words.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr& header = *CMSG_FIRSTHDR(&message);
  header.cmsg_level = SOL_SOCKET;
  header.cmsg_type = SCM_RIGHTS;
  header.cmsg_len = CMSG_LEN(sizeof(int));
  std::memcpy(CMSG_DATA(&header), &kGroupSocket, sizeof(int));
  return ::sendmsg(to, &message, MSG_NOSIGNAL) == static_cast<ssize_t>(words.size());
}

/// The arguments; the descriptor is put where a group expects it.
inline std::vector<std::string> receive_hand_over(int from) {
  char words[4096];
  iovec data{words, sizeof words};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  pollfd wait{from, POLLIN, 0};
  ::poll(&wait, 1, 5000);
  const ssize_t size = ::recvmsg(from, &message, MSG_CMSG_CLOEXEC);
  const cmsghdr* header = CMSG_FIRSTHDR(&message);
  if (size <= 0 || !header) return {};
  int received = -1;
  std::memcpy(&received, CMSG_DATA(header), sizeof received);
  ::dup3(received, kGroupSocket, O_CLOEXEC);
  ::close(received);
  std::vector<std::string> all;
  for (const char* at = words; at < words + size; at += all.back().size() + 1) all.emplace_back(at);
  return all;
}

}  // namespace fiona::peer
