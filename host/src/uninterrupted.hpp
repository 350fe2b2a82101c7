#pragma once

#include <cerrno>
#include <string>
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
#define FIONA_NOT_WATCHED __attribute__((no_sanitize("thread")))
#else
inline void given_to_zmq() {}
inline void got_from_zmq() {}
#define FIONA_NOT_WATCHED
#endif

/// What ZeroMQ says of a message ("User-Id"), in memory that a thread of its own has written; empty: nothing.
FIONA_NOT_WATCHED inline std::string property_of(zmq::message_t& message, const char* name) {
  std::string text;
  for (const char* at = zmq_msg_gets(message.handle(), name); at && *at; ++at) text.push_back(*at);
  return text;
}

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
