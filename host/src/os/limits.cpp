#include "os/limits.hpp"

#include <fcntl.h>
#include <linux/close_range.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

#include "os/process.hpp"

namespace fiona::os {
namespace {

/// Above those that a group is given.
constexpr unsigned kFirstStranger = 7;
/// Beyond those that a group may have: with none left ZeroMQ would end it before anyone says why.
constexpr std::uint64_t kLastDescriptors = 32;
/// Addresses that are kept and not used: each arena of the allocator keeps 64 MiB, and libraries take some.
constexpr std::uint64_t kReserved = std::uint64_t{4} << 30U;

void set(int resource, std::uint64_t value) {
  rlimit limit{};
  ::getrlimit(static_cast<__rlimit_resource>(resource), &limit);
  limit.rlim_max = std::min<rlim_t>(limit.rlim_max, value);
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(static_cast<__rlimit_resource>(resource), &limit);
}

/// Linux 6.2 and later tell their number as the folder's size.
std::uint64_t descriptors_of(const std::string& process) {
  struct stat folder {};
  if (::stat((process + "/fd").c_str(), &folder) == 0 && folder.st_size > 0)
    return static_cast<std::uint64_t>(folder.st_size);
  std::error_code denied;
  std::uint64_t count = 0;
  std::filesystem::directory_iterator one(process + "/fd", denied);
  for (; !denied && one != std::filesystem::directory_iterator(); one.increment(denied)) ++count;
  return count;
}

}  // namespace

void leave_no_core_file() {
  set(RLIMIT_CORE, 0);
  // core(5): a program that takes cores over a pipe is not bound by the limit, but gets no memory.
  std::ofstream("/proc/self/coredump_filter") << "0";
}

std::uint64_t descriptors_of_stranger(std::uint64_t wanted) {
  constexpr std::uint64_t kUnderWay = 300;  // one message more than may be is let through, with 253; the rest is ours
  constexpr std::uint64_t kLeast = 64;
  const std::uint64_t ours = descriptor_limit();
  const std::uint64_t others = kUnderWay + kLastDescriptors;
  return std::min(wanted, ours > others + kLeast ? ours - others : kLeast);
}

void limit(const Limits& limits) {
  rlimit descriptors{};
  ::getrlimit(RLIMIT_NOFILE, &descriptors);
  set(RLIMIT_NOFILE, std::min<std::uint64_t>(descriptors.rlim_cur, limits.descriptors + kLastDescriptors));
  leave_no_core_file();
  ::close_range(kFirstStranger, ~0U, 0);
  ::close_range(STDERR_FILENO + 1, kFirstStranger - 1, CLOSE_RANGE_CLOEXEC);
  if (!kLimitsMemory) return;
  set(RLIMIT_DATA, limits.memory);
  set(RLIMIT_AS, limits.memory + kReserved);
}

void limit_child(pid_t child, std::uint64_t memory, std::uint64_t descriptors) {
  rlimit of_descriptors{};
  ::prlimit(child, RLIMIT_NOFILE, nullptr, &of_descriptors);
  of_descriptors.rlim_cur = of_descriptors.rlim_max = std::min<rlim_t>(of_descriptors.rlim_max, descriptors);
  ::prlimit(child, RLIMIT_NOFILE, &of_descriptors, nullptr);
  const rlimit of_memory{memory, memory};
  ::prlimit(child, RLIMIT_DATA, &of_memory, nullptr);
}

/// proc(5): after the name, which may hold anything, the fields from the third on.
std::optional<Usage> usage_of(pid_t process) {
  const std::string folder = "/proc/" + std::to_string(process);
  std::ifstream file(folder + "/stat");
  std::string line;
  if (!std::getline(file, line) || line.rfind(')') == std::string::npos) return std::nullopt;
  std::size_t at = line.rfind(')') + 2;
  Usage usage;
  usage.descriptors = descriptors_of(folder);
  static const std::int64_t kTick_ns = 1'000'000'000 / ::sysconf(_SC_CLK_TCK);
  for (int field = 3; field <= 24 && at < line.size(); ++field) {
    const std::size_t end = std::min(line.find(' ', at), line.size());
    const std::string value = line.substr(at, end - at);
    if (field == 14 || field == 15) usage.cpu_time += std::chrono::nanoseconds(std::stoll(value) * kTick_ns);
    if (field == 20) usage.threads = std::stoull(value);
    if (field == 24) usage.memory = std::stoull(value) * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
    at = end + 1;
  }
  return usage;
}

std::uint64_t open_descriptors() { return descriptors_of("/proc/self"); }

void put_last(pid_t process) {
  constexpr int kNice = 10;
  std::error_code ignored;
  std::filesystem::directory_iterator task("/proc/" + std::to_string(process) + "/task", ignored);
  for (; task != std::filesystem::directory_iterator(); task.increment(ignored))
    ::setpriority(PRIO_PROCESS, static_cast<id_t>(std::stoul(task->path().filename().string())), kNice);
}

/// Documentation/scheduler/sched-stats.rst: time on a CPU, time waiting for one, how often.
std::map<pid_t, std::chrono::nanoseconds> times_waiting_for_cpu(pid_t process) {
  std::map<pid_t, std::chrono::nanoseconds> all;
  std::error_code ignored;
  std::filesystem::directory_iterator task("/proc/" + std::to_string(process) + "/task", ignored);
  for (; task != std::filesystem::directory_iterator(); task.increment(ignored)) {
    std::ifstream file(task->path() / "schedstat");
    std::int64_t ran_ns = 0;
    std::int64_t waited_ns = 0;
    if (file >> ran_ns >> waited_ns)
      all[std::stoi(task->path().filename().string())] = std::chrono::nanoseconds(waited_ns);
  }
  return all;
}

std::chrono::nanoseconds time_waiting_for_cpu(pid_t process) {
  std::chrono::nanoseconds all(0);
  for (const auto& [thread, waited] : times_waiting_for_cpu(process)) all += waited;
  return all;
}

}  // namespace fiona::os
