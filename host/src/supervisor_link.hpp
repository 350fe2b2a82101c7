#pragma once

#include <sys/types.h>

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fiona/wire.pb.h"
#include "os/packet_socket.hpp"

namespace fiona::host {

/// A group that a host before this one has started, as its supervisor has kept it.
struct KeptGroup {
  wire::KeptGroup told;
  pid_t process = -1;
  os::Descriptor adoption;  ///< where it waits for a host
  os::Descriptor liveness;  ///< its page
  os::Descriptor output;    ///< what it writes can be read here
  os::Descriptor handle;    ///< its pidfd
};

/// What a host says to its supervisor, and hears from it. A packet begins with a line: a word, and for groups the
/// number of the process. All functions [control thread].
class SupervisorLink {
 public:
  /// The words. From the host: it is alive; its end is meant; why it ends, for the host after it; keep this group for
  /// that one; do so no longer.
  static constexpr std::string_view kBeat = "beat";
  static constexpr std::string_view kQuits = "quits";
  static constexpr std::string_view kEnds = "ends";
  static constexpr std::string_view kKeep = "keep";
  static constexpr std::string_view kDrop = "drop";
  /// Start the program that is installed now in this one's place; the number is for how many ms it is on trial.
  static constexpr std::string_view kUpgrade = "upgrade";
  /// From the supervisor: how a process that it was kept for has ended; there are no more groups to adopt; the host is
  /// to end for the one after it; why it is not to; it is to end for good.
  static constexpr std::string_view kEnded = "ended";
  static constexpr std::string_view kAll = "all";
  static constexpr std::string_view kMakeWay = "make way";
  static constexpr std::string_view kRefused = "refused";
  static constexpr std::string_view kEnd = "end";
  /// A host says so often that it is alive, unless it hangs.
  static constexpr std::chrono::milliseconds kBeatEvery{200};

  explicit SupervisorLink(os::PacketSocket socket) : socket_(std::move(socket)) {}

  /// The groups that are there to be adopted.
  std::vector<KeptGroup> take_kept();
  /// Called often; says so once in a while.
  void beat();
  void quits();
  void ends(const std::string& why);
  void upgrade(std::chrono::milliseconds trial);
  /// None: it has not been answered yet. Empty: the host is to end now. Otherwise why not.
  std::optional<std::string> upgrade_answer();
  /// Of one whose lifeline has ended: whether that is meant. Otherwise the supervisor has been killed.
  bool is_told_to_end();
  /// False: it does not keep it, so the group ends with this host.
  bool keep(const KeptGroup& group);
  void drop(pid_t process);
  /// "killed by signal 9 (Killed)"; empty: it has not been told yet.
  std::string end_of(pid_t process);

 private:
  void receive();
  void take(os::Packet& packet);

  os::PacketSocket socket_;
  std::chrono::steady_clock::time_point beaten_{};
  std::vector<KeptGroup> kept_;
  bool all_ = false;
  bool gone_ = false;
  bool told_to_end_ = false;
  std::map<pid_t, std::string> ends_;
  std::optional<std::string> upgrade_answer_;
};

}  // namespace fiona::host
