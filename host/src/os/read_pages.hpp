#pragma once

#include <chrono>
#include <cstddef>
#include <optional>

namespace fiona::os {

/// Takes out of this process's memory what it has read so far of its program and libraries: the tables that binding
/// them needed, and code that ran once. What is read again is mapped again from the kernel's cache, some pages at a
/// time. What has been written to is not touched; nothing is done in a process that a debugger has its breakpoints in.
void let_go_of_read_pages();

/// Does that once the process rests: a while after the last of its libraries was opened, for it holds up what runs.
class ReadPages {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr std::chrono::milliseconds kAfter{1000};

  /// To be called whenever the thread that opens libraries looks for work. `opened`: how many are open now. The
  /// milliseconds until it is to be called again; -1: there is no need, as poll(2) has it.
  int look(std::size_t opened, Time now = std::chrono::steady_clock::now());

 private:
  std::optional<std::size_t> opened_;  ///< none: not even what the program came with has been let go of
  std::optional<Time> due_;
};

}  // namespace fiona::os
