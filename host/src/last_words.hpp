#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace fiona::host {

/// Which instance ran on the thread whose signal has ended a host. Written by the host itself as it dies, and read by
/// the next ones, which had better run that instance elsewhere. Of a stack that has overflowed, and of a thread that a
/// component has started itself, nothing is told.
struct LastWords {
  std::string instance;
  int signal = 0;

  /// Those in FILE, of each instance the newest; none without a file.
  static std::vector<LastWords> told_in(const std::filesystem::path& file);
  /// From now on this process leaves them there, behind those that are there. [once]
  static void leave_in(const std::filesystem::path& file);
  /// Of what is loaded under this name from now on nothing is known yet.
  static void forget(const std::string& instance);

  /// "was ended by signal 11 (Segmentation fault) while 'bad' ran"
  std::string text() const;
};

}  // namespace fiona::host
