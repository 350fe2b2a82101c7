#include "os/control_group.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/xattr.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <system_error>
#include <thread>
#include <vector>

#include "os/descriptor.hpp"

namespace fiona::os {
namespace {

namespace fs = std::filesystem;

/// A tenth of a second, as cpu.max has by default.
constexpr int kPeriod_us = 100'000;
/// In front of a process's number: its control group.
constexpr std::string_view kPrefix = "fiona-";
/// Where those go that were in a control group that has others beneath it.
constexpr std::string_view kRest = "fiona";

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, separator);) parts.push_back(part);
  return parts;
}

bool has_cpu(const std::string& controllers, char separator) {
  const auto names = split(controllers, separator);
  return std::find(names.begin(), names.end(), "cpu") != names.end();
}

std::string line_of(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return line;
}

/// The kernel takes or refuses what is written with one call.
void write(const fs::path& file, const std::string& text) {
  const Descriptor to(::open(file.c_str(), O_WRONLY | O_CLOEXEC));
  if (!to || ::write(to.get(), text.data(), text.size()) < 0)
    throw std::system_error(errno, std::generic_category(), file.string());
}

/// proc_pid_mountinfo(5): a control group's path begins at the root of its hierarchy, of which a part is mounted.
CpuGroups mounted(const fs::path& proc, bool unified, const std::string& path) {
  std::ifstream mounts(proc / "mountinfo");
  for (std::string line; std::getline(mounts, line);) {
    const auto fields = split(line, ' ');
    const auto dash = std::find(fields.begin(), fields.end(), "-");
    if (fields.end() - dash < 4 || dash - fields.begin() < 6) continue;
    if (unified ? dash[1] != "cgroup2" : dash[1] != "cgroup" || !has_cpu(dash[3], ',')) continue;
    const fs::path below = fs::path(path).lexically_relative(fields[3]);
    if (below.empty() || *below.begin() == "..") continue;
    const bool top = below == ".";
    return {top ? fs::path(fields[4]) : fields[4] / below, unified, top};
  }
  throw std::runtime_error("the control group of this process is not mounted");
}

/// systemd marks what it leaves to others.
bool is_delegated(const fs::path& folder) {
  char value = 0;
  const auto says = [&](const char* name) { return ::getxattr(folder.c_str(), name, &value, 1) == 1 && value == '1'; };
  return says("user.delegate") || says("trusted.delegate");
}

void move_processes(const fs::path& from, const fs::path& to) {
  std::vector<std::string> processes;
  {
    std::ifstream in(from / "cgroup.procs");
    for (std::string process; std::getline(in, process);) processes.push_back(process);
  }
  for (const std::string& process : processes) {
    try {
      write(to / "cgroup.procs", process);
    } catch (const std::system_error& error) {
      if (error.code() != std::errc::no_such_process) throw;  // it has ended
    }
  }
}

bool is_enabled(const fs::path& folder) { return has_cpu(line_of(folder / "cgroup.subtree_control"), ' '); }

/// So that groups beneath `folder` have a share of the CPU.
void enable_cpu(const fs::path& folder) {
  if (is_enabled(folder)) return;
  const bool is_root = !fs::exists(folder / "cgroup.type");
  if (!is_root) {
    fs::create_directory(folder / kRest);
    move_processes(folder, folder / kRest);
  }
  write(folder / "cgroup.subtree_control", "+cpu");
}

fs::path group_of(const CpuGroups& groups, pid_t process) {
  return groups.folder / (std::string(kPrefix) + std::to_string(process));
}

}  // namespace

CpuGroups cpu_groups(const fs::path& proc) {
  std::ifstream lines(proc / "cgroup");
  std::string unified;
  for (std::string line; std::getline(lines, line);) {
    const auto first = line.find(':');
    const auto second = line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    const std::string path = line.substr(second + 1);
    if (has_cpu(controllers, ',')) return mounted(proc, false, path);
    if (controllers.empty()) unified = path;
  }
  if (unified.empty()) throw std::runtime_error("this kernel has no control groups");
  const fs::path path(unified);
  return mounted(proc, true, path.filename() == kRest ? path.parent_path().string() : unified);
}

void require_cpu_groups(const CpuGroups& groups) {
  const fs::path& folder = groups.folder;
  if (::access(folder.c_str(), W_OK) != 0) throw std::system_error(errno, std::generic_category(), folder.string());
  if (!groups.unified || is_enabled(folder)) return;
  if (!has_cpu(line_of(folder / "cgroup.controllers"), ' '))
    throw std::runtime_error(folder.string() + " has no controller of the CPU");
  if (!groups.top && !is_delegated(folder))
    throw std::runtime_error(folder.string() +
                             " is not delegated (systemd-run --user --scope -p Delegate=yes fiona run)");
}

void limit_cpu(const CpuGroups& groups, pid_t process, double cores) {
  require_cpu_groups(groups);
  if (groups.unified) enable_cpu(groups.folder);
  const fs::path group = group_of(groups, process);
  const std::string quota = std::to_string(static_cast<int>(cores * kPeriod_us));
  fs::create_directory(group);
  try {
    if (groups.unified) {
      write(group / "cpu.max", quota + " " + std::to_string(kPeriod_us));
    } else {
      write(group / "cpu.cfs_period_us", std::to_string(kPeriod_us));
      write(group / "cpu.cfs_quota_us", quota);
    }
    write(group / "cgroup.procs", std::to_string(process));
  } catch (const std::system_error&) {
    ::rmdir(group.c_str());
    throw;
  }
}

void remove_cpu_limit(pid_t process) {
  CpuGroups groups;
  try {
    groups = cpu_groups();
  } catch (const std::runtime_error&) {
    return;  // then it had none
  }
  // What the process has started, and was killed with it, leaves a moment later.
  for (int tries = 0; tries < 50 && ::rmdir(group_of(groups, process).c_str()) != 0 && errno == EBUSY; ++tries)
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  std::error_code ignored;
  fs::directory_iterator beneath(groups.folder, ignored);
  for (; beneath != fs::directory_iterator(); beneath.increment(ignored)) {
    const std::string name = beneath->path().filename().string();
    if (!name.starts_with(kPrefix)) continue;
    const auto number = static_cast<pid_t>(std::strtol(name.c_str() + kPrefix.size(), nullptr, 10));
    if (number > 0 && ::kill(number, 0) != 0 && errno == ESRCH) ::rmdir(beneath->path().c_str());
  }
}

}  // namespace fiona::os
