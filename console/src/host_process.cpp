#include "host_process.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

#include <fcntl.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fiona/error.hpp>

extern char** environ;

namespace fiona::console {
namespace {

constexpr std::chrono::seconds kStart{10};
constexpr std::chrono::seconds kEnd{5};
/// For a host whose supervisor has gone to end by itself.
constexpr std::chrono::seconds kRest{1};
/// For what has been killed to be gone. What waits for a disk or a device in the kernel goes only then.
constexpr std::chrono::seconds kKilled{2};
constexpr std::chrono::milliseconds kNap{5};
constexpr std::size_t kLongestLine = 4096;
// The descriptors in the host; above the standard ones, below what it opens itself.
constexpr int kReadyInHost = 3;
constexpr int kLifelineInHost = 4;

struct Pipe {
  int read = -1;
  int write = -1;
};

Pipe make_pipe() {
  std::array<int, 2> ends{};
  if (::pipe2(ends.data(), O_CLOEXEC) != 0)
    throw Error(ErrorCode::Failed, ErrorText{.what = fmt::format("no pipe can be made: {}", std::strerror(errno)),
                                             .next = "fiona doctor"});
  // Clear of the numbers that the host's descriptors are moved to, which dup2 would close.
  for (int& end : ends) {
    const int moved = ::fcntl(end, F_DUPFD_CLOEXEC, 10);
    ::close(end);
    end = moved;
  }
  return {ends[0], ends[1]};
}

/// proc_tid_children(5). Of several threads the first one is given who has lost its parent.
std::vector<pid_t> children() {
  std::ifstream file(fmt::format("/proc/self/task/{}/children", ::getpid()));
  return {std::istream_iterator<pid_t>(file), {}};
}

SteadyTime in(std::chrono::seconds time) { return std::chrono::steady_clock::now() + time; }

}  // namespace

HostProcess::HostProcess(Reactor& reactor, const HostLaunch& launch, OnLine on_line)
    : reactor_(reactor), supervised_(launch.supervised), on_line_(std::move(on_line)) {
  const Pipe ready = make_pipe();
  const Pipe lifeline = make_pipe();
  const Pipe said = make_pipe();
  lifeline_ = lifeline.write;
  said_ = said.read;
  ::fcntl(said_, F_SETFL, O_NONBLOCK);
  try {
    spawn(launch, ready.write, lifeline.read, said.write);
  } catch (...) {
    for (const int end : {ready.read, ready.write, lifeline.read, lifeline.write, said.read, said.write}) ::close(end);
    throw;
  }
  for (const int end : {ready.write, lifeline.read, said.write}) ::close(end);
  reactor_.add(said_, [this] { read_said(); });
  try {
    wait_ready(ready.read);
  } catch (...) {
    ::close(ready.read);
    stop();
    end_said();  // what is left in it nobody reads any more
    throw;
  }
  ::close(ready.read);
}

void HostProcess::spawn(const HostLaunch& launch, int ready, int lifeline, int said) {
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawnattr_init(&attributes);
  ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  ::posix_spawn_file_actions_adddup2(&actions, said, STDOUT_FILENO);
  ::posix_spawn_file_actions_adddup2(&actions, said, STDERR_FILENO);
  ::posix_spawn_file_actions_adddup2(&actions, ready, kReadyInHost);
  ::posix_spawn_file_actions_adddup2(&actions, lifeline, kLifelineInHost);
  // What a supervisor leaves that was killed is this process's to end.
  if (supervised_) ::prctl(PR_SET_CHILD_SUBREAPER, 1);
  // A group of its own: Ctrl-C in the terminal is for the console, which then stops the host in order.
  sigset_t none;
  sigset_t defaults;
  sigemptyset(&none);
  sigemptyset(&defaults);
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGHUP}) sigaddset(&defaults, signal);
  ::posix_spawnattr_setsigmask(&attributes, &none);
  ::posix_spawnattr_setsigdefault(&attributes, &defaults);
  ::posix_spawnattr_setpgroup(&attributes, 0);
  ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);

  std::vector<std::string> words{launch.program.string(),
                                 "--socket",
                                 launch.socket.string(),
                                 "--name",
                                 launch.name,
                                 "--ready-fd",
                                 fmt::format("{}", kReadyInHost),
                                 "--lifeline-fd",
                                 fmt::format("{}", kLifelineInHost)};
  if (launch.restore) words.push_back("--restore");
  if (!launch.after_end.empty()) words.insert(words.end(), {"--after-end", launch.after_end});
  if (!launch.journal.empty()) words.insert(words.end(), {"--journal", launch.journal.string()});
  if (!launch.store.empty()) words.insert(words.end(), {"--store", launch.store.string()});
  if (!launch.unsigned_packages.empty()) words.insert(words.end(), {"--unsigned", launch.unsigned_packages.string()});
  if (!launch.listen.empty()) words.insert(words.end(), {"--listen", "tcp://" + launch.listen});
  if (!launch.serve.empty()) words.insert(words.end(), {"--serve", "tcp://" + launch.serve});
  if (!launch.registry.empty()) words.insert(words.end(), {"--registry", launch.registry});
  words.insert(words.end(), launch.limits.begin(), launch.limits.end());
  for (const std::string& peer : launch.peers) words.insert(words.end(), {"--peer", peer});
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  const int problem =
      ::posix_spawn(&process_, launch.program.c_str(), &actions, &attributes, arguments.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  ::posix_spawnattr_destroy(&attributes);
  if (problem != 0) {
    process_ = -1;
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("the host cannot be started: {}", std::strerror(problem)),
                          .where = launch.program.string(),
                          .next = "fiona doctor"});
  }
}

