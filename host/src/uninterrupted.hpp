#pragma once

#include <cerrno>
#include <zmq.hpp>

#ifdef __has_feature
#if __has_feature(thread_sanitizer)
#define FIONA_WATCHES_THREADS 1
#include <sanitizer/tsan_interface.h>
#endif
#endif

namespace fiona::host {

// ThreadSanitizer does not see how libzmq, which is not instrumented, hands from one thread to another what it is
// given: it is told that what came before a message went in came before whatever comes out.
#ifdef FIONA_WATCHES_THREADS
inline char through_zmq;
inline void given_to_zmq() { __tsan_release(&through_zmq); }
inline void got_from_zmq() { __tsan_acquire(&through_zmq); }
#else
inline void given_to_zmq() {}
inline void got_from_zmq() {}
#endif

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
  const bool came = uninterrupted([&] { return socket.recv(message, zmq::recv_flags::dontwait).has_value(); });
  got_from_zmq();
  return came;
}

/// Whether it was taken. Throws zmq::error_t.
template <class Bytes>
bool sent(zmq::socket_t& socket, Bytes&& bytes, zmq::send_flags more = zmq::send_flags::none) {
  given_to_zmq();
  return uninterrupted([&] { return socket.send(bytes, more | zmq::send_flags::dontwait).has_value(); });
}

}  // namespace fiona::host
