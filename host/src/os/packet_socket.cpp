#include "os/packet_socket.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <thread>

#include "fiona/error.hpp"

namespace fiona::os {
namespace {

constexpr std::size_t kControlBytes = CMSG_SPACE(PacketSocket::kMaxDescriptors * sizeof(int));

bool wait_for(int socket, short events, std::chrono::steady_clock::time_point deadline) {
  while (true) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now()).count();
    pollfd wait{socket, events, 0};
    const int ready = ::poll(&wait, 1, static_cast<int>(std::clamp<std::int64_t>(left, 0, 60'000)));
    if (ready > 0) return true;
    if (left <= 0) return false;
  }
}

void take_descriptors(msghdr& message, std::vector<Descriptor>& into) {
  for (cmsghdr* one = CMSG_FIRSTHDR(&message); one; one = CMSG_NXTHDR(&message, one)) {
    if (one->cmsg_level != SOL_SOCKET || one->cmsg_type != SCM_RIGHTS) continue;
    const std::size_t count = (one->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    for (std::size_t i = 0; i < count; ++i) {
      int number = -1;
      std::memcpy(&number, CMSG_DATA(one) + i * sizeof(int), sizeof number);
      into.emplace_back(number);
    }
  }
}

}  // namespace

PacketSocket::PacketSocket(Descriptor socket) : socket_(std::move(socket)) {
  ::fcntl(socket_.get(), F_SETFL, ::fcntl(socket_.get(), F_GETFL) | O_NONBLOCK);
}

std::pair<PacketSocket, PacketSocket> PacketSocket::pair() {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0) {
    throw Error(ErrorCode::Failed,
                {.what = "no socket pair can be made",
                 .found = std::strerror(errno),
                 .next = "fiona doctor; end what holds many descriptors, or raise the limit: ulimit -n"});
  }
  return {PacketSocket(Descriptor(ends[0])), PacketSocket(Descriptor(ends[1]))};
}

PacketSocket::Sent PacketSocket::send(std::string_view text, const std::vector<int>& descriptors) const {
  if (text.empty() || text.size() > kMaxText || descriptors.size() > kMaxDescriptors) return Sent::Gone;
  iovec part{const_cast<char*>(text.data()), text.size()};
  alignas(cmsghdr) char control[kControlBytes] = {};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(descriptors.size() * sizeof(int));
    cmsghdr* const head = CMSG_FIRSTHDR(&message);
    head->cmsg_level = SOL_SOCKET;
    head->cmsg_type = SCM_RIGHTS;
    head->cmsg_len = CMSG_LEN(descriptors.size() * sizeof(int));
    std::memcpy(CMSG_DATA(head), descriptors.data(), descriptors.size() * sizeof(int));
  }
  ssize_t sent = -1;
  do sent = ::sendmsg(socket_.get(), &message, MSG_NOSIGNAL | MSG_DONTWAIT);
  while (sent < 0 && errno == EINTR);
  if (sent >= 0) return Sent::Yes;
  if (errno == ETOOMANYREFS) return Sent::Crowded;
  return errno == EAGAIN || errno == EWOULDBLOCK ? Sent::Full : Sent::Gone;
}

bool PacketSocket::send_within(std::chrono::milliseconds time, std::string_view text,
                               const std::vector<int>& descriptors) const {
  const auto deadline = std::chrono::steady_clock::now() + time;
  while (true) {
    const Sent sent = send(text, descriptors);
    if (sent == Sent::Yes || sent == Sent::Gone) return sent == Sent::Yes;
    if (sent == Sent::Crowded) {
      if (std::chrono::steady_clock::now() >= deadline) return false;
      std::this_thread::sleep_for(kCrowded);
      continue;
    }
    if (!wait_for(socket_.get(), POLLOUT, deadline)) return false;
  }
}

PacketSocket::Got PacketSocket::receive(Packet& packet) const {
  packet = {};
  packet.text.resize(kMaxText);
  iovec part{packet.text.data(), packet.text.size()};
  alignas(cmsghdr) char control[kControlBytes] = {};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  ssize_t got = -1;
  do got = ::recvmsg(socket_.get(), &message, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
  while (got < 0 && errno == EINTR);
  packet.text.resize(static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
  if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return Got::Nothing;
  if (got <= 0) return Got::End;
  take_descriptors(message, packet.descriptors);
  if ((message.msg_flags & MSG_CTRUNC) != 0) packet.descriptors.clear();
  return Got::Packet;
}

bool PacketSocket::receive_until(std::chrono::steady_clock::time_point deadline, Packet& packet) const {
  while (true) {
    const Got got = receive(packet);
    if (got != Got::Nothing) return got == Got::Packet;
    if (!wait_for(socket_.get(), POLLIN, deadline)) return false;
  }
}

}  // namespace fiona::os
