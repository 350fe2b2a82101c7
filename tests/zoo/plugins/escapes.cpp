#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <linux/bpf.h>
#include <linux/io_uring.h>
#include <linux/keyctl.h>
#include <linux/perf_event.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/ipc.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/msg.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/reboot.h>
#include <sys/resource.h>
#include <sys/sem.h>
#include <sys/shm.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/swap.h>
#include <sys/syscall.h>
#include <sys/sysmacros.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "animal.hpp"
#include "host_socket.hpp"

// Tries every way out of a sandbox, and throws which of them it found. The host that it escapes to is its parent, which
// has put up what there is to find: a file, a unix socket, an abstract socket and a descriptor.
namespace {

const pid_t kHost = ::getppid();

std::string of_host(const std::string& ending) { return "/var/tmp/fiona-zoo-" + std::to_string(kHost) + ending; }

std::string own_folder() {
  Dl_info info{};
  ::dladdr(reinterpret_cast<const void*>(&own_folder), &info);
  const std::string path = info.dli_fname;
  return path.substr(0, path.rfind('/'));
}

bool opens(const std::string& path, int flags = O_RDONLY) {
  const int file = ::open(path.c_str(), flags | O_CLOEXEC, 0600);
  if (file >= 0) ::close(file);
  return file >= 0;
}

bool creates(const std::string& path) {
  const bool made = opens(path, O_WRONLY | O_CREAT | O_EXCL);
  if (made) ::unlink(path.c_str());
  return made;
}

bool socket_of(int family, int type) {
  const int made = ::socket(family, type, 0);
  if (made >= 0) ::close(made);
  return made >= 0;
}

bool connects(const std::string& path, bool is_abstract) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.copy(address.sun_path + (is_abstract ? 1 : 0), sizeof address.sun_path - 2);
  const int made = ::socket(AF_UNIX, SOCK_STREAM, 0);
  const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + path.size() + 1);
  const bool connected = ::connect(made, reinterpret_cast<const sockaddr*>(&address), length) == 0;
  ::close(made);
  return connected;
}

/// A call that would do harm is made with arguments that cannot be right: whoever is not even allowed to try is told
/// so first.
bool is_let_try(long result) { return result >= 0 || (errno != EPERM && errno != EACCES && errno != ENOSYS); }

bool child_of(long flags) {
  const long child = ::syscall(SYS_clone, flags | SIGCHLD, nullptr, nullptr, nullptr, nullptr);
  if (child == 0) ::_exit(0);
  if (child > 0) ::waitpid(static_cast<pid_t>(child), nullptr, 0);
  return child > 0;
}

bool executes_memory() {
  const int file = ::memfd_create("zoo", MFD_CLOEXEC);
  static_cast<void>(::write(file, "no program", 10));
  char* const none[] = {nullptr};
  const bool let = is_let_try(::syscall(SYS_execveat, file, "", none, none, AT_EMPTY_PATH));
  ::close(file);
  return let;
}

struct Escape {
  const char* name;
  std::function<bool()> works;
};

