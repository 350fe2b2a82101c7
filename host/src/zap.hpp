#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <zmq.hpp>

#include "fiona/trust/host_keys.hpp"

namespace fiona::host {

/// Answers libzmq's question who may connect (ZAP 1.0, rfc.zeromq.org/spec/27): the keys of a list, which is read anew
/// for each connection. Whoever is let in is known by his key for as long as the connection lasts: the list may give
/// his name to another one meanwhile.
class Zap {
 public:
  using OnRefused = std::function<void(const std::string& text)>;
  /// Whom it lets in.
  struct Policy {
    std::function<bool(const trust::Key&)> has;  ///< it is in the list. Throws Error if that cannot be read
    std::string noun;                            ///< "host"
    std::string command;                         ///< what lets one in, but for its key
  };
  static Policy hosts(trust::KeyDirectory keys);
  static Policy consoles(trust::KeyDirectory keys);

  /// Before any socket of `context` listens with CURVE. `on_refused` hears of refusals at most every 5 s.
  Zap(zmq::context_t& context, Policy policy, OnRefused on_refused);

  zmq::socket_t& socket() { return socket_; }
  /// [one thread] Answers what has been asked.
  void serve();
  /// [any thread] Connections refused so far.
  std::uint64_t refused() const { return refused_.load(); }

 private:
  std::string user_of(const std::string& credentials, std::string& why) const;
  void note_refusal(const std::string& address, const std::string& credentials, const std::string& why);

  const Policy policy_;
  const OnRefused on_refused_;
  zmq::socket_t socket_;
  std::atomic<std::uint64_t> refused_{0};
  std::chrono::steady_clock::time_point told_{};
};

}  // namespace fiona::host
