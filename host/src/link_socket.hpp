#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <zmq.hpp>

#include "fiona/message.hpp"
#include "fiona/pool.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// One ZeroMQ socket that several threads send through, and that the pool reads when something has come.
///
/// A message is [peer's identity, on a listening socket] then one part: the frame's length in 4 bytes little endian,
/// the frame, the object. The sending strand's thread sends; a pool thread receives. There is no link thread.
class LinkSocket {
 public:
  using OnFrame = std::function<void(const std::string& peer, const wire::Frame& frame, std::string_view object)>;

  LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, OnFrame on_frame);
  ~LinkSocket();

  zmq::socket_t& socket() { return socket_; }
  /// Starts reading; call once the socket is bound or connected.
  void start();
  /// Stops reading and closes: after it returned `on_frame` is not called any more. What has been sent and has not left
  /// yet may do so for as long as `linger`.
  void stop(std::chrono::milliseconds linger = {});
  /// [any thread] Sends a frame with an object (null: none). Never waits: what bounds the queue is each wire's credit.
  void send(const std::string& peer, const wire::Frame& frame, const Object* object);
  /// [any thread] The same for an object that is passed on as it came.
  void forward(const std::string& peer, const wire::Frame& frame, std::string_view object);
  /// [any thread] Handles what waits, on this thread: for whoever must not depend on the pool's threads being free.
  void read_now() { drain(); }
  /// [in on_frame] Who the sender has proved to be; empty where the socket does not ask.
  std::string sender() const;

 private:
  struct Drain;
  void drain();
  void send_body(const std::string& peer, zmq::message_t& body);
  bool receive(std::unique_lock<std::mutex>& lock, std::string& peer, zmq::message_t& body);
  void dispatch(const std::string& peer, const zmq::message_t& body);
  bool has_input();

  Pool& pool_;
  const OnFrame on_frame_;
  std::mutex mutex_;          ///< the socket's
  std::mutex drain_mutex_;    ///< one reader at a time keeps the order
  zmq::socket_t socket_;
  std::shared_ptr<Drain> drain_;
  std::unique_ptr<Pool::Readable> watch_;
  const zmq::message_t* current_ = nullptr;  ///< the message being handled
  bool stopped_ = false;
  const bool routed_;
};

}  // namespace fiona::host
