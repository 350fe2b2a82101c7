// Which calls of the system a confined process may make (seccomp(2)).
#include <fcntl.h>
#include <sched.h>
#include <seccomp.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <memory>
#include <system_error>

#include "os/sandbox.hpp"

namespace fiona::os::detail {
namespace {

/// No component has a use for these; each is a way out, or into the kernel. A name that this system's libseccomp does
/// not know is one that the kernel may have all the same: then its number is below.
constexpr const char* kForbidden[] = {
    // other processes
    "ptrace", "process_vm_readv", "process_vm_writev", "process_madvise", "process_mrelease", "kcmp", "pidfd_open",
    "pidfd_getfd", "pidfd_send_signal", "tkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo", "migrate_pages", "move_pages",
    "get_robust_list", "sched_setattr",
    // programs and processes
    "execve", "execveat", "fork", "vfork", "setns", "unshare", "personality", "setsid", "setpgid",
    // file systems
    "mount", "umount", "umount2", "pivot_root", "chroot", "move_mount", "open_tree", "fsopen", "fsmount", "fsconfig",
    "fspick", "mount_setattr", "quotactl", "quotactl_fd", "swapon", "swapoff", "name_to_handle_at", "open_by_handle_at",
    "mknod", "mknodat", "fanotify_init", "fanotify_mark",
    // the kernel
    "bpf", "perf_event_open", "kexec_load", "kexec_file_load", "init_module", "finit_module", "delete_module", "reboot",
    "acct", "syslog", "iopl", "ioperm", "lookup_dcookie", "userfaultfd", "io_uring_setup", "io_uring_enter",
    "io_uring_register", "vhangup", "sethostname", "setdomainname", "settimeofday", "clock_settime", "clock_adjtime",
    "adjtimex", "memfd_secret",
    // memory that lies there when the process has let go of it, and that no count of what it has tells
    "memfd_create", "shmget", "semget", "msgget",
    // keys
    "add_key", "request_key", "keyctl"};

class Filter {
 public:
  Filter() : context_(::seccomp_init(SCMP_ACT_ALLOW), &::seccomp_release) {
    if (!context_) throw std::system_error(ENOMEM, std::generic_category(), "seccomp");
  }
  void forbid(const char* call) {
    const int number = ::seccomp_syscall_resolve_name(call);
    if (number != __NR_SCMP_ERROR) add(EPERM, number, {});
  }
  void forbid(int call, std::initializer_list<scmp_arg_cmp> when, int error = EPERM) { add(error, call, when); }
  void load() {
    // Other architectures' calls of this kernel (i386 on x86-64) are not filtered by name: they end the process.
    ::seccomp_attr_set(context_.get(), SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_KILL_PROCESS);
    check(::seccomp_load(context_.get()));
  }

 private:
  void add(int error, int call, std::initializer_list<scmp_arg_cmp> when) {
    check(::seccomp_rule_add_array(context_.get(), SCMP_ACT_ERRNO(error), call, static_cast<unsigned>(when.size()),
                                   when.begin()));
  }
  static void check(int result) {
    if (result < 0 && result != -EEXIST) throw std::system_error(-result, std::generic_category(), "seccomp");
  }

