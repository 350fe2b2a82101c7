#pragma once

#include <cerrno>
#include <zmq.hpp>

namespace fiona::host {

/// ZeroMQ gives up what a signal interrupts, and has done none of it: asked again. Which signals there are is up to the
/// components and to whoever profiles them.
template <class Call>
auto uninterrupted(const Call& call) {
  while (true) {
    try {
      return call();
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) throw;
    }
  }
}

/// Whether there was a message, or a further part.
inline bool received(zmq::socket_t& socket, zmq::message_t& message) {
  return uninterrupted([&] { return socket.recv(message, zmq::recv_flags::dontwait).has_value(); });
}

/// Whether it was taken. Throws zmq::error_t.
template <class Bytes>
bool sent(zmq::socket_t& socket, Bytes&& bytes, zmq::send_flags more = zmq::send_flags::none) {
  return uninterrupted([&] { return socket.send(bytes, more | zmq::send_flags::dontwait).has_value(); });
}

}  // namespace fiona::host
