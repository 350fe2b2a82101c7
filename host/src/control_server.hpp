#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "access.hpp"
#include "engine.hpp"
#include "instance_events.hpp"
#include "mailbox.hpp"
#include "masters.hpp"
#include "os/message_stream.hpp"
#include "os/read_pages.hpp"
#include "os/unix_socket.hpp"
#include "remote_consoles.hpp"
#include "system.hpp"

namespace fiona::host {

/// Serves the control protocol on a unix socket, and over tcp where it is told to: the one thread that changes the
/// system. Requests are done in the order in which they come; answers to waits and watches come when they come. What a
/// client may ask for follows from its level; those on the unix socket are the host's own user, and may everything.
class ControlServer {
 public:
  /// `restore`: begins with the system that the journal ends with. Without a place for it, it is kept beside the
  /// socket.
  ControlServer(const std::filesystem::path& socket, System::Options options, bool restore = false,
                const std::filesystem::path& journal = {});
  ~ControlServer();

  /// Until the hosts that this one leads are there, or have been tried in vain, or do not answer within two seconds:
  /// what is loaded in them next finds them.
  void meet_peers(int lifeline, int signals);
  /// Serves until `quit`, the end of the lifeline (-1: none), or SIGINT/SIGTERM through `signals` (-1: none).
  /// The exit code of the run, which `ends` is told before instances have their end: that may take them long.
  int serve(int lifeline, int signals, const std::function<void(int code)>& ends = {});
  /// Whether its end was meant; another end is one that a supervisor mends.
  bool was_ended() const { return was_ended_; }
  /// Whether components keep threads, which nobody can end.
  bool has_kept_threads() const { return system_.kept_threads() > 0; }
  /// Where it listens for a host that leads; empty: nowhere.
  std::string listens() const { return system_.listens(); }
  /// Where it serves consoles over tcp; empty: nowhere.
  std::string serves() const { return remote_ ? remote_->address() : ""; }

 private:
  struct Client;
  struct Watched {
    std::uint64_t client = 0;
    std::uint64_t request = 0;
    Gaps gaps{};
    bool described = false;
    std::optional<wire::Tapped> held{};      ///< the newest, of a client that is slow
    std::optional<control::Failure> over{};  ///< told behind that
  };
  struct Outgoing {
    std::uint64_t client = 0;
    control::Reply reply;
  };

  std::unique_ptr<RemoteConsoles> serve_remote(const System::Options& options);
  void accept_clients();
  void turn_away(os::Descriptor socket);
  void add_client(os::Descriptor socket, Rights rights);
  void serve_client(std::uint64_t id);
  void drop_client(std::uint64_t id);
  void refuse_garbled(std::uint64_t client, const std::string& found);
  void perform(std::uint64_t client, const control::Request& request);
  /// False when the answer comes later.
  bool dispatch(std::uint64_t client, const control::Request& request, control::Reply& reply);
  void start_watch(std::uint64_t client, const control::Request& request);
  void give_up(std::uint64_t client, std::uint64_t request);
  bool stop_watch(std::uint64_t client, std::uint64_t request);
  void start_expect(std::uint64_t client, const control::Request& request);
  bool start_wait_mode(std::uint64_t client, const control::Request& request, control::Reply& reply);
  Waits::Answer answer_to(std::uint64_t client, std::uint64_t request);
  void send_last(std::uint64_t client, const control::Reply& reply);
  void forget_open(std::uint64_t client, std::uint64_t request);
  void restore(const std::filesystem::path& journal);
  void end_instances();
  void end(int code, const std::string& why);
  void send(std::uint64_t client, const control::Reply& reply);
  void on_wire_lost(const wire::WireLost& lost);
  void on_event(const wire::GroupMessage& event);
  void write_record(const std::string& instance, const std::string& text);
  void on_tapped(const wire::Tapped& tapped);
  void on_tap_ended(const wire::TapEnded& ended);
  std::optional<wire::Tapped> take_held(Watched& watch);
  void send_held();
  void tell_over(std::uint64_t tap);
  void send_sample(Watched& watch, Client& client, const wire::Tapped& tapped);
  control::Sample described_sample(const wire::Tapped& tapped);
  void begin_upgrade(std::uint64_t client, const control::Request& request);
  void go_on_with_upgrade();
  void poll_once(int lifeline, int signals, int most_ms = -1);
  void attempt(const std::function<void()>& work);

  // Mailboxes outlive the system, whose threads post to them until it is gone.
  Mailbox<wire::GroupMessage> events_;
  Mailbox<Outgoing> outgoing_;
  Mailbox<std::function<void()>> work_;  ///< for the control thread
  os::UnixListener listener_;
  std::unique_ptr<RemoteConsoles> remote_;
  System system_;
  std::optional<Journal::Told> told_;  ///< by the journal of the host before; until it is restored
  Engine engine_;
  Masters masters_;
  std::map<std::uint64_t, std::unique_ptr<Client>> clients_;
  std::map<std::string, LineAllowance> said_;                                     ///< by instance
  std::map<std::uint64_t, Watched> watches_;                                      ///< by tap
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::uint64_t> expect_taps_;  ///< (client, request) -> tap
  std::map<std::uint64_t, std::pair<std::uint64_t, std::uint64_t>> attached_;     ///< wire -> (client, request)
  os::ReadPages read_pages_;
  std::uint64_t next_client_ = 1;
  std::uint64_t garbled_ = 0;  ///< connections closed for what came over them
  std::uint64_t faults_ = 0;   ///< pieces of work that have thrown
  std::optional<int> exit_code_;
  std::string end_reason_;
  bool was_ended_ = false;
  std::optional<std::pair<std::uint64_t, std::uint64_t>> upgrade_;  ///< (client, request) that has asked for one
  std::optional<std::chrono::steady_clock::time_point> makes_way_;  ///< for the next host, of another build: since then
};

}  // namespace fiona::host
