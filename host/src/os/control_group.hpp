#pragma once

#include <sys/types.h>

#include <filesystem>
#include <string>

namespace fiona::os {

/// Where this process may make control groups that hold others to a share of the CPU: cgroups(7).
struct CpuGroups {
  std::filesystem::path folder;  ///< of this process's own control group
  bool unified = false;          ///< version 2
  bool top = false;              ///< nothing above it is to be seen: that of a container, or the root
};

/// Reads what `proc`, in the place of /proc/self, says of control groups and mounts. Throws std::runtime_error where
/// there is no controller of the CPU.
CpuGroups cpu_groups(const std::filesystem::path& proc = "/proc/self");

/// Throws std::runtime_error that says why `limit_cpu` cannot hold a process: this user may not write there; or, in
/// version 2, the group is neither the top nor delegated to this user (Delegate= of systemd.resource-control(5)).
void require_cpu_groups(const CpuGroups& groups);

/// Holds a process, with all its threads and what it starts, to so many cores in each tenth of a second, by a control
/// group of its own beneath `groups`. As in version 2 only a group without processes has others beneath it, those that
/// are in it go into one beneath it, too. Throws std::runtime_error that says what is in the way.
void limit_cpu(const CpuGroups& groups, pid_t process, double cores);

/// Removes the control group of a process that has ended, if it had one, and those that hosts left which were killed.
void remove_cpu_limit(pid_t process);

}  // namespace fiona::os
