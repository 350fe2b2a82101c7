#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "os/packet_socket.hpp"
#include "os/process.hpp"

namespace fiona::os {

/// ThreadSanitizer knows no copies other than those that fork() makes.
#if defined(__SANITIZE_THREAD__)
inline constexpr bool kCopiesProcesses = false;
#elif defined(__has_feature)
inline constexpr bool kCopiesProcesses = !__has_feature(thread_sanitizer);
#else
inline constexpr bool kCopiesProcesses = true;
#endif

/// A process that has loaded all that those of its kind need, and waits. They are copies of it: they begin where it has
/// come to, and share its memory as far as they do not write to it. Destruction ends it, and leaves the copies alone.
class ProcessTemplate {
 public:
  /// Starts `program`, which calls `wait_to_be_copied`. Throws Error if it cannot be started.
  explicit ProcessTemplate(const std::filesystem::path& program);
  /// A copy: a child of this process with these words and descriptors, each (ours, its number there), as if `program`
  /// had been started with them. None: there are no more to be had.
  std::unique_ptr<ChildProcess> copy(const std::vector<std::string>& words,
                                     const std::vector<std::pair<int, int>>& inherited);

  /// Whether more copies may be had; one that has ended is reaped.
  bool lives() { return socket_ && process_.end().empty(); }

 private:
  std::unique_ptr<ChildProcess> announced() const;

  PacketSocket socket_;
  ChildProcess process_;
};

/// Whether a program that was started with these words is to be a template.
bool is_template(int argc, char** argv);
/// [before the first thread] Returns in each copy, with its words; the template itself ends with the process that has
/// started it. People see a copy's own words in its place among the processes, as far as there is room.
std::vector<std::string> wait_to_be_copied(int argc, char** argv);

}  // namespace fiona::os
