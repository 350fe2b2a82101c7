#include "scripted_host.hpp"

#include <array>
#include <cstdlib>
#include <cstring>
#include <stdexcept>

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

namespace fiona::console {

std::string framed(const std::string& body) {
  std::string frame;
  for (std::size_t i = 0; i < 4; ++i) frame += static_cast<char>(body.size() >> (8 * i) & 0xffU);
  return frame + body;
}

ScriptedHost::ScriptedHost(Script script) : socket_(directory_.path / "main.sock"), script_(std::move(script)) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, socket_.c_str(), socket_.native().size());
  listener_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool bound = ::bind(listener_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  if (!bound || ::listen(listener_, 8) != 0) throw std::runtime_error("the scripted host cannot listen");
  std::array<int, 2> ends{};
  if (::pipe(ends.data()) != 0) throw std::runtime_error("pipe");
  stop_read_ = ends[0];
  stop_write_ = ends[1];
  thread_ = std::thread([this] { serve(); });
}

ScriptedHost::~ScriptedHost() {
  ::close(stop_write_);
  thread_.join();
  ::close(stop_read_);
  ::close(listener_);
}

void ScriptedHost::serve() {
  while (true) {
    std::array<pollfd, 2> waiting{pollfd{listener_, POLLIN, 0}, pollfd{stop_read_, POLLIN, 0}};
    if (::poll(waiting.data(), waiting.size(), -1) < 0 || waiting[1].revents != 0) return;
    const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    if (client >= 0) serve_client(client);
  }
}

void ScriptedHost::serve_client(int client) {
  std::string received;
  while (true) {
    std::array<pollfd, 2> waiting{pollfd{client, POLLIN, 0}, pollfd{stop_read_, POLLIN, 0}};
    if (::poll(waiting.data(), waiting.size(), -1) < 0 || waiting[1].revents != 0) break;
    std::array<char, 4096> chunk;
    const ssize_t count = ::recv(client, chunk.data(), chunk.size(), 0);
    if (count <= 0) break;
    received.append(chunk.data(), static_cast<std::size_t>(count));
    while (received.size() >= 4) {
      std::uint32_t length = 0;
      for (std::size_t i = 0; i < 4; ++i) length |= std::uint32_t{static_cast<unsigned char>(received[i])} << (8 * i);
      if (received.size() < 4 + length) break;
      control::Request request;
      request.ParseFromArray(received.data() + 4, static_cast<int>(length));
      received.erase(0, 4 + length);
      std::string out = std::exchange(raw_first, {});
      for (control::Reply& reply : script_(request)) {
        if (reply.id() == 0) reply.set_id(request.id());
        out += framed(reply.SerializeAsString());
      }
      // One byte first: a client must not count on messages arriving whole.
      if (!out.empty()) ::send(client, out.data(), 1, MSG_NOSIGNAL);
      if (out.size() > 1) ::send(client, out.data() + 1, out.size() - 1, MSG_NOSIGNAL);
    }
    if (hang_up) break;
  }
  ::close(client);
}

}  // namespace fiona::console
