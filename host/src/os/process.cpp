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
#include <cstring>
#include <fstream>
#include <string_view>

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

}  // namespace

ChildProcess::ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                           const std::vector<std::pair<int, int>>& inherited, bool clean) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  // Moved out of the way first: one of ours may have the number that another is to have there.
  std::vector<Descriptor> moved;
  for (const auto& [ours, theirs] : inherited) {
    moved.emplace_back(::fcntl(ours, F_DUPFD_CLOEXEC, kFirstFree));
    posix_spawn_file_actions_adddup2(&actions, moved.back().get(), theirs);
  }
  std::vector<std::string> words{program.string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::vector<char*> kept;
  for (char** one = environ; *one; ++one) {
    if (is_harmless(*one)) kept.push_back(*one);
  }
  kept.push_back(nullptr);
  const int error = ::posix_spawn(&id_, program.c_str(), &actions, nullptr, argv.data(), clean ? kept.data() : environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) {
    throw Error(ErrorCode::Failed, {.what = "the process cannot be started",
                                    .where = program.string(),
                                    .found = std::strerror(error),
                                    .next = "build or install FIONA again: its programs belong side by side"});
  }
  handle_ = Descriptor(static_cast<int>(::syscall(SYS_pidfd_open, id_, 0)));
}

ChildProcess::ChildProcess(pid_t id, Descriptor handle, HowItEnded how)
    : id_(id), handle_(std::move(handle)), how_(std::move(how)) {}

ChildProcess::~ChildProcess() {
  if (!end().empty()) return;
  kill();
  if (!how_) ::waitpid(id_, nullptr, 0);
}

std::string text_of_end(int status) {
  if (WIFEXITED(status)) return "exited with code " + std::to_string(WEXITSTATUS(status));
  return "killed by signal " + std::to_string(WTERMSIG(status)) + " (" + strsignal(WTERMSIG(status)) + ")";
}

std::string ChildProcess::end() {
  if (!end_.empty()) return end_;
  if (!how_) {
    int status = 0;
    if (::waitpid(id_, &status, WNOHANG) == id_) end_ = text_of_end(status);
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

void ChildProcess::kill() {
  if (end().empty()) ::syscall(SYS_pidfd_send_signal, handle_.get(), SIGKILL, nullptr, 0);
}

std::size_t open_descriptors() {
  const auto all = std::filesystem::directory_iterator("/proc/self/fd");
  return static_cast<std::size_t>(std::distance(begin(all), end(all))) - 1;  // the iterator's own
}

std::size_t descriptor_limit() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  return limit.rlim_cur;
}

std::filesystem::path program_directory() { return std::filesystem::read_symlink("/proc/self/exe").parent_path(); }

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
