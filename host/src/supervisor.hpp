#pragma once

#include <chrono>
#include <deque>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "host_program.hpp"
#include "os/packet_socket.hpp"
#include "os/process.hpp"
#include "supervision.hpp"

namespace fiona::host {

/// Starts a host, sees it end or hang, and starts it again with the system of its journal; keeps what its groups can be
/// adopted by meanwhile. A build of the host that has been put in the place of the one that runs is started when it is
/// asked for, and taken back when it does not go on. It has one thread, no link and no plugin, and understands nothing
/// of what it keeps. Who ends when whom: docs/decisions/0020; which build is started: 0023.
class Supervisor {
 public:
  using Time = std::chrono::steady_clock::time_point;
  using milliseconds = std::chrono::milliseconds;
  struct Options {
    std::filesystem::path host;
    std::vector<std::string> arguments{};  ///< of the host, as they were given
    std::string after_end{};               ///< why there is no host any more of which the first one is the next
    os::Descriptor ready{};                ///< gets what the first host says of its start
    os::Descriptor lifeline{};             ///< its end ends all
    /// A host that has said nothing for so long hangs. Longer than the end of an instance in `main` may take, which is
    /// two calls of its life cycle.
    milliseconds hang{25'000};
  };
  /// A build that is on trial, to say that it is alive.
  static constexpr milliseconds kFirstSign{4000};
  /// For a host to end in whose place another one takes.
  static constexpr milliseconds kMakesWayWithin{25'000};
  /// How long a build is on trial, where nobody has said.
  static constexpr milliseconds kTrial{10'000};
  /// For the host to end in, then for whatever is left.
  static constexpr milliseconds kEndsWithin{4000};
  static constexpr milliseconds kRestWithin{500};
  /// Of the time since it looked last no more counts: a machine that stood still makes nobody hang.
  static constexpr milliseconds kLook{500};

  explicit Supervisor(Options options)
      : options_(std::move(options)),
        program_(options_.host),
        starts_(options_.after_end.empty() ? 0 : 1),
        reason_(options_.after_end) {}
  /// Until the host's end is meant, or it has ended too often. `signals`: SIGTERM and SIGINT as a descriptor. The exit
  /// code.
  int run(int signals);

 private:
  /// Of a group: what it was kept with.
  struct Kept {
    std::string text;
    std::vector<os::Descriptor> descriptors;
    bool orphan = false;  ///< its host has gone: it is this process's child
    std::string end;      ///< once it has ended
  };
  /// What waits for room in the socket.
  struct Outgoing {
    std::string text;
    pid_t kept = 0;  ///< instead: this group
  };

  void start(Time now);
  std::optional<int> start_again(Time now);
  std::optional<int> start_later(const std::string& what, Time now);
  std::optional<int> look(int signals);
  void forward_ready();
  void serve_host();
  void take(os::Packet& packet);
  void pass_on();
  void begin_upgrade(milliseconds trial, Time now);
  void look_at_check(Time now);
  void look_at_trial(Time now);
  void refuse_upgrade(const std::string& why);
  void take_back(const std::string& end);
  void end_if_hung(Time now);
  void reap_orphans();
  std::optional<int> host_ended(Time now);
  void stop(Time now);
  int end_all(int code);
  int wait_ms(Time now) const;

  Options options_;
  HostProgram program_;
  std::unique_ptr<ProgramCheck> check_;  ///< of the program that is to take the host's place
  std::optional<Time> makes_way_;        ///< until then the host ends for the one after it
  std::optional<Time> tried_until_;      ///< a build that is on trial
  milliseconds trial_ = kTrial;
  milliseconds asked_trial_ = kTrial;  ///< of the program that is checked
  bool heard_ = false;                 ///< of this host
  bool taken_back_ = false;            ///< the next one is of the build before
  std::uint64_t starts_ = 0;           ///< of hosts
  Supervision supervision_;
  std::unique_ptr<os::ChildProcess> host_;
  os::PacketSocket link_;
  os::Descriptor ready_;     ///< what the host says of its start
  os::Descriptor lifeline_;  ///< its end ends the host
  std::string said_ready_;
  bool was_ready_ = false;  ///< a host of ours
  bool quits_ = false;      ///< its end is meant
  std::optional<Time> stopping_;
  std::optional<Time> due_;
  Time looked_{};
  milliseconds silent_{0};
  std::string why_;       ///< we have ended it; empty: it ended by itself
  std::string said_why_;  ///< by itself; empty: it has not said
  std::string reason_;
  std::map<pid_t, Kept> kept_;
  std::deque<Outgoing> outgoing_;
  bool crowded_ = false;  ///< it waits, but not for room
};

}  // namespace fiona::host
