#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <exception>
#include <iostream>
#include <string_view>

#include "fiona/error.hpp"

namespace fiona {

/// Of a program whose flags nothing parses.
class NoUsageError : public std::exception {};

/// The `main` of a small program: what `work` throws is told on standard error, and says with which code it ends.
/// `UsageError` is what its parser of flags throws, after
/// which `usage` is told.
template <class UsageError = NoUsageError, class Work>
int run_tool(const Work& work, std::string_view usage = {}) {
  const auto end = [](ErrorCode code, const char* what, std::string_view more) {
    std::cerr << "error: " << what << '\n' << more;
    return static_cast<int>(code);
  };
  try {
    return work();
  } catch (const Error& error) {
    return end(error.code(), error.what(), {});
  } catch (const UsageError& error) {
    return end(ErrorCode::Usage, error.what(), usage);
  } catch (const std::exception& error) {
    return end(ErrorCode::Failed, error.what(), {});
  }
}

/// [first in main] What is opened later is not taken for standard input, output or error where whoever started this has
/// closed them.
inline void open_standard_streams() {
  int opened = 0;
  do opened = ::open("/dev/null", O_RDWR);
  while (opened >= 0 && opened <= STDERR_FILENO);
  if (opened >= 0) ::close(opened);
}

}  // namespace fiona
