// What holds processes to a share of the CPU.
#include "os/control_group.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <signal.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>

#include "os/limits.hpp"
#include "os/process.hpp"
#include "system_fixture.hpp"

namespace fiona::os {
namespace {

using conformance::TemporaryDirectory;
using testing::HasSubstr;

class ControlGroupPlace : public testing::Test {
 protected:
  /// Of a process with these lines in its /proc/self.
  CpuGroups of(const std::string& groups, const std::string& mounts) {
    std::ofstream(proc.path / "cgroup") << groups;
    std::ofstream(proc.path / "mountinfo") << "21 1 0:3 / /proc rw,relatime - proc proc rw\n" << mounts;
    return cpu_groups(proc.path);
  }
  TemporaryDirectory proc;
};

constexpr const char* kUnified = "30 1 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n";

TEST_F(ControlGroupPlace, IsInTheOneHierarchyOfVersion2) {
  const CpuGroups found = of("0::/user.slice/user-1000.slice/session-2.scope\n", kUnified);
  EXPECT_EQ(found.folder, "/sys/fs/cgroup/user.slice/user-1000.slice/session-2.scope");
  EXPECT_TRUE(found.unified);
  EXPECT_FALSE(found.top);
}

TEST_F(ControlGroupPlace, IsInTheHierarchyThatHasTheCpu) {
  const CpuGroups found = of("4:memory:/m\n3:cpuset:/s\n2:cpu,cpuacct:/robot\n1:name=systemd:/\n0::/\n",
                             "31 1 0:27 / /cg/cpuset rw - cgroup cgroup rw,cpuset\n"
                             "32 1 0:28 / /cg/cpu rw - cgroup cgroup rw,cpu,cpuacct\n" +
                                 std::string(kUnified));
  EXPECT_EQ(found.folder, "/cg/cpu/robot");
  EXPECT_FALSE(found.unified);
}

TEST_F(ControlGroupPlace, InAContainerIsTheTopOfWhatItSees) {
  const CpuGroups found = of("0::/docker/ab12\n", "30 1 0:26 /docker/ab12 /sys/fs/cgroup rw - cgroup2 cgroup rw\n");
  EXPECT_EQ(found.folder, "/sys/fs/cgroup");
  EXPECT_TRUE(found.top);
}

TEST_F(ControlGroupPlace, IsAboveTheOneThatProcessesHaveMadeRoomInto) {
  EXPECT_EQ(of("0::/robot.service/fiona\n", kUnified).folder, "/sys/fs/cgroup/robot.service");
}

TEST_F(ControlGroupPlace, ThatIsNotMountedIsSaid) {
  const auto place = [&](const std::string& groups, const std::string& mounts) {
    try {
      return of(groups, mounts).folder.string();
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
  };
  EXPECT_EQ(place("0::/docker/ab12\n", ""), "the control group of this process is not mounted");
  EXPECT_EQ(place("0::/../outside\n", kUnified), "the control group of this process is not mounted");
  EXPECT_EQ(place("0::/other\n", "30 1 0:26 /docker /cg rw - cgroup2 cgroup rw\n"),
            "the control group of this process is not mounted");
  EXPECT_EQ(place("nonsense\n", kUnified), "this kernel has no control groups");
}

/// A process that takes what it can get, as does one that it has started.
class SpinningProcess : public testing::Test {
 protected:
  void SetUp() override {
    try {
      require_cpu_groups(cpu_groups());
    } catch (const std::runtime_error& obstacle) {
      GTEST_SKIP() << obstacle.what();
    }
    process.emplace("/bin/sh", std::vector<std::string>{"-c", "while :; do :; done & while :; do :; done"},
                    std::vector<std::pair<int, int>>{});
  }
  std::filesystem::path folder() const { return cpu_groups().folder / ("fiona-" + std::to_string(process->id())); }
  std::size_t members() const {
    std::ifstream in(folder() / "cgroup.procs");
    return static_cast<std::size_t>(std::distance(std::istream_iterator<int>(in), {}));
  }
  std::optional<ChildProcess> process;
};

TEST_F(SpinningProcess, GetsItsShareAndNoMoreThoughTheMachineIsIdle) {
  limit_cpu(cpu_groups(), process->id(), 0.2);
  limit_cpu(cpu_groups(), process->id(), 0.1);  // what a second host would do
  const auto before = usage_of(process->id())->cpu_time;
  std::this_thread::sleep_for(std::chrono::seconds(2));
  const std::chrono::duration<double> taken = usage_of(process->id())->cpu_time - before;
  EXPECT_LE(taken.count(), 2 * 0.1 + 0.1);  // it may have begun with a whole period
  EXPECT_GT(taken.count(), 0.0);
}

TEST_F(SpinningProcess, LeavesNoControlGroup) {
  for (int i = 0; i < 1000 && usage_of(process->id())->cpu_time.count() == 0; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  limit_cpu(cpu_groups(), process->id(), 0.1);
  EXPECT_GE(members(), 1U);
  const auto left = folder();
  const auto others = cpu_groups().folder / ("fiona-" + std::to_string(process->id() + 1));
  const pid_t id = process->id();
  process.reset();
  const bool free = ::kill(id + 1, 0) != 0;
  if (free) std::filesystem::create_directory(others);  // of a host that was killed
  remove_cpu_limit(id);
  EXPECT_FALSE(std::filesystem::exists(left));
  EXPECT_FALSE(free && std::filesystem::exists(others));
}

TEST_F(SpinningProcess, ThatIsGoneIsNotHeldAndLeavesNothing) {
  const auto left = folder();
  const pid_t id = process->id();
  process.reset();
  EXPECT_THROW(limit_cpu(cpu_groups(), id, 0.1), std::system_error);
  EXPECT_FALSE(std::filesystem::exists(left));
}

}  // namespace
}  // namespace fiona::os
