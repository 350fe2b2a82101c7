// Processes that this one starts.
#include "os/process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <fstream>
#include <string>

namespace fiona::os {
namespace {

/// A line of /proc/PID/status, behind its name.
std::string told_of(pid_t process, const std::string& name) {
  std::ifstream file("/proc/" + std::to_string(process) + "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(name + ":\t")) return line.substr(name.size() + 2);
  }
  return "gone";
}

TEST(ChildProcess, IsToldWhatThisProcessHearsByADescriptor) {
  sigset_t ending, before;
  sigemptyset(&ending);
  sigaddset(&ending, SIGTERM);
  ::pthread_sigmask(SIG_BLOCK, &ending, &before);
  const ChildProcess child("/bin/sleep", {"60"}, {});
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
  EXPECT_EQ(told_of(child.id(), "SigBlk"), "0000000000000000");
}

/// As a copy of it that has not come so far as to leave its group.
TEST(ChildProcess, IsEndedWithWhatIsStillInItsGroup) {
  ChildProcess child("/bin/sleep", {"60"}, {});
  const pid_t other = ::fork();
  if (other == 0) {
    while (true) ::pause();
  }
  ASSERT_EQ(::setpgid(other, child.id()), 0);
  child.end_group();
  EXPECT_EQ(::waitpid(other, nullptr, WNOHANG), -1);
  EXPECT_EQ(errno, ECHILD);
  EXPECT_EQ(child.end(), "killed by signal 9 (Killed)");
}

}  // namespace
}  // namespace fiona::os
