#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include <fiona/error.hpp>
#include <fiona/trust/host_keys.hpp>

#include "reactor.hpp"

namespace fiona::console {

/// A host on another machine.
struct RemoteAddress {
  std::string name;     ///< as the user calls it; may be the address
  std::string address;  ///< "ADDRESS:PORT"
  trust::Key key;
};

/// Carries the stream of a console over tcp, with CURVE (control.proto, Carried), in a thread of its own: signs of life
/// go out and are missed also while the console is busy. When the host has gone, the stream ends.
class RemoteLink {
 public:
  /// Begins to connect, with this user's key pair; `control`: asks for all that its key may, and not only to look.
  /// Throws fiona::Error NotFound without a key pair.
  RemoteLink(const RemoteAddress& host, bool control);
  RemoteLink(const RemoteLink&) = delete;
  RemoteLink& operator=(const RemoteLink&) = delete;
  ~RemoteLink();

  /// Throws fiona::Error: Unreachable, or NotAllowed with what is to be done on the other machine.
  void await_welcome(Reactor& reactor, std::chrono::milliseconds timeout) const;
  /// The console's end of the stream; it stays the link's.
  int descriptor() const { return near_; }
  /// Once welcome: the host's name, and what this console may there, "observe (1)".
  const std::string& host() const { return host_; }
  const std::string& level() const { return level_; }
  /// Why the stream has ended, if that is known.
  std::string reason() const;

 private:
  class Carrier;

  void carry(const RemoteAddress& host, const trust::KeyPair& keys, bool control);
  void settle(std::optional<std::pair<ErrorCode, ErrorText>> problem);

  const std::string address_;
  int near_ = -1;
  int far_ = -1;      ///< the thread's end
  int settled_ = -1;  ///< readable once it is welcome, or never will be
  mutable std::mutex mutex_;
  bool welcome_ = false;
  std::string host_;
  std::string level_;
  std::optional<std::pair<ErrorCode, ErrorText>> problem_;
  std::string reason_;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace fiona::console
