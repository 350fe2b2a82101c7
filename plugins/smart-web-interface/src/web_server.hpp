#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "board.hpp"
#include "local_authority.hpp"
#include "web_request.hpp"

namespace fiona::smart_web_interface {

struct WebReply {
  int status = 200;
  std::string json{};
};

/// The duty to answer one request, from any thread; dropped, the page is told that there is no answer.
class Responder {
 public:
  explicit Responder(std::function<void(WebReply)> send) : send_(std::move(send)) {}
  Responder(const Responder&) = delete;
  Responder& operator=(const Responder&) = delete;
  ~Responder();
  void answer(WebReply reply);

 private:
  std::function<void(WebReply)> send_;
};

/// An HTTP server in a thread of its own: the page's files, its calls, and streams of what is on the board.
///
/// Bounds: connections, the size of a request, the time for one from its first byte to its last, the time to take an
/// answer, and how long a connection is kept without a request. A stream that is slow skips
/// what was replaced meanwhile, and ends when nothing of it is taken for 10 s.
class WebServer {
 public:
  static constexpr std::size_t kMaxConnections = 64;
  /// From one address other than this machine's own: a browser has six.
  static constexpr std::size_t kMaxOfSource = 16;

  struct Settings {
    std::string address;
    std::uint16_t port = 0;                    ///< 0: a free one
    std::optional<ServerProof> proof{};        ///< with it the server speaks TLS; without, to its own machine only
    std::map<std::string, std::string> files;  ///< by name: "index.html"
    Board& board;
    /// [the server's thread] A call of a page; `from` is the address it comes from.
    std::function<void(ApiCall call, std::string from, std::shared_ptr<Responder> respond)> on_call;
    /// [the server's thread]
    std::function<bool(const std::string& bearer)> is_open;
    std::chrono::milliseconds request_time{10'000};  ///< also for the first byte of the first request
    std::chrono::milliseconds idle_time{30'000};
  };

  /// Whether an address is this machine's alone. Throws Error (Usage) for what is no numeric address, or for all of a
  /// machine's at once: a certificate is for one.
  static bool is_loopback(const std::string& address);

  /// Listens when this returns. Throws Error (Failed) where it cannot, Usage for an address that others reach without a
  /// proof.
  explicit WebServer(Settings settings);
  ~WebServer();
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  std::uint16_t port() const;
  /// "http://127.0.0.1:8080", "https://192.168.1.20:8080"
  std::string url() const;
  /// [any thread]
  std::size_t connections() const;

 private:
  class Impl;
  class Connection;
  template <class Stream>
  class ConnectionOver;
  std::shared_ptr<Impl> impl_;  ///< shared with connections, which end after it has asked them to
};

}  // namespace fiona::smart_web_interface
