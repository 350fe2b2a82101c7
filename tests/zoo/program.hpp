#pragma once

#include <spawn.h>
#include <sys/types.h>

namespace zoo {

/// A program that does not end by itself. Its number.
inline pid_t start_program() {
  char name[] = "sleep";
  char time[] = "3600";
  char* words[] = {name, time, nullptr};
  char* nothing[] = {nullptr};
  pid_t process = -1;
  ::posix_spawn(&process, "/bin/sleep", nullptr, nullptr, words, nothing);
  return process;
}

}  // namespace zoo
