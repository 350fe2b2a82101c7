#include "os/limits.hpp"

#include <fcntl.h>
#include <linux/close_range.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

namespace fiona::os {
namespace {

/// Above those that a group is given.
constexpr unsigned kFirstStranger = 7;
/// Addresses that are kept and not used: each arena of the allocator keeps 64 MiB, and libraries take some.
constexpr std::uint64_t kReserved = std::uint64_t{4} << 30U;

void set(int resource, std::uint64_t value) {
  rlimit limit{};
  ::getrlimit(static_cast<__rlimit_resource>(resource), &limit);
  limit.rlim_max = std::min<rlim_t>(limit.rlim_max, value);
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(static_cast<__rlimit_resource>(resource), &limit);
}

}  // namespace

void limit(const Limits& limits) {
  rlimit descriptors{};
  ::getrlimit(RLIMIT_NOFILE, &descriptors);
  set(RLIMIT_NOFILE, descriptors.rlim_cur);
  set(RLIMIT_CORE, 0);
  ::close_range(kFirstStranger, ~0U, 0);
  ::close_range(STDERR_FILENO + 1, kFirstStranger - 1, CLOSE_RANGE_CLOEXEC);
  if (!kLimitsMemory) return;
  set(RLIMIT_DATA, limits.memory);
  set(RLIMIT_AS, limits.memory + kReserved);
}

/// proc(5): after the name, which may hold anything, the fields from the third on.
std::optional<Usage> usage_of(pid_t process) {
  std::ifstream file("/proc/" + std::to_string(process) + "/stat");
  std::string line;
  if (!std::getline(file, line) || line.rfind(')') == std::string::npos) return std::nullopt;
  std::size_t at = line.rfind(')') + 2;
  Usage usage;
  for (int field = 3; field <= 24 && at < line.size(); ++field) {
    const std::size_t end = std::min(line.find(' ', at), line.size());
    const std::string value = line.substr(at, end - at);
    if (field == 20) usage.threads = std::stoull(value);
    if (field == 24) usage.memory = std::stoull(value) * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
    at = end + 1;
  }
  return usage;
}

/// Documentation/scheduler/sched-stats.rst: time on a CPU, time waiting for one, how often.
std::chrono::nanoseconds time_waiting_for_cpu(pid_t process) {
  std::chrono::nanoseconds all(0);
  std::error_code ignored;
  std::filesystem::directory_iterator task("/proc/" + std::to_string(process) + "/task", ignored);
  for (; task != std::filesystem::directory_iterator(); task.increment(ignored)) {
    std::ifstream file(task->path() / "schedstat");
    std::int64_t ran_ns = 0;
    std::int64_t waited_ns = 0;
    if (file >> ran_ns >> waited_ns) all += std::chrono::nanoseconds(waited_ns);
  }
  return all;
}

}  // namespace fiona::os
