#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "reactor.hpp"

namespace fiona::console {

/// A program that is run to its end, in a process group of its own, and taken with all that it started when its time is
/// over or Ctrl-C comes.
struct ChildProgram {
  std::string program;  ///< a path, or a name that is looked up in PATH
  std::vector<std::string> arguments{};
  std::filesystem::path directory{};                               ///< where it runs; empty: here
  std::vector<std::pair<std::string, std::string>> environment{};  ///< beside ours
  bool clean = false;                                              ///< of our environment it has the language alone
  SteadyTime deadline{};
  std::function<void(const std::string& line)> on_out{};  ///< each line of its standard output, cut at 4096 bytes
  std::function<void(const std::string& line)> on_err{};
};

/// How it ended.
struct ChildEnd {
  int code = 0;    ///< its exit code; 128 + signal
  int signal = 0;  ///< that killed it; 0: none
  bool in_time = true;
  bool ok() const { return in_time && code == 0; }
  /// "exited with code 3", "was killed by signal 11 (Segmentation fault)", "did not end in time".
  std::string text() const;
};

/// Throws fiona::Error (NotFound) if it cannot be started, Interrupted as Reactor::run_until does.
ChildEnd run_child(Reactor& reactor, const ChildProgram& child);

}  // namespace fiona::console