std::vector<Escape> files() {
  return {{"/etc/passwd", [] { return opens("/etc/passwd"); }},
          {"/etc/shadow", [] { return opens("/etc/shadow"); }},
          {"/root", [] { return opens("/root", O_DIRECTORY); }},
          {"/home", [] { return opens("/home", O_DIRECTORY); }},
          {"/var", [] { return opens("/var", O_DIRECTORY); }},
          {"/run", [] { return opens("/run", O_DIRECTORY); }},
          {"/sys", [] { return opens("/sys", O_DIRECTORY); }},
          {"/usr/bin", [] { return opens("/usr/bin", O_DIRECTORY); }},
          {"a file of the host", [] { return opens(of_host(".key")); }},
          {"another package", [] { return opens(own_folder() + "/../components/libtest-components.so"); }},
          {"the program of the host", [] { return opens(own_folder() + "/../../bin/fiona-host"); }},
          {"a file in its own package", [] { return creates(own_folder() + "/made-by-zoo"); }},
          {"its own library", [] { return opens(own_folder() + "/libescapes.so", O_WRONLY | O_APPEND); }},
          {"/var/tmp", [] { return creates("/var/tmp/made-by-zoo"); }},
          {"/dev/shm", [] { return creates("/dev/shm/made-by-zoo"); }},
          {"/dev/kmsg", [] { return opens("/dev/kmsg"); }},
          {"/dev/mem", [] { return opens("/dev/mem"); }},
          {"/proc/self", [] { return opens("/proc/self/status"); }},
          {"/proc/1/root", [] { return opens("/proc/1/root/etc/passwd"); }},
          {"the host's memory", [] { return opens("/proc/" + std::to_string(kHost) + "/mem"); }},
          {"the host's environment", [] { return opens("/proc/" + std::to_string(kHost) + "/environ"); }},
          {"the way up", [] { return opens("../../../../../../etc/passwd"); }},
          {"a file by its handle",
           [] {
             struct {
               file_handle handle;
               char rest[128];
             } found{};
             found.handle.handle_bytes = sizeof found.rest;
             int mount = 0;
             return ::name_to_handle_at(AT_FDCWD, "/usr/lib", &found.handle, &mount, 0) == 0;
           }},
          {"a device node", [] {
             const bool made = ::mknod("/tmp/made-by-zoo", S_IFCHR | 0600, makedev(1, 1)) == 0;
             if (made) ::unlink("/tmp/made-by-zoo");
             return made;
           }}};
}

