// Who has the lock of a name: a process that lives, or what one that was killed has left.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <thread>

#include "os/unix_socket.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

class Lock : public testing::Test {
 protected:
  /// A process that has it; with `leaves` it starts another one, which has it too, and goes on for so long.
  pid_t holder(std::chrono::milliseconds leaves = {}) {
    const pid_t process = ::fork();
    if (process == 0) {
      const auto lock = os::try_lock(file);
      if (leaves.count() > 0 && ::fork() == 0) {
        std::this_thread::sleep_for(leaves);
        ::_exit(0);
      }
      const int has = lock ? 1 : 0;
      static_cast<void>(::write(told_[1], &has, sizeof has));
      while (true) ::pause();
    }
    int has = 0;
    static_cast<void>(::read(told_[0], &has, sizeof has));
    EXPECT_EQ(has, 1);
    return process;
  }
  static void end(pid_t process) {
    ::kill(process, SIGKILL);
    ::waitpid(process, nullptr, 0);
  }
  Lock() { EXPECT_EQ(::pipe(told_), 0); }
  ~Lock() override {
    for (const int one : told_) ::close(one);
  }

  const TemporaryDirectory directory;
  const std::filesystem::path file = directory.path / "name.lock";

 private:
  int told_[2] = {-1, -1};
};

TEST_F(Lock, OfAProcessThatLivesIsRefusedAtOnce) {
  const pid_t process = holder();
  const auto begun = Steady::now();
  EXPECT_FALSE(os::try_lock(file));
  EXPECT_LT(Steady::now() - begun, 1s);
  end(process);
  EXPECT_TRUE(os::try_lock(file));
}

TEST_F(Lock, ThatWhatAKilledProcessHasStartedStillHasIsWaitedFor) {
  end(holder(300ms));
  EXPECT_TRUE(os::try_lock(file));
}

TEST_F(Lock, ThatSomebodyKeepsWhoseStarterWasKilledIsRefusedAfterTwoSeconds) {
  end(holder(5s));
  const auto begun = Steady::now();
  EXPECT_FALSE(os::try_lock(file));
  EXPECT_GE(Steady::now() - begun, 2s);
}

}  // namespace
}  // namespace fiona::conformance
