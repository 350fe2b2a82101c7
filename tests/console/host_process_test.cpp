// The end of a host that a console has started, and of what nobody can end.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "../temporary_directory.hpp"
#include "host_process.hpp"

namespace fiona::console {
namespace {

using namespace std::chrono_literals;
using testing::Contains;
using testing::HasSubstr;

/// A process that a debugger holds is, once it is killed, still there for its parent: as one that waits for a disk is.
/// The debugger is no child of this process, which ends all those that it has.
class Holder {
 public:
  explicit Holder(pid_t held) {
    int adopts = 0, told[2], let_go[2];
    if (::pipe2(told, O_CLOEXEC) != 0 || ::pipe2(let_go, O_CLOEXEC) != 0) return;
    ::prctl(PR_GET_CHILD_SUBREAPER, &adopts);
    ::prctl(PR_SET_CHILD_SUBREAPER, 0);
    const pid_t between = ::fork();
    if (between == 0) {
      ::close(let_go[1]);
      if (::fork() == 0) hold(held, told[1], let_go[0]);
      ::_exit(0);
    }
    ::waitpid(between, nullptr, 0);
    ::prctl(PR_SET_CHILD_SUBREAPER, adopts);
    char answer = 'n';
    static_cast<void>(::read(told[0], &answer, 1));
    holds_ = answer == 'y';
    for (const int end : {told[0], told[1], let_go[0]}) ::close(end);
    lets_go_ = let_go[1];
  }
  ~Holder() { ::close(lets_go_); }
  Holder(const Holder&) = delete;
  Holder& operator=(const Holder&) = delete;
  bool holds() const { return holds_; }

 private:
  [[noreturn]] static void hold(pid_t held, int told, int let_go) {
    char answer = ::ptrace(PTRACE_SEIZE, held, nullptr, nullptr) == 0 ? 'y' : 'n';
    static_cast<void>(::write(told, &answer, 1));
    static_cast<void>(::read(let_go, &answer, 1));
    ::_exit(0);
  }
  int lets_go_ = -1;
  bool holds_ = false;
};

/// A script in the place of a host, which says that it is ready and leaves the numbers of its processes in a file.
class HostProcessEnd : public testing::Test {
 protected:
  HostProcessEnd() {
    std::ofstream(directory_.path / "host")
        << "#!/bin/sh\nsleep 100 3>&- 4<&- >/dev/null 2>&1 &\necho $$ $! > '"
        << (directory_.path / "processes").string() << "'\nprintf 'READY\\n' >&3\nexec 3>&-\nwait\n";
    std::filesystem::permissions(directory_.path / "host", std::filesystem::perms::owner_all);
  }

  /// The script, and the program that it has started.
  std::pair<pid_t, pid_t> processes() const {
    std::ifstream file(directory_.path / "processes");
    std::pair<pid_t, pid_t> both;
    file >> both.first >> both.second;
    return both;
  }
  HostProcess started(bool supervised) {
    HostLaunch launch;
    launch.program = directory_.path / "host";
    launch.socket = directory_.path / "socket";
    launch.name = "held";
    launch.supervised = supervised;
    return HostProcess(reactor_, launch, [this](const std::string& line) { said_.push_back(line); });
  }
  static std::string told_of(pid_t process) {
    return fmt::format("process {} was killed, and is still there after 2 s", process);
  }

  Reactor reactor_;
  std::vector<std::string> said_;

 private:
  tests::TemporaryDirectory directory_;
};

TEST_F(HostProcessEnd, OfOneThatNobodyCanEndIsWaitedForSevenSecondsAndTold) {
  HostProcess host = started(false);
  const auto [script, program] = processes();
  {
    const Holder holder(script);
    if (!holder.holds()) GTEST_SKIP() << "this user may hold no other process";
    const auto begun = std::chrono::steady_clock::now();
    host.stop();
    EXPECT_LT(std::chrono::steady_clock::now() - begun, 15s);
    EXPECT_THAT(said_, Contains(HasSubstr(told_of(script))));
  }
  ::kill(program, SIGKILL);
  ::waitpid(script, nullptr, 0);
}

TEST_F(HostProcessEnd, OfASupervisorThatWasKilledWaitsThreeSecondsForWhatItHasLeft) {
  HostProcess host = started(true);
  const auto [script, program] = processes();
  {
    const Holder holder(program);
    if (!holder.holds()) GTEST_SKIP() << "this user may hold no other process";
    const auto begun = std::chrono::steady_clock::now();
    ::kill(script, SIGKILL);
    EXPECT_EQ(host.stop(), 128 + SIGKILL);
    EXPECT_LT(std::chrono::steady_clock::now() - begun, 10s);
    EXPECT_THAT(said_, Contains(HasSubstr(told_of(program))));
  }
  ::waitpid(program, nullptr, 0);
}

}  // namespace
}  // namespace fiona::console
