#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "os/descriptor.hpp"

namespace fiona::os {

/// A child process, known by a pidfd so that its number is never mistaken for another's. Destruction kills and
/// reaps, after half a second without waiting for that.
/// It leads a process group, and at its end so do end the programs that it has started and that are still in that.
class ChildProcess {
 public:
  /// Starts `program`, with no signal blocked. Of the descriptors only those of `inherited` reach it, each (ours, its
  /// number there). `clean`: of our environment it has the language alone. `variables` ("NAME=VALUE") it has besides.
  /// `shown_as`: its name among the processes, where that of the file says nothing. Throws Error if it cannot be
  /// started.
  ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
               const std::vector<std::pair<int, int>>& inherited, bool clean = false,
               std::vector<std::string> variables = {}, const std::filesystem::path& shown_as = {});
  /// One that another process of ours has started, known by its pidfd. Who reaps it says how it has ended; empty: it is
  /// not known.
  using HowItEnded = std::function<std::string(pid_t)>;
  ChildProcess(pid_t id, Descriptor handle, HowItEnded how);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t id() const { return id_; }
  /// Readable when the process has ended.
  int descriptor() const { return handle_.get(); }
  /// "exited with code 3", "killed by signal 11 (Segmentation fault)"; empty while it runs. Reaps one of our own.
  std::string end();
  /// Whether it has been stopped, by SIGSTOP or from a terminal, and not gone on since.
  bool is_stopped() const;
  void kill();
  /// Likewise, and waits half a second at most until it has ended, with each child of ours that is still in its process
  /// group.
  void end_group();

 private:
  pid_t id_ = -1;
  Descriptor handle_;
  HowItEnded how_;  ///< none: it is a child of this process
  std::string end_;
};

/// Reaps a child that has ended, and ends what is left of its process group. What waitpid tells of it; none: it lives.
std::optional<int> reap(pid_t child);
/// Whether it is a child of this process that nobody has reaped.
bool is_child(pid_t process);

/// Ends the programs that this process has started and left, if it leads a process group: the others in that.
void end_own_programs();

/// "exited with code 3", of what waitpid has told.
std::string text_of_end(int status);

/// How many descriptors this process and its children may have.
std::size_t descriptor_limit();

/// The directory of the running program, for its siblings.
std::filesystem::path program_directory();

/// Of xdg-dbus-proxy(1), through which sandboxes reach D-Bus.
inline constexpr const char* kBusProxy = "xdg-dbus-proxy";
/// Where PATH has a program; empty: nowhere.
std::filesystem::path program_in_path(std::string_view name);

/// From now on memory that is freed stays with the process, up to 8 MiB for each of the allocator's arenas, so that the
/// next large object does not fault its pages in anew: that costs more than copying it.
void keep_freed_memory();

/// However far it has come by then, this process ends after so long, with this code.
void end_within(std::chrono::seconds time, int code);

/// 16 bytes nobody can guess.
std::string random_token();

}  // namespace fiona::os
