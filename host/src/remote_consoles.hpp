#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "access.hpp"
#include "fiona/trust/host_keys.hpp"
#include "os/descriptor.hpp"
#include "zap.hpp"

namespace fiona::host {

/// Consoles over tcp, with CURVE: each is given to whoever serves consoles as a stream socket, like one that has
/// connected on this machine, and what goes over that is carried (control.proto, Carried). A console that is slow is
/// felt there as a socket that is full; nothing more than a chunk of it waits here.
class RemoteConsoles {
 public:
  /// At once; further ones are turned away with a sentence.
  static constexpr std::size_t kMost = 32;
  /// A console that has said nothing for so long is gone.
  static constexpr std::chrono::milliseconds kSilence{5000};

  using OnConsole = std::function<void(os::Descriptor socket, const Rights& rights)>;
  using OnLog = std::function<void(const std::string& text)>;

  /// Serves at "tcp://ADDRESS:PORT"; port 0: one that is free. `name` is the host's. Throws Error: without keys, or
  /// with the system's reason. The callbacks come from a thread of its own.
  RemoteConsoles(const std::string& address, const trust::KeyDirectory& keys, const std::string& name,
                 OnConsole on_console, OnLog on_log);
  /// Hands on what the sockets still have, and tells the consoles.
  ~RemoteConsoles();

  /// With the port that was chosen.
  const std::string& address() const { return address_; }
  /// [any thread] Fills in what there is to tell of it.
  void describe(control::System& system) const;

 private:
  struct Console;
  enum class Sent { Yes, Full, Gone };

  void serve();
  void wait();
  void receive();
  void take(const std::string& id, const zmq::message_t& message);
  void begin(const std::string& id, const control::ConsoleHello& hello, const zmq::message_t& message);
  bool hand_to_server(Console& console, const std::string& bytes);
  bool carry_from_server(const std::string& id, Console& console);
  void tick(std::chrono::steady_clock::time_point now);
  void tell(std::chrono::steady_clock::time_point now);
  void check_levels();
  void end(const std::string& id, const std::string& reason, bool at_fault = false);
  void refuse(const std::string& id, const std::string& reason);
  Sent send(const std::string& id, const control::Carried& carried);

  const trust::KeyDirectory keys_;
  const std::string name_;
  const OnConsole on_console_;
  std::string key_;  ///< of this host
  std::string address_;
  zmq::context_t context_;
  Zap zap_;
  zmq::socket_t socket_;
  std::map<std::string, Console> consoles_;  ///< by the number of its connection
  mutable std::mutex mutex_;                 ///< of told_
  std::vector<control::ConsoleStatus> told_;
  std::atomic<std::uint64_t> turned_away_{0};
  std::atomic<std::uint64_t> ended_{0};
  std::chrono::steady_clock::time_point now_ = std::chrono::steady_clock::now();
  std::chrono::steady_clock::time_point checked_{};
  std::chrono::steady_clock::time_point spoke_{};
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace fiona::host
