#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>

#include <fiona/error.hpp>

#include "fiona/control.pb.h"
#include "locations.hpp"
#include "reactor.hpp"

namespace fiona::console {

/// A length-prefixed stream (control.proto): what has arrived, cut into messages.
class FrameReader {
 public:
  static constexpr std::size_t kLargest = 16U << 20U;

  void append(std::string_view bytes) { buffer_.append(bytes); }

  /// The next whole message; false where more bytes must come first. Throws fiona::Error (Failed) where the stream
  /// announces more than 16 MiB, or bytes that are no Reply.
  bool next(control::Reply& reply);

 private:
  std::string buffer_;
  std::size_t at_ = 0;
};

/// One connection to a host. Not for several threads; everything happens inside the reactor's waits.
class ControlClient {
 public:
  using Answer = std::function<void(const control::Reply&)>;

  /// Connects; over tcp, `control` asks for all that the key may, and not only to look. Throws fiona::Error
  /// (Unreachable, NotAllowed).
  ControlClient(Reactor& reactor, Endpoint endpoint, std::chrono::milliseconds timeout, bool control = false);
  ControlClient(const ControlClient&) = delete;
  ControlClient& operator=(const ControlClient&) = delete;
  ~ControlClient();

  /// Sends and waits for the answer. Throws the host's refusal as fiona::Error with its code and texts, or
  /// Unreachable when the host is silent for the timeout or has gone.
  control::Reply call(control::Request request);
  control::Reply call(control::Request request, std::chrono::milliseconds timeout);

  /// For requests that wait on the system's clock, which may stand or run slowly: no deadline of its own, but while
  /// nothing comes the host is asked for a sign of life, and Unreachable is thrown when it gives none. At Interrupted
  /// the request is given up. Throws RunEnded where the run ends first.
  control::Reply call_waiting(control::Request request);

  /// Sends; `answer` gets every reply to it until forget(). Returns the request's id.
  std::uint64_t begin(control::Request request, Answer answer);
  void forget(std::uint64_t id) { answers_.erase(id); }

  /// Sends, and nobody waits for the answer.
  void tell(control::Request request);

  /// Whether the host has closed the connection; `on_closed` is called when it does.
  bool closed() const { return socket_ < 0; }
  void on_closed(std::function<void()> callback) { on_closed_ = std::move(callback); }

  void set_timeout(std::chrono::milliseconds timeout) { timeout_ = timeout; }
  void set_author(std::string author) { author_ = std::move(author); }
  const Endpoint& endpoint() const { return endpoint_; }
  /// Null unless it goes over tcp.
  const RemoteLink* remote() const { return remote_.get(); }
  /// "the host has gone", and why, if that is known.
  std::string farewell() const;

 private:
  void connect(bool control);
  void connect_here();
  void send(const control::Request& request);
  void receive();
  void close();
  void arrived(const control::Reply& reply);
  void give_up(std::uint64_t id);
  control::Reply wait_for(std::uint64_t id, const control::Reply& reply, const bool& here, SteadyTime deadline);

  Reactor& reactor_;
  const Endpoint endpoint_;
  std::chrono::milliseconds timeout_;
  std::string author_ = "console";
  std::unique_ptr<RemoteLink> remote_;  ///< owns the socket
  int socket_ = -1;
  std::uint64_t last_id_ = 0;
  FrameReader frames_;
  std::map<std::uint64_t, Answer> answers_;
  std::optional<control::Failure> refusal_;  ///< of the connection itself
  std::function<void()> on_closed_;
};

/// The run has ended while something else was waited for.
class RunEnded : public Error {
 public:
  explicit RunEnded(const control::Ended& end);
  const control::Ended& end() const { return end_; }

 private:
  control::Ended end_;
};

/// The host's refusal as the error that it is.
/// A refusal of one change of a transaction.
class RefusedChange : public Error {
 public:
  RefusedChange(ErrorCode code, ErrorText text, std::size_t change) : Error(code, std::move(text)), change_(change) {}
  /// Which one, from 1; 0: none in particular.
  std::size_t change() const { return change_; }

 private:
  std::size_t change_;
};

[[noreturn]] void throw_failure(const control::Failure& failure);

}  // namespace fiona::console
