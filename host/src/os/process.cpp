#include "os/process.hpp"

#include <fcntl.h>
#include <malloc.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string_view>
#include <system_error>
#include <thread>

#include "fiona/error.hpp"

extern char** environ;

namespace fiona::os {
namespace {

/// Above the numbers that children find their descriptors at.
constexpr int kFirstFree = 16;

/// Of an environment, which may hold secrets.
bool is_harmless(std::string_view variable) {
  constexpr std::string_view kHarmless[] = {"LANG=", "LC_", "TZ=", "ASAN_OPTIONS=", "UBSAN_OPTIONS=", "TSAN_OPTIONS="};
  return std::any_of(std::begin(kHarmless), std::end(kHarmless), [&](auto one) { return variable.starts_with(one); });
}

/// For one that was killed to be gone, while somebody waits.
constexpr int kGoesWithin_ms = 500;

/// To die a process needs a processor as any other, and what it waits for in the kernel. The thread that ends it may be
/// the one that a host is alive by.
void reap_in_time(pid_t child, int handle) {
  pollfd ended{handle, POLLIN, 0};
  ::poll(&ended, 1, kGoesWithin_ms);
  if (::waitpid(child, nullptr, WNOHANG) != 0) return;
  try {
    std::thread([child] { ::waitpid(child, nullptr, 0); }).detach();
  } catch (const std::system_error&) {  // there are no more threads
    ::waitpid(child, nullptr, 0);
  }
}

[[noreturn]] void fail_to_start(const std::filesystem::path& program, int error) {
  const char* const next = error == ENOENT || error == ENOEXEC || error == EACCES
                               ? "build or install FIONA again: its programs belong side by side"
                               : "fiona doctor; end what takes up processes, memory or descriptors here";
  throw Error(ErrorCode::Failed, {.what = "the process cannot be started",
                                  .where = program.string(),
                                  .found = std::strerror(error),
                                  .next = next});
}

}  // namespace

ChildProcess::ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                           const std::vector<std::pair<int, int>>& inherited, bool clean,
                           std::vector<std::string> variables, const std::filesystem::path& shown_as) {
  // Moved out of the way first: one of ours may have the number that another is to have there.
  std::vector<Descriptor> moved;
  for (const auto& [ours, theirs] : inherited) {
    moved.emplace_back(::fcntl(ours, F_DUPFD_CLOEXEC, kFirstFree));
    if (!moved.back()) fail_to_start(program, errno);  // a process that finds some of them would be worse than none
  }
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  for (std::size_t i = 0; i < moved.size(); ++i)
    posix_spawn_file_actions_adddup2(&actions, moved[i].get(), inherited[i].second);
  std::vector<std::string> words{shown_as.empty() ? program.string() : shown_as.string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::vector<char*> environment;
  for (char** one = environ; *one; ++one) {
    if (!clean || is_harmless(*one)) environment.push_back(*one);
  }
  for (auto& variable : variables) environment.push_back(variable.data());
  environment.push_back(nullptr);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  // What we are told by a descriptor is blocked here; it, and what it starts, is to hear it.
  sigset_t none;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK);
  const int error = ::posix_spawn(&id_, program.c_str(), &actions, &attributes, argv.data(), environment.data());
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) fail_to_start(program, error);
  handle_ = Descriptor(static_cast<int>(::syscall(SYS_pidfd_open, id_, 0)));
}

ChildProcess::ChildProcess(pid_t id, Descriptor handle, HowItEnded how)
    : id_(id), handle_(std::move(handle)), how_(std::move(how)) {}

ChildProcess::~ChildProcess() {
  if (!end().empty()) return;
  kill();
  if (!how_) reap_in_time(id_, handle_.get());
}

/// Its process group first: while it is not reaped no other one has its number.
std::optional<int> reap(pid_t child) {
  siginfo_t ended{};
  if (::waitid(P_PID, static_cast<id_t>(child), &ended, WEXITED | WNOHANG | WNOWAIT) != 0 || ended.si_pid != child)
    return std::nullopt;
  ::kill(-child, SIGKILL);
  int status = 0;
  ::waitpid(child, &status, 0);
  return status;
}

