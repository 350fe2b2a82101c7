#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "mailbox.hpp"
#include "os/message_stream.hpp"
#include "os/unix_socket.hpp"
#include "system.hpp"

namespace fiona::host {

/// Serves the control protocol on a unix socket: the one thread that changes the system. Requests are done in the order
/// in which they come; answers to waits and watches come when they come.
class ControlServer {
 public:
  ControlServer(const std::filesystem::path& socket, System::Options options);
  ~ControlServer();

  /// Serves until `quit`, the end of the lifeline (-1: none), or SIGINT/SIGTERM through `signals` (-1: none).
  /// The exit code of the run.
  int serve(int lifeline, int signals);
  /// Where it listens for a host that leads; empty: nowhere.
  std::string listens() const { return system_.listens(); }

 private:
  struct Client;
  struct WatchedPort {
    std::uint64_t client = 0;
    std::uint64_t request = 0;
    double min_period_ms = 0;
    double last_ms = -1e18;
    std::uint64_t skipped = 0;
    bool described = false;
  };
  struct Outgoing {
    std::uint64_t client = 0;
    control::Reply reply;
  };

  void accept_clients();
  void serve_client(std::uint64_t id);
  void drop_client(std::uint64_t id);
  void perform(std::uint64_t client, const control::Request& request);
  /// False when the answer comes later.
  bool dispatch(std::uint64_t client, const control::Request& request, control::Reply& reply);
  void start_watch(std::uint64_t client, const control::Request& request);
  void stop_watch(std::uint64_t client, std::uint64_t request);
  void start_expect(std::uint64_t client, const control::Request& request);
  bool start_wait_mode(std::uint64_t client, const control::Request& request, control::Reply& reply);
  Waits::Answer answer_to(std::uint64_t client);
  void send(std::uint64_t client, const control::Reply& reply);
  void on_event(const wire::GroupMessage& event);
  void on_tapped(const wire::Tapped& tapped);
  void poll_once(int lifeline, int signals);

  // Mailboxes outlive the system, whose threads post to them until it is gone.
  Mailbox<wire::GroupMessage> events_;
  Mailbox<Outgoing> outgoing_;
  os::UnixListener listener_;
  System system_;
  std::map<std::uint64_t, std::unique_ptr<Client>> clients_;
  std::map<std::uint64_t, WatchedPort> watches_;  ///< by tap
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::uint64_t> expect_taps_;  ///< (client, request) -> tap
  std::uint64_t next_client_ = 1;
  std::optional<int> exit_code_;
};

}  // namespace fiona::host
