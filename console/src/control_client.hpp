#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <string_view>

#include <fiona/error.hpp>

#include "fiona/control.pb.h"
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

  /// Connects to the unix socket. Throws fiona::Error (Unreachable).
  ControlClient(Reactor& reactor, std::filesystem::path socket, std::chrono::milliseconds timeout);
  ControlClient(const ControlClient&) = delete;
  ControlClient& operator=(const ControlClient&) = delete;
  ~ControlClient();

  /// Sends and waits for the answer. Throws the host's refusal as fiona::Error with its code and texts, or
  /// Unreachable when the host is silent for the timeout or has gone.
  control::Reply call(control::Request request);
  control::Reply call(control::Request request, std::chrono::milliseconds timeout);

  /// For requests that wait on the system's clock, which may stand or run slowly: no deadline of its own, but while
  /// nothing comes the host is asked for a sign of life, and Unreachable is thrown when it gives none.
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
  const std::filesystem::path& path() const { return path_; }

 private:
  void connect(std::chrono::milliseconds timeout);
  void send(const control::Request& request);
  void receive();
  void close();
  void arrived(const control::Reply& reply);
  control::Reply wait_for(std::uint64_t id, const control::Reply& reply, const bool& here, SteadyTime deadline);

  Reactor& reactor_;
  const std::filesystem::path path_;
  std::chrono::milliseconds timeout_;
  std::string author_ = "console";
  int socket_ = -1;
  std::uint64_t last_id_ = 0;
  FrameReader frames_;
  std::map<std::uint64_t, Answer> answers_;
  std::function<void()> on_closed_;
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