std::vector<Escape> others() {
  return {{"ptrace", [] { return is_let_try(::ptrace(PTRACE_SEIZE, 1'000'000'000, nullptr, nullptr)); }},
          {"process_vm_readv",
           [] {
             char byte = 0;
             const iovec here{&byte, 1};
             const iovec there{const_cast<pid_t*>(&kHost), 1};
             return ::process_vm_readv(kHost, &here, 1, &there, 1, 0) == 1;
           }},
          {"kill the host", [] { return ::kill(kHost, 0) == 0; }},
          {"kill process 1", [] { return ::kill(1, 0) == 0; }},
          {"kill everybody", [] { return ::kill(-1, 0) == 0; }},
          {"kill its process group", [] { return ::kill(0, 0) == 0; }},
          {"tgkill", [] { return ::syscall(SYS_tgkill, kHost, kHost, 0) == 0; }},
          {"tkill", [] { return ::syscall(SYS_tkill, kHost, 0) == 0; }},
          {"pidfd_open",
           [] {
             const long file = ::syscall(SYS_pidfd_open, kHost, 0);
             if (file >= 0) ::close(static_cast<int>(file));
             return file >= 0;
           }},
          {"prlimit",
           [] {
             rlimit limit{};
             return ::prlimit(kHost, RLIMIT_NOFILE, nullptr, &limit) == 0;
           }},
          {"setpriority",
           [] {
             return ::setpriority(PRIO_PROCESS, static_cast<id_t>(kHost),
                                  ::getpriority(PRIO_PROCESS, static_cast<id_t>(kHost))) == 0;
           }},
          {"sched_setaffinity",
           [] {
             cpu_set_t all;
             CPU_ZERO(&all);
             return ::sched_getaffinity(0, sizeof all, &all) == 0 && ::sched_setaffinity(kHost, sizeof all, &all) == 0;
           }},
          {"signals by a descriptor",
           [] {
             int ends[2];
             if (::pipe(ends) != 0) return false;
             const bool set = ::fcntl(ends[0], F_SETOWN, kHost) == 0;
             ::close(ends[0]);
             ::close(ends[1]);
             return set;
           }},
          {"an inherited descriptor", [] { return ::fcntl(900, F_GETFD) >= 0; }},
          {"the host's environment variables", [] { return ::getenv("ZOO_SECRET") != nullptr; }}};
}

/// Whose turn it is, on a CPU and at the disk.
std::vector<Escape> turns() {
  constexpr int kOfUser = 3;  // IOPRIO_WHO_USER
  constexpr int kNoSuchClass = 0xffff;
  // Without parameters the kernel tells who may try that they are missing.
  const auto policy = [](pid_t of, int wanted) { return ::syscall(SYS_sched_setscheduler, of, wanted, nullptr); };
  return {{"the priority of its process group",
           [] { return ::setpriority(PRIO_PGRP, 0, ::getpriority(PRIO_PGRP, 0)) == 0; }},
          {"the priority of its user at the disk",
           [] { return is_let_try(::syscall(SYS_ioprio_set, kOfUser, 0, kNoSuchClass)); }},
          {"the host's policy", [policy] { return policy(kHost, SCHED_OTHER) != 0 && errno == EINVAL; }},
          {"the host's policy and a flag",
           [policy] { return is_let_try(policy(kHost, SCHED_IDLE | SCHED_RESET_ON_FORK)); }},
          {"real time and a flag", [policy] { return is_let_try(policy(0, SCHED_FIFO | SCHED_RESET_ON_FORK)); }},
          {"sched_setattr", [] { return is_let_try(::syscall(SYS_sched_setattr, 0, nullptr, 0)); }}};
}

bool makes_folder(const std::string& path) {
  const bool made = ::mkdir(path.c_str(), 0700) == 0;
  if (made) ::rmdir(path.c_str());
  return made;
}

/// Empty ones, of which no bound of bytes counts what they take.
bool makes_files(const std::string& folder, int number) {
  const auto name = [&](int i) { return folder + "/made-by-zoo-" + std::to_string(i); };
  int made = 0;
  while (made < number && opens(name(made), O_WRONLY | O_CREAT | O_EXCL)) ++made;
  for (int i = 0; i < made; ++i) ::unlink(name(i).c_str());
  return made == number;
}

bool shares(int object, int (*end)(int)) {
  if (object >= 0) end(object);
  return object >= 0;
}

/// Memory, and room on the disk, that no count of what it has tells.
std::vector<Escape> hoards() {
  return {
      {"a file in memory", [] { return shares(::memfd_create("zoo", MFD_CLOEXEC), &::close); }},
      {"shared memory",
       [] {
         return shares(::shmget(IPC_PRIVATE, 4096, 0600), [](int made) { return ::shmctl(made, IPC_RMID, nullptr); });
       }},
      {"semaphores",
       [] { return shares(::semget(IPC_PRIVATE, 1, 0600), [](int made) { return ::semctl(made, 0, IPC_RMID); }); }},
      {"a queue of messages",
       [] { return shares(::msgget(IPC_PRIVATE, 0600), [](int made) { return ::msgctl(made, IPC_RMID, nullptr); }); }},
      {"memory to share",
       [] {
         void* const made = ::mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
         if (made != MAP_FAILED) ::munmap(made, 4096);
         return made != MAP_FAILED;
       }},
      {"memory to share, by a device", [] { return opens("/dev/zero"); }},
      {"files without end", [] { return makes_files("/tmp", 2000); }},
      {"a file where it listens", [] { return creates(zoo::link_folder() + "/made-by-zoo"); }},
      {"a folder where it listens", [] { return makes_folder(zoo::link_folder() + "/made-by-zoo"); }}};
}

std::vector<Escape> sockets() {
  return {{"inet", [] { return socket_of(AF_INET, SOCK_STREAM); }},
          {"inet datagrams", [] { return socket_of(AF_INET, SOCK_DGRAM); }},
          {"inet6", [] { return socket_of(AF_INET6, SOCK_STREAM); }},
          {"netlink", [] { return socket_of(AF_NETLINK, SOCK_RAW); }},
          {"packets", [] { return socket_of(AF_PACKET, SOCK_RAW); }},
          {"vsock", [] { return socket_of(AF_VSOCK, SOCK_STREAM); }},
          {"a pair of sockets of another family",
           [] {
             int ends[2];
             return ::socketpair(AF_TIPC, SOCK_STREAM, 0, ends) == 0 ||
                    (::socketpair(AF_INET, SOCK_STREAM, 0, ends) != 0 && errno != EAFNOSUPPORT);
           }},
          {"a unix socket", [] { return connects(of_host(".sock"), false); }},
          {"the host's control socket", [] { return connects(zoo::link_folder() + "/../../main.sock", false); }},
          {"an abstract socket", [] { return connects("fiona-zoo-" + std::to_string(kHost), true); }}};
}

std::vector<Escape> programs() {
  return {{"fork", [] { return child_of(0); }},
          {"a user namespace", [] { return child_of(CLONE_NEWUSER); }},
          {"a mount namespace", [] { return child_of(CLONE_NEWNS); }},
          {"execve",
           [] {
             char* const none[] = {nullptr};
             return is_let_try(::execve("/nowhere", none, none));
           }},
          {"a program in memory", executes_memory},
          {"unshare", [] { return is_let_try(::unshare(CLONE_NEWUTS)); }},
          {"setns", [] { return is_let_try(::setns(-1, 0)); }},
          {"dumpable", [] { return ::prctl(PR_SET_DUMPABLE, 1) == 0; }},
          {"more descriptors", [] {
             rlimit limit{};
             ::getrlimit(RLIMIT_NOFILE, &limit);
             limit.rlim_max = limit.rlim_max + 1;
             return ::setrlimit(RLIMIT_NOFILE, &limit) == 0;
           }}};
}

std::vector<Escape> kernel() {
  return {{"mount", [] { return is_let_try(::mount("zoo", "/tmp", "no-such-file-system", 0, nullptr)); }},
          {"umount", [] { return is_let_try(::umount2("/nowhere", 0)); }},
          {"chroot", [] { return is_let_try(::chroot("/nowhere")); }},
          {"pivot_root", [] { return is_let_try(::syscall(SYS_pivot_root, "/nowhere", "/nowhere")); }},
          {"fsopen", [] { return is_let_try(::syscall(SYS_fsopen, "no-such-file-system", 0)); }},
          {"swapon", [] { return is_let_try(::swapon("/nowhere", 0)); }},
          {"bpf",
           [] {
             bpf_attr attribute{};
             return is_let_try(::syscall(SYS_bpf, BPF_PROG_LOAD, &attribute, 0));
           }},
          {"perf_event_open",
           [] {
             perf_event_attr attribute{};
             attribute.size = sizeof attribute;
             return is_let_try(::syscall(SYS_perf_event_open, &attribute, 0, -1, -1, ~0UL));
           }},
          {"kexec_load", [] { return is_let_try(::syscall(SYS_kexec_load, 0, 0, nullptr, ~0UL)); }},
          {"init_module", [] { return is_let_try(::syscall(SYS_init_module, nullptr, 0, "")); }},
          {"delete_module", [] { return is_let_try(::syscall(SYS_delete_module, "no_such_module", O_NONBLOCK)); }},
          {"reboot", [] { return is_let_try(::syscall(SYS_reboot, 0, 0, 0, nullptr)); }},
          {"clock_settime", [] { return is_let_try(::syscall(SYS_clock_settime, CLOCK_REALTIME, nullptr)); }},
          {"sethostname", [] { return is_let_try(::syscall(SYS_sethostname, nullptr, -1)); }},
          {"syslog", [] { return is_let_try(::syscall(SYS_syslog, 10, nullptr, 0)); }},
          {"keyctl", [] { return ::syscall(SYS_keyctl, KEYCTL_GET_KEYRING_ID, KEY_SPEC_USER_KEYRING, 1) >= 0; }},
          {"add_key", [] { return is_let_try(::syscall(SYS_add_key, "no-such-type", "zoo", "", 0, 0)); }},
          {"io_uring",
           [] {
             io_uring_params parameters{};
             const long ring = ::syscall(SYS_io_uring_setup, 1, &parameters);
             if (ring >= 0) ::close(static_cast<int>(ring));
             return ring >= 0;
           }},
          {"userfaultfd",
           [] {
             const long file = ::syscall(SYS_userfaultfd, O_CLOEXEC);
             if (file >= 0) ::close(static_cast<int>(file));
             return file >= 0;
           }},
          {"personality", [] { return ::syscall(SYS_personality, 0xffffffff) >= 0; }},
          {"a terminal's input", [] {
             char byte = 'x';
             return is_let_try(::ioctl(0, TIOCSTI, &byte));
           }}};
}

}  // namespace

void zoo::act() {
  std::string found;
  std::size_t works = 0;
  std::size_t tried = 0;
  for (const auto& part : {files(), others(), turns(), hoards(), sockets(), programs(), kernel()}) {
    for (const Escape& escape : part) {
      ++tried;
      errno = 0;
      if (!escape.works()) continue;
      ++works;
      found += (found.empty() ? ": " : ", ") + std::string(escape.name);
    }
  }
  throw std::runtime_error(std::to_string(works) + " of " + std::to_string(tried) + " escapes" + found);
}
