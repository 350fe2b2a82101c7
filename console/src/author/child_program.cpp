#include "author/child_program.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <thread>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fiona/error.hpp>

extern char** environ;

namespace fiona::console {
namespace {

constexpr std::size_t kLongestChildLine = 4096;
constexpr std::chrono::milliseconds kGrace{2000};
constexpr std::chrono::milliseconds kNap{10};

/// One stream of a child, read as lines while the reactor runs.
class ChildStream {
 public:
  ChildStream(Reactor& reactor, std::function<void(const std::string&)> on_line)
      : reactor_(reactor), on_line_(std::move(on_line)) {
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), O_CLOEXEC) != 0)
      throw Error(ErrorCode::Failed, {.what = fmt::format("no pipe can be made: {}", std::strerror(errno)),
                                      .next = "raise the limit of descriptors: ulimit -n"});
    read_ = ends[0];
    write_ = ends[1];
    ::fcntl(read_, F_SETFL, O_NONBLOCK);
    reactor_.add(read_, [this] { take(); });
  }
  ChildStream(const ChildStream&) = delete;
  ChildStream& operator=(const ChildStream&) = delete;
  ~ChildStream() {
    close_write();
    close_read();
  }

  int write_end() const { return write_; }
  bool ended() const { return read_ < 0; }
  void close_write() {
    if (write_ >= 0) ::close(std::exchange(write_, -1));
  }

 private:
  void take() {
    std::array<char, 4096> chunk;
    const ssize_t count = ::read(read_, chunk.data(), chunk.size());
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) return;
    for (ssize_t i = 0; i < count; ++i) {
      const char next = chunk[static_cast<std::size_t>(i)];
      if (next != '\n' && line_.size() < kLongestChildLine) line_ += next;
      if (next == '\n') tell();
    }
    if (count > 0) return;
    if (!line_.empty()) tell();
    close_read();
  }
  void tell() {
    const std::string line = std::exchange(line_, {});
    if (on_line_) on_line_(line);
  }
  void close_read() {
    if (read_ < 0) return;
    reactor_.remove(read_);
    ::close(std::exchange(read_, -1));
  }

  Reactor& reactor_;
  std::function<void(const std::string&)> on_line_;
  int read_ = -1;
  int write_ = -1;
  std::string line_;
};

std::vector<char*> pointers(std::vector<std::string>& words) {
  std::vector<char*> all;
  for (std::string& word : words) all.push_back(word.data());
  all.push_back(nullptr);
  return all;
}

pid_t spawn_child(const ChildProgram& child, int out, int err) {
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawnattr_init(&attributes);
  ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  ::posix_spawn_file_actions_adddup2(&actions, out, STDOUT_FILENO);
  ::posix_spawn_file_actions_adddup2(&actions, err, STDERR_FILENO);
  if (!child.directory.empty()) ::posix_spawn_file_actions_addchdir_np(&actions, child.directory.c_str());
  sigset_t none;
  sigset_t defaults;
  sigemptyset(&none);
  sigemptyset(&defaults);
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGHUP}) sigaddset(&defaults, signal);
  ::posix_spawnattr_setsigmask(&attributes, &none);
  ::posix_spawnattr_setsigdefault(&attributes, &defaults);
  ::posix_spawnattr_setpgroup(&attributes, 0);
  ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);

  std::vector<std::string> words{child.program};
  words.insert(words.end(), child.arguments.begin(), child.arguments.end());
  std::vector<std::string> settings;
  for (char** one = environ; *one != nullptr; ++one) {
    const std::string_view setting = *one;
    const auto replaced = [&](const auto& ours) { return setting.starts_with(ours.first + "="); };
    const bool harmless = setting.starts_with("LANG=") || setting.starts_with("LC_");
    if ((!child.clean || harmless) && std::none_of(child.environment.begin(), child.environment.end(), replaced))
      settings.emplace_back(setting);
  }
  for (const auto& [name, value] : child.environment) settings.push_back(name + "=" + value);
  pid_t process = -1;
  const int problem = ::posix_spawnp(&process, child.program.c_str(), &actions, &attributes, pointers(words).data(),
                                     pointers(settings).data());
  ::posix_spawn_file_actions_destroy(&actions);
  ::posix_spawnattr_destroy(&attributes);
  if (problem == 0) return process;
  throw Error(ErrorCode::NotFound,
              ErrorText{.what = fmt::format("'{}' cannot be started: {}", child.program, std::strerror(problem)),
                        .next = "doctor"});
}

/// Ends the child and what it started, whatever happens to us.
class ChildGroup {
 public:
  explicit ChildGroup(pid_t process) : process_(process) {}
  ChildGroup(const ChildGroup&) = delete;
  ChildGroup& operator=(const ChildGroup&) = delete;
  ~ChildGroup() { end(); }

  bool has_ended() {
    if (!reaped_ && ::waitpid(process_, &status_, WNOHANG) == process_) reaped_ = true;
    return reaped_;
  }
  int end() {
    // Asked first: what runs others in groups of their own, as ninja does, then ends those.
    if (!has_ended()) ::kill(-process_, SIGTERM);
    for (auto left = kGrace; !has_ended() && left.count() > 0; left -= kNap) std::this_thread::sleep_for(kNap);
    ::kill(-process_, SIGKILL);  // the rest of its group, too, where it has ended itself
    if (!reaped_) reaped_ = ::waitpid(process_, &status_, 0) == process_;
    return status_;
  }

 private:
  pid_t process_;
  int status_ = 0;
  bool reaped_ = false;
};

}  // namespace

std::string ChildEnd::text() const {
  if (!in_time) return "did not end in time";
  if (signal != 0) return fmt::format("was killed by signal {} ({})", signal, ::strsignal(signal));
  return fmt::format("exited with code {}", code);
}

ChildEnd run_child(Reactor& reactor, const ChildProgram& child) {
  ChildStream out(reactor, child.on_out);
  ChildStream err(reactor, child.on_err);
  ChildGroup group(spawn_child(child, out.write_end(), err.write_end()));
  out.close_write();
  err.close_write();
  ChildEnd end;
  end.in_time = reactor.run_until([&] { return out.ended() && err.ended(); }, child.deadline);
  // Its streams end with it; what it left running in the background is not waited for.
  while (end.in_time && !group.has_ended()) {
    reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + std::chrono::milliseconds(2));
    end.in_time = std::chrono::steady_clock::now() < child.deadline || group.has_ended();
  }
  const int status = group.end();
  end.signal = end.in_time && WIFSIGNALED(status) ? WTERMSIG(status) : 0;
  end.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return end;
}

}  // namespace fiona::console
