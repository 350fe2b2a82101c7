#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <string>

#include "os/descriptor.hpp"

namespace fiona::host {

/// What the process of a group writes to its standard output and error. So much of it a second is passed on to the
/// host's own, the rest is counted; the end of it is kept, since it may say why the process has ended.
class GroupOutput {
 public:
  using Time = std::chrono::steady_clock::time_point;
  /// Passed on a second, and at once.
  static constexpr std::size_t kBytesPerSecond = 64 * 1024;
  static constexpr std::size_t kBurst = 64 * 1024;
  /// Read at a time: who writes more than that in 100 ms waits.
  static constexpr std::size_t kMostRead = 1024 * 1024;
  static constexpr std::size_t kKeptLines = 8;
  static constexpr std::size_t kLongestLine = 200;

  GroupOutput();
  /// Of a process that has its end already.
  explicit GroupOutput(os::Descriptor read_end) : read_end_(std::move(read_end)) {}
  int read_end() const { return read_end_.get(); }
  /// For the process; ours is closed once it has it.
  int write_end() const { return write_end_.get(); }
  void close_write_end() { write_end_.reset(); }

  /// [control thread] Reads what there is, and returns what is to be passed on.
  std::string take(Time now);
  /// Its last lines, made inert; empty: it has written nothing.
  std::string last_lines() const;
  /// Bytes that were not passed on.
  std::uint64_t dropped() const { return dropped_; }

 private:
  void keep(const std::string& text);
  std::string limited(std::string text, Time now);

  os::Descriptor read_end_;
  os::Descriptor write_end_;
  std::deque<std::string> lines_;
  std::string unfinished_;
  std::size_t allowance_ = kBurst;
  Time counted_{};
  std::uint64_t dropped_ = 0;
  std::uint64_t told_dropped_ = 0;
};

}  // namespace fiona::host