  std::unique_ptr<void, void (*)(scmp_filter_ctx)> context_;
};

scmp_arg_cmp arg(unsigned number, scmp_compare is, std::uint64_t value) { return {number, is, value, 0}; }
scmp_arg_cmp bits(unsigned number, std::uint64_t mask, std::uint64_t value) {
  return {number, SCMP_CMP_MASKED_EQ, mask, value};
}

/// As the calls of the list make it; a file's own is mapped as ever.
void forbid_shared_memory(Filter& filter) {
  constexpr std::uint64_t kShared = MAP_SHARED | MAP_ANONYMOUS;
  filter.forbid(SCMP_SYS(mmap), {bits(3, kShared, kShared)});
}

/// Threads, and nothing else; of clone3, whose flags are in memory, glibc does without.
void forbid_processes(Filter& filter) {
  filter.forbid(SCMP_SYS(clone), {bits(0, CLONE_THREAD, 0)});
  filter.forbid(SCMP_SYS(clone3), {}, ENOSYS);
}

/// What reaches others by their number reaches only itself.
void forbid_others(Filter& filter) {
  const auto self = static_cast<std::uint64_t>(::getpid());
  filter.forbid(SCMP_SYS(kill), {arg(0, SCMP_CMP_NE, self)});
  filter.forbid(SCMP_SYS(tgkill), {arg(0, SCMP_CMP_NE, self)});
  filter.forbid(SCMP_SYS(prlimit64), {arg(0, SCMP_CMP_NE, 0)});
  filter.forbid(SCMP_SYS(sched_setaffinity), {arg(0, SCMP_CMP_NE, 0)});
  filter.forbid(SCMP_SYS(sched_setparam), {arg(0, SCMP_CMP_NE, 0)});
  // 0 is the thread that asks, but the whole process group or user where `which` says so.
  filter.forbid(SCMP_SYS(setpriority), {arg(0, SCMP_CMP_NE, PRIO_PROCESS)});
  filter.forbid(SCMP_SYS(setpriority), {arg(1, SCMP_CMP_NE, 0)});
  filter.forbid(SCMP_SYS(ioprio_set), {arg(0, SCMP_CMP_NE, 1 /* IOPRIO_WHO_PROCESS */)});
  filter.forbid(SCMP_SYS(ioprio_set), {arg(1, SCMP_CMP_NE, 0)});
  for (const int owner : {F_SETOWN, F_SETOWN_EX}) {
    filter.forbid(SCMP_SYS(fcntl), {bits(1, 0xffffffff, static_cast<std::uint64_t>(owner))});
  }
  constexpr std::uint64_t kSetsOwner[] = {0x8901, 0x8902};  // FIOSETOWN, SIOCSPGRP
  for (const std::uint64_t type : {std::uint64_t{TIOCSTI}, std::uint64_t{TIOCLINUX}, kSetsOwner[0], kSetsOwner[1]}) {
    filter.forbid(SCMP_SYS(ioctl), {bits(1, 0xffffffff, type)});
  }
  filter.forbid(SCMP_SYS(prctl), {bits(0, 0xffffffff, PR_SET_DUMPABLE)});
}

/// A thread may put itself behind others (SCHED_BATCH, SCHED_IDLE), and not before them.
void forbid_policies(Filter& filter) {
  for (const std::uint64_t real_time : {SCHED_FIFO, SCHED_RR}) {
    filter.forbid(SCMP_SYS(sched_setscheduler), {arg(0, SCMP_CMP_EQ, 0), arg(1, SCMP_CMP_EQ, real_time)});
  }
  // Later ones, and flags that come with any.
  filter.forbid(SCMP_SYS(sched_setscheduler), {arg(0, SCMP_CMP_EQ, 0), arg(1, SCMP_CMP_GT, SCHED_IDLE)});
  // ZeroMQ gives its threads, by their numbers, the policy that they have, and ends the process if it may not. That is
  // done already; whether the number is a thread's of its own cannot be told here.
  const auto own = static_cast<std::uint64_t>(::sched_getscheduler(0));
  constexpr int kAsIfDone = 0;
  filter.forbid(SCMP_SYS(sched_setscheduler), {arg(0, SCMP_CMP_NE, 0), arg(1, SCMP_CMP_EQ, own)}, kAsIfDone);
  filter.forbid(SCMP_SYS(sched_setscheduler), {arg(0, SCMP_CMP_NE, 0), arg(1, SCMP_CMP_NE, own)});
}

/// Of the families of sockets: those of files, and by right those of the internet.
void forbid_sockets(Filter& filter, bool network) {
  constexpr std::uint64_t kFamilies = 64;
  for (std::uint64_t family = 0; family < kFamilies; ++family) {
    const bool allowed = family == AF_UNIX || (network && (family == AF_INET || family == AF_INET6));
    if (!allowed) filter.forbid(SCMP_SYS(socket), {bits(0, 0xffffffff, family)}, EAFNOSUPPORT);
  }
  filter.forbid(SCMP_SYS(socket), {arg(0, SCMP_CMP_GE, kFamilies)}, EAFNOSUPPORT);
  filter.forbid(SCMP_SYS(socketpair), {arg(0, SCMP_CMP_NE, AF_UNIX)}, EAFNOSUPPORT);
}

}  // namespace

std::string filter_system_calls(const Reach& reach) {
  Filter filter;
  for (const char* call : kForbidden) filter.forbid(call);
  forbid_shared_memory(filter);
  forbid_processes(filter);
  forbid_others(filter);
  forbid_policies(filter);
  forbid_sockets(filter, reach.network);
  filter.load();
  return "threads only, " + std::to_string(std::size(kForbidden)) + " calls forbidden";
}

}  // namespace fiona::os::detail
