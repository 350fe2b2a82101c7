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

/// The host's socket and the page of liveness, and at most a clock's socket; the last one is for another host, which
/// never comes here.
constexpr int kFirstGroupDescriptor = 3, kLastGroupDescriptor = 6;
constexpr std::size_t kMostDescriptors = kLastGroupDescriptor - kFirstGroupDescriptor + 1;

/// A message with room for descriptors.
struct HandOver {
  HandOver(void* bytes, std::size_t size, std::size_t descriptors) : data{bytes, size} {
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(descriptors * sizeof(int));
  }
  iovec data;
  alignas(cmsghdr) char control[CMSG_SPACE(kMostDescriptors * sizeof(int))] = {};
  msghdr message{};
};

/// The first word has the numbers of the descriptors, a digit each.
inline bool hand_over(int to, int argc, char** argv) {
  std::string words;
  std::vector<int> descriptors;
  for (int number = kFirstGroupDescriptor; number <= kLastGroupDescriptor; ++number) {
    if (number == to || ::fcntl(number, F_GETFD) < 0) continue;
    descriptors.push_back(number);
    words.push_back(static_cast<char>('0' + number));
  }
  words.push_back('\0');
  for (int i = 0; i < argc; ++i) words.append(argv[i]).push_back('\0');
  HandOver out(words.data(), words.size(), descriptors.size());
  cmsghdr& header = *CMSG_FIRSTHDR(&out.message);
  header.cmsg_level = SOL_SOCKET;
  header.cmsg_type = SCM_RIGHTS;
  header.cmsg_len = CMSG_LEN(descriptors.size() * sizeof(int));
  std::memcpy(CMSG_DATA(&header), descriptors.data(), descriptors.size() * sizeof(int));
  return ::sendmsg(to, &out.message, MSG_NOSIGNAL) == static_cast<ssize_t>(words.size());
}

/// The arguments; the descriptors are put where a group expects them.
inline std::vector<std::string> receive_hand_over(int from) {
  char words[4096];
  HandOver in(words, sizeof words, kMostDescriptors);
  pollfd wait{from, POLLIN, 0};
  ::poll(&wait, 1, 5000);
  const ssize_t size = ::recvmsg(from, &in.message, MSG_CMSG_CLOEXEC);
  const cmsghdr* header = CMSG_FIRSTHDR(&in.message);
  if (size <= 0 || !header) return {};
  std::vector<std::string> all;
  for (const char* at = words; at < words + size; at += all.back().size() + 1) all.emplace_back(at);
  for (std::size_t i = 0; i < all.front().size(); ++i) {
    int received = -1;
    std::memcpy(&received, CMSG_DATA(header) + i * sizeof received, sizeof received);
    ::dup3(received, all.front()[i] - '0', O_CLOEXEC);
    ::close(received);
  }
  all.erase(all.begin());
  return all;
}

}  // namespace fiona::peer
