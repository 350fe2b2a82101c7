#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include "reactor.hpp"

namespace fiona::console {

struct HostLaunch {
  std::filesystem::path program;
  std::filesystem::path socket;
  std::string name;
  std::filesystem::path store;                ///< empty: the user's
  std::filesystem::path unsigned_packages{};  ///< a store of what nobody signs for; empty: none
  std::string listen{};                       ///< "ADDRESS:PORT"; empty: not over tcp
  std::string serve{};                        ///< "ADDRESS:PORT" for consoles; empty: none over tcp
  std::string registry{};                     ///< "http://HOST:PORT" of an etcd; empty: none
  std::vector<std::string> peers{};           ///< "NAME=ADDRESS:PORT=KEY", "NAME=KEY"
  std::vector<std::string> limits{};          ///< of its groups, as the words that it is given
  bool restore = false;                       ///< begins with the system of its last journal
  std::string after_end{};                    ///< with `restore`: how the one before has ended
  bool supervised = false;                    ///< by a process between, which starts it again
  std::filesystem::path journal{};            ///< empty: beside the socket
};

/// A host that this process started, or its supervisor. It ends when this process does: it watches the lifeline, a pipe
/// whose other end only this process holds.
class HostProcess {
 public:
  using OnLine = std::function<void(const std::string&)>;

  /// Starts it and waits until it is ready. What it says later goes to `on_line`, line by line. Throws its own words as
  /// fiona::Error if it does not come up, Unreachable after 10 s.
  HostProcess(Reactor& reactor, const HostLaunch& launch, OnLine on_line);
  HostProcess(const HostProcess&) = delete;
  HostProcess& operator=(const HostProcess&) = delete;
  ~HostProcess();

  /// Lets go of the lifeline and waits; kills it if it has not ended after 5 s, and waits 2 s more: what is still there
  /// then is told, and left. The exit code; 128 + signal.
  int stop();
  bool running();
  /// Whether a supervisor has been killed: what it has left is gone once `stop` returns.
  bool was_killed() const { return supervised_ && was_killed_; }
  /// An exit code above 128 may be meant.
  bool ended_by_signal() const { return was_killed_; }

 private:
  void spawn(const HostLaunch& launch, int ready, int lifeline, int said);
  void wait_ready(int ready);
  void read_said();
  void end_said();
  /// Whether there is time left.
  bool nap_until(SteadyTime deadline);
  int collect();
  void end_rest();
  void tell_left(pid_t process);

  Reactor& reactor_;
  const bool supervised_;
  OnLine on_line_;
  pid_t process_ = -1;
  int lifeline_ = -1;
  int said_ = -1;
  std::string line_;
  std::optional<int> exit_code_;
  bool was_killed_ = false;  ///< by a signal
};

}  // namespace fiona::console