bool is_child(pid_t process) {
  siginfo_t ignored{};
  return ::waitid(P_PID, static_cast<id_t>(process), &ignored, WEXITED | WNOHANG | WNOWAIT) == 0;
}

/// One by one: a signal to all of a group would reach this process too, and who is killed so does not end in order.
void end_own_programs() {
  if (::getpgrp() != ::getpid()) return;
  std::error_code ignored;
  std::filesystem::directory_iterator process("/proc", ignored);
  for (; process != std::filesystem::directory_iterator(); process.increment(ignored)) {
    const pid_t id = static_cast<pid_t>(std::strtol(process->path().filename().c_str(), nullptr, 10));
    if (id > 0 && id != ::getpid() && ::getpgid(id) == ::getpid()) ::kill(id, SIGKILL);
  }
}

std::string text_of_end(int status) {
  if (WIFEXITED(status)) return "exited with code " + std::to_string(WEXITSTATUS(status));
  return "killed by signal " + std::to_string(WTERMSIG(status)) + " (" + strsignal(WTERMSIG(status)) + ")";
}

std::string ChildProcess::end() {
  if (!end_.empty()) return end_;
  if (!how_) {
    if (const auto status = reap(id_)) end_ = text_of_end(*status);
    return end_;
  }
  pollfd ended{handle_.get(), POLLIN, 0};
  if (::poll(&ended, 1, 0) == 1) end_ = how_(id_);
  return end_;
}

/// proc(5): the state stands behind the name, which may hold anything.
bool ChildProcess::is_stopped() const {
  std::ifstream file("/proc/" + std::to_string(id_) + "/stat");
  std::string line;
  std::getline(file, line);
  const std::size_t name = line.rfind(')');
  return end_.empty() && name != std::string::npos && line.compare(name, 3, ") T") == 0;
}

/// One of our own that has no pidfd, for want of descriptors, has its number until it is reaped.
void ChildProcess::kill() {
  if (!end().empty()) return;
  const bool told = handle_ ? ::syscall(SYS_pidfd_send_signal, handle_.get(), SIGKILL, nullptr, 0) == 0
                            : !how_ && ::kill(id_, SIGKILL) == 0;
  if (!told) return;
  ::kill(-id_, SIGKILL);
}

void ChildProcess::end_group() {
  kill();
  const auto until = std::chrono::steady_clock::now() + std::chrono::milliseconds(kGoesWithin_ms);
  while (std::chrono::steady_clock::now() < until) {
    int status = 0;
    const pid_t one = ::waitpid(-id_, &status, WNOHANG);
    if (one < 0) return;
    if (one == id_) end_ = text_of_end(status);
    if (one == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

std::size_t descriptor_limit() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  return limit.rlim_cur;
}

std::filesystem::path program_directory() { return std::filesystem::read_symlink("/proc/self/exe").parent_path(); }

std::filesystem::path program_in_path(std::string_view name) {
  const char* const folders = ::getenv("PATH");
  std::istringstream list(folders ? folders : "");
  for (std::string folder; std::getline(list, folder, ':');) {
    const auto program = std::filesystem::path(folder) / name;
    if (program.is_absolute() && ::access(program.c_str(), X_OK) == 0) return program;
  }
  return {};
}

void keep_freed_memory() {
  constexpr int kKept = 8 * 1024 * 1024;
  ::mallopt(M_TRIM_THRESHOLD, kKept);
  ::mallopt(M_MMAP_THRESHOLD, kKept);
}

void end_within(std::chrono::seconds time, int code) {
  static volatile std::sig_atomic_t end_code;
  end_code = code;
  ::signal(SIGALRM, [](int) { ::_exit(end_code); });
  ::alarm(static_cast<unsigned>(time.count()));
}

std::string random_token() {
  std::string token(16, '\0');
  if (::getrandom(token.data(), token.size(), 0) != static_cast<ssize_t>(token.size())) {
    throw Error(ErrorCode::Failed, {.what = "the system gives no random bytes",
                                    .found = std::strerror(errno),
                                    .next = "allow getrandom() where system calls are filtered"});
  }
  return token;
}

}  // namespace fiona::os
