#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>

namespace fiona::os {

/// What a process may take of the machine.
struct Limits {
  std::uint64_t memory = std::uint64_t{1} << 30U;  ///< bytes
  std::uint64_t threads = 128;
  std::uint64_t descriptors = 1024;
  double cores = 0;  ///< of the CPU, in the long run; 0: as many as there are
};

/// A sanitizer's shadow takes terabytes of addresses, and several times the memory.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kLimitsMemory = false;
#elif defined(__has_feature)
inline constexpr bool kLimitsMemory = !__has_feature(address_sanitizer) && !__has_feature(thread_sanitizer);
#else
inline constexpr bool kLimitsMemory = true;
#endif

/// Whatever ends this process, and those that it starts, nothing of what they hold, passwords say, goes into a file.
void leave_no_core_file();

/// Of so many descriptors those that a process of a stranger may have. What a user's processes have under way in
/// sockets is counted for all of them, and held against the limit of whoever sends (unix(7), ETOOMANYREFS): a stranger
/// who may have as many as this process could leave it none to send.
std::uint64_t descriptors_of_stranger(std::uint64_t wanted);

/// [before the first thread] Holds this process to them where the kernel does so by itself: what it asks for beyond its
/// memory is refused; it leaves no core, opens few more descriptors than it may, and no program that it starts inherits
/// any. What is left, memory that it shares, threads, CPU time, is for who watches it.
void limit(const Limits& limits);

/// Holds a child to so much memory of its own and so many descriptors, the latter as far as this process may give them.
void limit_child(pid_t child, std::uint64_t memory, std::uint64_t descriptors);

/// What a process has of it now; none: it is gone.
struct Usage {
  std::uint64_t memory = 0;  ///< bytes resident
  std::uint64_t threads = 0;
  std::uint64_t descriptors = 0;         ///< 0: it is not to be seen by this user
  std::chrono::nanoseconds cpu_time{0};  ///< of all its threads, since it started
};
std::optional<Usage> usage_of(pid_t process);

/// How many descriptors this process has open.
std::uint64_t open_descriptors();

/// From now on the threads that it has, and those that they start, get what others leave of the CPU.
void put_last(pid_t process);

/// For how long the threads of a process, all together, have been ready to run and have waited for a CPU.
std::chrono::nanoseconds time_waiting_for_cpu(pid_t process);
/// The same of each of its threads, by its number.
std::map<pid_t, std::chrono::nanoseconds> times_waiting_for_cpu(pid_t process);

}  // namespace fiona::os