void HostProcess::wait_ready(int ready) {
  std::string told;
  bool ended = false;
  ::fcntl(ready, F_SETFL, O_NONBLOCK);
  reactor_.add(ready, [&told, &ended, ready] {
    std::array<char, 4096> chunk;
    const ssize_t count = ::read(ready, chunk.data(), chunk.size());
    if (count > 0) told.append(chunk.data(), static_cast<std::size_t>(count));
    ended = count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR);
  });
  bool in_time = false;
  try {
    in_time = reactor_.run_until([&] { return ended || told.starts_with("READY\n"); }, in(kStart));
  } catch (...) {
    reactor_.remove(ready);
    throw;
  }
  reactor_.remove(ready);
  if (told.starts_with("READY\n")) return;
  if (!in_time)
    throw Error(ErrorCode::Unreachable, ErrorText{.what = "the host does not get ready within 10 s",
                                                  .where = fmt::format("process {}", process_),
                                                  .next = "fiona doctor; a machine that is very busy: try again"});
  const int code = collect();
  while (told.ends_with('\n')) told.pop_back();
  const ErrorCode failed = was_killed_ ? ErrorCode::Unreachable : ErrorCode::Failed;
  throw Error(code >= 1 && code <= 9 ? static_cast<ErrorCode>(code) : failed,
              ErrorText{.what = told.empty() ? fmt::format("the host ended before it was ready (exit code {})", code)
                                             : "the host did not start: " + told,
                        .next = told.empty() ? "fiona doctor" : ""});
}

void HostProcess::read_said() {
  std::array<char, 4096> chunk;
  const ssize_t count = ::read(said_, chunk.data(), chunk.size());
  if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
  const bool ended = count <= 0;
  for (ssize_t i = 0; i < count; ++i) {
    const char next = chunk[static_cast<std::size_t>(i)];
    if (next != '\n') line_ += next;
    if (next != '\n' && line_.size() < kLongestLine) continue;
    // The rest of a long line is not to look like another one.
    on_line_(std::exchange(line_, next == '\n' ? "" : "    "));
  }
  if (!ended) return;
  if (!line_.empty()) on_line_(std::exchange(line_, {}));
  end_said();
}

void HostProcess::end_said() {
  if (said_ < 0) return;
  reactor_.remove(said_);
  ::close(std::exchange(said_, -1));
}

bool HostProcess::running() {
  if (exit_code_ || process_ < 0) return false;
  int status = 0;
  if (::waitpid(process_, &status, WNOHANG) != process_) return true;
  was_killed_ = !WIFEXITED(status);
  exit_code_ = was_killed_ ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  return false;
}

/// Short naps instead of a pidfd: this happens once, at the end, and the pipe's output is served meanwhile.
bool HostProcess::nap_until(SteadyTime deadline) {
  reactor_.run_until([] { return false; }, std::min(deadline, std::chrono::steady_clock::now() + kNap));
  return std::chrono::steady_clock::now() < deadline;
}

int HostProcess::collect() {
  for (const SteadyTime deadline = in(kEnd); running() && nap_until(deadline);) {
  }
  if (running()) ::kill(process_, SIGKILL);
  for (const SteadyTime deadline = in(kKilled); running() && nap_until(deadline);) {
  }
  if (running()) {
    tell_left(process_);
    was_killed_ = true;
    exit_code_ = 128 + SIGKILL;
  }
  if (was_killed()) end_rest();
  return exit_code_.value_or(1);
}

/// All that came of it has become a child of this process.
void HostProcess::end_rest() {
  const SteadyTime deadline = in(kRest);
  auto left = children();
  while (!left.empty() && nap_until(deadline + kKilled)) {
    const bool late = std::chrono::steady_clock::now() >= deadline;
    for (const pid_t child : left) {
      if (late) ::kill(child, SIGKILL);
      ::waitpid(child, nullptr, WNOHANG);
    }
    left = children();
  }
  for (const pid_t child : left) tell_left(child);
}

/// Whoever waits for the end of a run is not kept by what nobody can end.
void HostProcess::tell_left(pid_t process) {
  on_line_(
      fmt::format("process {} was killed, and is still there after {} s: it waits in the kernel for a disk or a "
                  "device, and ends when that answers; see ps -o pid,stat,wchan,args -p {}",
                  process, kKilled.count(), process));
}

int HostProcess::stop() {
  if (lifeline_ >= 0) ::close(std::exchange(lifeline_, -1));
  if (process_ < 0) return exit_code_.value_or(1);
  int code = 1;
  try {
    code = collect();
  } catch (const std::exception&) {
    ::kill(process_, SIGKILL);  // asked twice
    code = collect();
  }
  if (said_ >= 0) read_said();
  process_ = -1;  // what another one starts from here on is not what this one has left
  return code;
}

HostProcess::~HostProcess() {
  stop();
  end_said();
}

}  // namespace fiona::console
